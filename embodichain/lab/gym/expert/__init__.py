"""Experts: the steps of a task file that solve it, for all environments at once."""
