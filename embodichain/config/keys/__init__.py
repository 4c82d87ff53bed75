"""The keys that a config may have, as data classes, and the check of them."""
