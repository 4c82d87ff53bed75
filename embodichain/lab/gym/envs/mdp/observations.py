"""Built-in terms of kind observations."""
