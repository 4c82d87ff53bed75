"""Termination terms: when an episode ends.

Every module of this package that does not begin with "_" is imported when terms are looked up.
"""
