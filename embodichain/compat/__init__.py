"""EmbodiChain's import paths: every public name of its release 0.2.1 is ours, or says what to use.

`names` is the one table, `upstream_names.json` the names there are, `finder` what makes them
importable. `embodichain` installs the finder; nothing else imports this package.
"""
