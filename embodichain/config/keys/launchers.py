"""The names of launchers of sweeps on clusters, for `hydra/launcher`: `LAUNCHERS`.

A launcher is registered where it is defined, see `embodichain.cli.sweeps.launching`, and imported
when a sweep uses it: here it is a name. Hydra's own launchers, and its plug-ins, are not among
them.
"""

from __future__ import annotations

from typing import Any

from embodichain.utils.register import Register

__all__ = ["LAUNCHERS"]

LAUNCHERS: Register[Any] = Register(
    "launcher",
    group="embodichain.launchers",
    modules=("embodichain.cli.sweeps.clusters.*",),
)
"""``hydra/launcher`` -> `launching.Cluster`; modules and entry points are called as the launchers.
"""
