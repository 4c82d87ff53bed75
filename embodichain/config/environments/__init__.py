"""Environments made of a config: here, in shards, and under the names of Gymnasium."""
