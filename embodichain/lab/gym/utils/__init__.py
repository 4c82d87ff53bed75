"""Utilities of environments: registration, launcher arguments, observations of a policy."""
