"""What a term is before it is built: registered, named, checked, its columns."""
