"""Sweeps: planned, launched here or on a cluster, followed, compared."""
