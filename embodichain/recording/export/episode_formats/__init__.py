"""Formats of episodes with the task's observations, one a file."""
