"""Channels for viewers: Foxglove's own schemas, filled for a few environments."""
