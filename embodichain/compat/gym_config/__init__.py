"""EmbodiChain's gym configs become tasks, data to data, without torch or MuJoCo.

`conversion.convert` converts one; `vocabulary` and `functors` are the tables of keys and names.
"""
