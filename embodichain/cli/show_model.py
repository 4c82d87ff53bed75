"""What `show` says of a compiled scene: bodies, joints, actuators, cameras, where things start."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv

__all__ = ["model_tables"]

Rows = list[dict[str, Any]]


def model_tables(env: BaseEnv) -> dict[str, Rows]:
    """Tables by title."""
    model = env.sim.scene.model
    return {
        "bodies": _bodies(model),
        "joints": _joints(model),
        "actuators": _actuators(model),
        "drives": _drives(env),
        "cameras": _cameras(model),
        "notes on files": _notes(env),
        "initial poses": _poses(env),
        "initial qpos": _qpos(env),
    }


def _bodies(model: Any) -> Rows:
    return [
        {
            "body": body.name,
            "parent": model.body(int(model.body_parentid[body.id])).name,
            "mass kg": float(model.body_mass[body.id]),
            "geoms": int(model.body_geomnum[body.id]),
            "moved by": _mover(model, body.id),
        }
        for body in map(model.body, range(1, model.nbody))
    ]


def _mover(model: Any, body: int) -> str:
    if model.body_mocapid[body] >= 0:
        return "code (mocap)"
    first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
    names = (model.joint(first + i).name for i in range(count))
    return ", ".join(names) or "its parent"


def _joints(model: Any) -> Rows:
    import mujoco

    rows = []
    for index in range(model.njnt):
        dof = int(model.jnt_dofadr[index])
        limited = bool(model.jnt_limited[index])
        rows.append(
            {
                "joint": model.joint(index).name,
                "type": mujoco.mjtJoint(int(model.jnt_type[index])).name.removeprefix("mjJNT_"),
                "range": _floats(model.jnt_range[index]) if limited else "no limit",
                "damping": float(model.dof_damping[dof]),
                "armature": float(model.dof_armature[dof]),
                "friction": float(model.dof_frictionloss[dof]),
            }
        )
    return rows


def _actuators(model: Any) -> Rows:
    from embodichain.lab.sim.compiler.actuators import describe_actuators

    return [
        {
            "actuator": actuator.name,
            "kind": actuator.kind,
            "on": actuator.target,
            "gear": actuator.gear,
            "gain": actuator.gain,
            "stiffness": actuator.stiffness,
            "damping": actuator.damping,
            "ctrl range": _ranges(actuator.ctrlrange),
            "force range": _range(actuator.forcerange),
        }
        for actuator in describe_actuators(model)
    ]


def _range(limits: Any) -> Any:
    return "no limit" if limits is None else _floats(limits)


def _ranges(limits: Any) -> Any:
    """One range, or one for each input of an actuator that has several."""
    if len(limits) == 1 or not any(limits):
        return _range(limits[0])
    return [_range(one) for one in limits]


def _notes(env: BaseEnv) -> Rows:
    """What the compiler changed or left out of robots' files."""
    articulations = {**env.sim.robots, **env.sim.articulations}
    return [
        {"entity": uid, "note": note}
        for uid, asset in articulations.items()
        for note in asset.parsed.notes
    ]


def _drives(env: BaseEnv) -> Rows:
    """Gains of the drives, and how fast they are; `max_velocity` bounds targets, not the joint."""
    from embodichain.lab.sim.compiler.drive_response import (
        joint_inertia,
        time_constants,
        top_speeds,
    )

    rows = []
    for uid, asset in {**env.sim.robots, **env.sim.articulations}.items():
        parsed = asset.parsed
        inertia, speeds, times = (
            joint_inertia(parsed),
            top_speeds(parsed),
            time_constants(parsed),
        )
        for i, name in enumerate(parsed.joint_names):
            if not math.isnan(times[i]):
                rows.append(
                    {
                        "joint": f"{uid}/{name}",
                        "stiffness": float(parsed.stiffness[i]),
                        "damping": float(parsed.damping[i]),
                        "max_effort": _limit(parsed.max_effort[i]),
                        "inertia": _short(inertia[i]),
                        "time constant s": _short(times[i]),
                        "top speed by effort": _short(speeds[i]),
                        "max_velocity of targets": _limit(parsed.max_velocity[i]),
                    }
                )
    return rows


def _limit(value: float) -> float | str:
    return float(value) if value < 1e9 else "no limit"


def _short(value: float) -> float | str:
    return float(f"{value:.3g}") if math.isfinite(value) else "no limit"


def _cameras(model: Any) -> Rows:
    """What pictures and films can be taken with; an entity's are called ``uid/NAME``."""
    return [
        {
            "camera": camera.name,
            "on body": model.body(int(model.cam_bodyid[camera.id])).name,
            "field of view deg": float(model.cam_fovy[camera.id]),
        }
        for camera in map(model.camera, range(model.ncam))
    ]


def _poses(env: BaseEnv) -> Rows:
    """Where each entity's root is put at a reset, before reset events."""
    return [
        {"entity": uid, "position m": _floats(index.pos0), "quaternion wxyz": _floats(index.quat0)}
        for uid, index in env.sim.scene.entities.items()
    ]


def _qpos(env: BaseEnv) -> Rows:
    """Where each joint is put at a reset, before reset events."""
    articulations = {**env.sim.robots, **env.sim.articulations}
    return [
        {
            "entity": uid,
            "joint": name,
            "qpos": float(qpos),
            "lower": float(low),
            "upper": float(high),
        }
        for uid, asset in articulations.items()
        for name, qpos, (low, high) in zip(
            asset.parsed.joint_names, asset.parsed.init_qpos, asset.parsed.qpos_limits, strict=True
        )
    ]


def _floats(values: Any) -> list[float]:
    return [float(value) for value in values]
