"""commands.results."""
