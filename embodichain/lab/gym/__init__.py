"""Environments, managers, terms, and the registration of environments."""
