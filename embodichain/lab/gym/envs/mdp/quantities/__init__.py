"""Quantities: what rewards, metrics, terminations and observations are made of.

Every module of this package that does not begin with "_" is imported when terms are looked up.
"""
