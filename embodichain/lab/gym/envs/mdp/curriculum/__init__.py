"""Curriculum terms: what becomes harder over training.

Every module of this package that does not begin with "_" is imported when terms are looked up.
"""
