"""Built-in terms of kind rewards."""
