"""Verbs that run tasks here, measure them, and check the machine that does."""
