"""`SelfCollisionCfg`: which links of a robot collide with each other. Pure data."""

from __future__ import annotations

import dataclasses

from embodichain.utils.configclass import configclass

__all__ = ["SelfCollisionCfg"]


@configclass
class SelfCollisionCfg:
    """Pairs of links that collide, or do not, whatever the rule of the robot's file is.

    An entry is two link regexes. `include` is stronger than `exclude`.
    """

    exclude: list[tuple[str, str]] = dataclasses.field(default_factory=list)
    """Pairs that do not collide with each other."""
    include: list[tuple[str, str]] = dataclasses.field(default_factory=list)
    """Pairs that do, even if the rule, `disable_self_collision` or `exclude` leaves them out."""
