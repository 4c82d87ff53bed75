"""Conversion of EmbodiChain's gym configs to tasks, as plain data, without torch or MuJoCo.

`conversion.convert` converts one; `vocabulary` and `functors` are the tables of keys and names.
"""
