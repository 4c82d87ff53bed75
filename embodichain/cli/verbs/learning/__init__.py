"""Verbs that train, evaluate and compare policies, and collect demonstrations."""
