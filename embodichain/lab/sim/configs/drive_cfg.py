"""PD drives of an articulation's joints, as pure data; `cfg` exports them, as in EmbodiChain."""

from __future__ import annotations

import dataclasses
from typing import Annotated, Literal

from embodichain.utils.configclass import configclass
from embodichain.utils.fields.defaults import KEEP_DEFAULT, DefaultFloat
from embodichain.utils.fields.value_checks import require

__all__ = ["NO_LIMIT", "Gain", "JointDrivePropertiesCfg", "PerJoint"]

NO_LIMIT = 1e9
"""Efforts and speeds at least this large are no limits (EmbodiChain's default is 1e10)."""

_NotNegative = Annotated[float, require("must not be negative, got {}", lambda value: value >= 0)]
PerJoint = _NotNegative | dict[str, _NotNegative]
"""One value for all joints, or values keyed by joint-name regex or control-part name."""


Gain = Annotated[_NotNegative | dict[str, _NotNegative] | Literal["file"], KEEP_DEFAULT]
""""file", one value for all joints, or values by joint-name regex or control-part name."""


@configclass
class JointDrivePropertiesCfg:
    """PD drives of an articulation's joints, one value or a map by joint regex or control part.

    An MJCF file's actuators are kept, except on joints that `stiffness` or `damping` selects: a map
    selects the joints it matches, a number all joints that actuators of the file act on. On these,
    drives replace the actuators; values that are not given are the file's.
    """

    drive_type: Literal["force", "acceleration", "none"] = "force"
    """none: no drives; an MJCF file's actuators are kept."""
    stiffness: Gain = DefaultFloat(1e4)
    """N m/rad or N/m. "file", the default for an MJCF, keeps the file's actuators."""
    damping: Gain = DefaultFloat(1e3)
    """N m s/rad or N s/m, inside the drive; the joint's own damping is the file's."""
    max_effort: Gain = DefaultFloat(1e10)
    """N m or N, positive: bounds the sum of spring and damper. "file", the default for an MJCF,
    takes the limits of the URDF or MJCF; 1e9 or more means no limit."""
    max_velocity: PerJoint | Literal["file"] | None = None
    """rad/s or m/s, positive: limits how fast actions move position targets, and bounds velocity
    actions. "file" takes the limits of the URDF. The joint itself is not clamped."""
    friction: Annotated[PerJoint, KEEP_DEFAULT] = DefaultFloat(0.0)
    """Dry friction loss, N m or N. Not given keeps the file's; 0 clears it."""
    # ours
    armature: PerJoint | None = dataclasses.field(default=None, kw_only=True)
    """Reflected rotor inertia, kg m^2 or kg. None keeps the file's and adds the minimum that keeps
    a limited drive from chattering at the time step, with a warning."""
