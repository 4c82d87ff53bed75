"""Whether a log is what was recorded, and where two logs differ."""
