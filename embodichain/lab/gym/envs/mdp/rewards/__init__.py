"""Reward terms; most can be metrics as well.

Every module of this package that does not begin with "_" is imported when terms are looked up.
"""
