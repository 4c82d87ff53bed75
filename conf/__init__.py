"""The YAML tree of configs, a package so that `pkg://embodichain.conf` finds it. No code here."""
