"""The built-in terms, one module per kind; importing a module registers its terms."""
