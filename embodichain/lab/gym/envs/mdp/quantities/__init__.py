"""Quantities: numbers of the scene for rewards, metrics, terminations and observations.

Every module of this package that does not begin with "_" is imported when terms are looked up.
"""
