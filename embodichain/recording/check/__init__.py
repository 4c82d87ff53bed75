"""Checks that a log is the one that was recorded, and shows where two logs differ."""
