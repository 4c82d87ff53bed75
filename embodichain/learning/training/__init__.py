"""A training from its config to its last checkpoint."""
