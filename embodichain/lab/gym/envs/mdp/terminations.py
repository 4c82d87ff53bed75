"""Built-in terms of kind terminations."""
