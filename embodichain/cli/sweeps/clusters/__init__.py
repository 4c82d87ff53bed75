"""Launchers of sweeps on clusters, one a file."""
