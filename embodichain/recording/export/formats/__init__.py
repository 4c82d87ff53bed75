"""Formats of what a log contains, one a file."""
