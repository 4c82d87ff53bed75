"""What exists for EmbodiChain alone: its import paths, gym configs, config classes and terms.

`names` is the table of its public names, `upstream_names.json` their list, `finder` makes them
importable; `embodichain` installs it. `gym_config` converts its configs, `terms` has its terms.
"""
