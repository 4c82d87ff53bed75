"""Returning to a recorded moment, and to the state before startup events."""
