"""Channels for viewers with Foxglove's schemas, written for a few environments."""
