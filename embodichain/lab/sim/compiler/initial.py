"""An articulation's initial state: the config's positions, else the file's keyframe, else zeros."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np

from embodichain.lab.sim.compiler.drives import FileJoints
from embodichain.lab.sim.compiler.index import F64
from embodichain.lab.sim.compiler.joints import Mimics, movable_joints
from embodichain.lab.sim.compiler.names import match
from embodichain.utils.errors import Problem
from embodichain.utils.suggest import listing

__all__ = ["Keyframe", "read_keyframe", "resolve_qpos"]

_TOLERANCE = 1e-4
"""rad or m by which an initial position may pass a limit: rounding in files and float32."""


@dataclass(frozen=True, eq=False)
class Keyframe:
    """What a file's keyframe says.

    Attributes:
        qpos: (D,) of the movable joints.
        root: (7,) pose of the body with the free joint in the file's world, or None.
        ctrl: Actuator name -> control.
    """

    qpos: F64
    root: F64 | None
    ctrl: dict[str, float] = field(default_factory=dict)


def read_keyframe(model: mujoco.MjModel) -> Keyframe | None:
    """Return the keyframe called ``home``, else the first, else None."""
    if not model.nkey:
        return None
    names = [model.key(i).name for i in range(model.nkey)]
    key = names.index("home") if "home" in names else 0
    qpos = model.key_qpos[key]
    free = np.flatnonzero(model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE))
    root = None
    if len(free):
        start = int(model.jnt_qposadr[free[0]])
        root = qpos[start : start + 7].copy()
    ctrl = {model.actuator(i).name: float(model.key_ctrl[key, i]) for i in range(model.nu)}
    return Keyframe(qpos[model.jnt_qposadr[movable_joints(model)]].copy(), root, ctrl)


def resolve_qpos(
    value: Any, joints: FileJoints, mimics: Mimics, keyframe: Keyframe | None
) -> tuple[F64, list[Problem]]:
    """Return initial joint positions (D,) in rad or m, and every mistake in the config.

    Joints that the config does not name take the keyframe's value, else the value nearest zero
    within their limits; mimic joints follow their leader.

    Args:
        value: `ArticulationCfg.init_qpos`: None, D values, or a map by joint regex.
        joints: The file's joints.
        mimics: Which of them follow others.
        keyframe: The file's keyframe, if it has one.
    """
    low, high = joints.qpos_limits[:, 0], joints.qpos_limits[:, 1]
    qpos = (
        np.clip(np.zeros(len(joints.names)), low, high)
        if keyframe is None
        else keyframe.qpos.copy()
    )
    given = np.zeros(len(joints.names), np.bool_)
    problems: list[Problem] = []
    if isinstance(value, Mapping):
        _fill(value, joints.names, qpos, given, problems)
    elif value is not None:
        problems += _take(value, joints.names, qpos, given)
    for i, parent, slope, offset in zip(
        mimics.ids, mimics.parents, mimics.multipliers, mimics.offsets, strict=True
    ):
        if not given[i] and (keyframe is None or given[parent]):
            qpos[i] = slope * qpos[parent] + offset
    problems += _outside(qpos, given, joints)
    # Only what was given is held to the limits; rounding beyond them is taken back.
    return np.where(given, np.clip(qpos, low, high), qpos), problems


def _fill(
    value: Mapping[str, Any], names: tuple[str, ...], qpos: F64, given: Any, problems: list[Problem]
) -> None:
    for pattern, entry in value.items():
        path = f"init_qpos.{pattern}"
        ids, wrong = match(str(pattern), names, "joint", path)
        problems += wrong
        try:
            number = float(entry)
        except (TypeError, ValueError):
            problems.append(Problem(path, f"wants a number in rad or m, got {entry!r}"))
            continue
        qpos[list(ids)] = number
        given[list(ids)] = True


def _take(value: Any, names: tuple[str, ...], qpos: F64, given: Any) -> list[Problem]:
    try:
        array = np.asarray(value, np.float64).reshape(-1)
    except (TypeError, ValueError):
        return [
            Problem("init_qpos", f"wants {len(names)} numbers or a map by joint, got {value!r}")
        ]
    if len(array) != len(names):
        message = (
            f"wants {len(names)} values, one for each joint ({listing(names)}), got {len(array)}"
        )
        return [Problem("init_qpos", message)]
    qpos[:] = array
    given[:] = True
    return []


def _outside(qpos: F64, given: Any, joints: FileJoints) -> list[Problem]:
    found: list[Problem] = []
    for i in np.flatnonzero(given):
        low, high = joints.qpos_limits[i]
        if not low - _TOLERANCE <= qpos[i] <= high + _TOLERANCE:  # also catches NaN
            name, limits = joints.names[i], f"[{low:g}, {high:g}]"
            message = f"joint {name!r} starts at {qpos[i]:g}, outside its limits {limits}"
            found.append(Problem("init_qpos", message))
    return found
