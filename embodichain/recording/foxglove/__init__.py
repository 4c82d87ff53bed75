"""What people look at: Foxglove's own schemas, filled for a few environments."""
