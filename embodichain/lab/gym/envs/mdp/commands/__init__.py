"""Command terms: goals that are no place in the scene.

Every module of this package that does not begin with "_" is imported when terms are looked up.
"""
