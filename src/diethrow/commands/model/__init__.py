"""commands.model."""
