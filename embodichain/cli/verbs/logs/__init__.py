"""Verbs that read the log of a run."""
