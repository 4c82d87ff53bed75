"""Verbs of the command, one a module; each has its `command`."""
