"""From the config of a task to its scene: read, checked, compiled, built."""
