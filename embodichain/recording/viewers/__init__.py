"""Viewers of running environments and of logs."""
