"""commands.clip."""
