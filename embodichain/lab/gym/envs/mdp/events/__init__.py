"""Event terms: changes of the scene at startup, at resets and at intervals.

Every module of this package that does not begin with "_" is imported when terms are looked up.
"""
