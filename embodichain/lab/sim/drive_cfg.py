"""PD drives of an articulation's joints, as pure data; `cfg` offers them as EmbodiChain's does."""

from __future__ import annotations

import dataclasses
from typing import Annotated, Any, Literal

from pydantic import ValidatorFunctionWrapHandler, WrapValidator

from embodichain.utils.configclass import configclass

__all__ = ["NO_LIMIT", "FileFirst", "Gain", "JointDrivePropertiesCfg", "PerJoint"]

NO_LIMIT = 1e9
"""Efforts and speeds at least this large are no limits (EmbodiChain's default is 1e10)."""

PerJoint = float | dict[str, float]
"""One value for all joints, or values keyed by joint-name regex or control-part name."""


class FileFirst(float):
    """A default that yields to the robot file, where the file can say it; else the number it is."""


def _kept(value: Any, validate: ValidatorFunctionWrapHandler) -> Any:
    """Keep the mark of a value that was not given when a config is read back from a dict."""
    return value if isinstance(value, FileFirst) else validate(value)


Gain = Annotated[float | dict[str, float] | Literal["file"], WrapValidator(_kept)]
""""file", one value for all joints, or values by joint-name regex or control-part name."""


@configclass
class JointDrivePropertiesCfg:
    """PD drives of an articulation's joints, one value or a map by joint regex or control part.

    An MJCF file's actuators stay as they are, but on joints that `stiffness` or `damping` names: a
    map names the joints it matches, a number those that actuators of the file act on. Their drives
    take the place of those actuators; what is not given is the file's.
    """

    drive_type: Literal["force", "acceleration", "none"] = "force"
    """none: no drives; an MJCF file's actuators stay."""
    stiffness: Gain = FileFirst(1e4)
    """N m/rad or N/m. "file" keeps an MJCF file's actuators, and is the default of an MJCF."""
    damping: Gain = FileFirst(1e3)
    """N m s/rad or N s/m, inside the drive; the joint's own damping is the file's."""
    max_effort: Gain = FileFirst(1e10)
    """N m or N, positive: bounds spring and damper together. "file" takes the limits of the URDF or
    MJCF, and is the default of an MJCF; 1e9 and more is no limit."""
    max_velocity: PerJoint | Literal["file"] | None = None
    """rad/s or m/s, positive: how fast actions move position targets, and the bound of velocity
    actions. "file" takes the limits of the URDF. The joint itself is not clamped."""
    friction: PerJoint = 0.0
    """Dry friction loss, N m or N; 0 keeps the file's, a map with 0 clears it."""
    # ours
    armature: PerJoint | None = dataclasses.field(default=None, kw_only=True)
    """Reflected rotor inertia, kg m^2 or kg. None keeps the file's and adds the least that keeps a
    limited drive from chattering at the time step, which is said."""
