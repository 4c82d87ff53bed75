"""Learned policies: loaded, exported, checked against their environment."""
