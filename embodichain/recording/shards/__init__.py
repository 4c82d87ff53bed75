"""Logs of a batch in shards; `open`, `inspect` and `verify` for any log."""
