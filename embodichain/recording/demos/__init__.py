"""Demonstrations: collected, augmented, read as the policy saw them."""
