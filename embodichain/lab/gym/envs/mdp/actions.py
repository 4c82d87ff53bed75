"""Built-in terms of kind actions."""
