"""The machine, its files and its processes."""
