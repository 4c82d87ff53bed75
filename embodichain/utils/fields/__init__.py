"""Kinds of fields of config classes, and plain messages about their values."""
