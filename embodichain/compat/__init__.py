"""Compatibility with EmbodiChain: its import paths, gym configs, config classes and terms.

`names` is the table of its public names, `upstream_names.json` their list; `finder` makes them
importable and is installed by `embodichain`. `gym_config` converts configs, `terms` has the terms.
"""
