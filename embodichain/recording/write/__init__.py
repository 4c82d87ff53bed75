"""Writing the log of an environment that is stepped."""
