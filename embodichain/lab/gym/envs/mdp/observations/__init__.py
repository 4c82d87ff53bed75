"""Observation terms: what is added to the observation.

Every module of this package that does not begin with "_" is imported when terms are looked up.
"""
