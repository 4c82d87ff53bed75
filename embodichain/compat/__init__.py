"""Compatibility with EmbodiChain: its import paths, gym configs, config classes and terms.

`names` is the table of its public names, which `embodichain` makes importable;
`upstream_names.json` lists them. `gym_config` converts configs, `terms` has the terms.
"""
