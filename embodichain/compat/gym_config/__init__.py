"""EmbodiChain's own form of a task, its gym config, becomes a task of ours: data to data.

`conversion.convert` is the door, `vocabulary` the tables of every key and name that is known there.
Nothing here imports torch or MuJoCo, checks values, or knows of files but `file`; what the result
means is checked like any other task. Nothing is imported by the package itself.
"""
