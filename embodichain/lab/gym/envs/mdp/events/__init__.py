"""Event terms: what happens to the scene at start, at resets and at intervals.

Every module of this package that does not begin with "_" is imported when terms are looked up.
"""
