"""Utilities of environments: registration, launcher arguments, spaces."""
