"""Built-in terms of kind events."""
