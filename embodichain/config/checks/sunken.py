"""`note_sunken`: robots and objects that begin in the ground, out of which physics throws them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import mujoco
import numpy as np

from embodichain.lab.sim.compiler.names import GROUND
from embodichain.utils.errors import Problem

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.base_env import BaseEnv

__all__ = ["note_sunken"]

_DEPTH = 0.01
"""Metres in the ground from which a body is named: feet that only stand are less deep."""
_ROWS = 4
"""Environments whose first states are looked at."""


def note_sunken(env: BaseEnv) -> list[Problem]:
    """Return a note for each robot and object of which a part begins in the ground plane.

    A part counts that is there both in the initial state and after the events of a reset, which
    move it or not. Terrain has no plane, and what cannot touch the ground does not count.

    Args:
        env: An environment that was just reset, with its arrays on the host.
    """
    compiled = env.sim.scene
    model = compiled.model
    ground = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, GROUND)
    if ground < 0 or model.geom_type[ground] != mujoco.mjtGeom.mjGEOM_PLANE:
        return []
    rows = np.asarray(env.sim.engine.rows[:_ROWS])
    depths = _depths(model, env.sim.initial_row, ground)
    for row in rows:
        if not depths.any():
            return []
        depths = np.minimum(depths, _depths(model, row, ground))
    notes: list[Problem] = []
    for uid, entity in compiled.entities.items():
        bodies = np.unique(model.geom_bodyid[entity.geom_ids])
        bodies = bodies[depths[bodies] > _DEPTH]
        if len(bodies):
            deepest_first = bodies[np.argsort(-depths[bodies])]
            path = f"{_key_of(env, uid)}.init_pos"
            notes.append(Problem(path, _describe(model, uid, deepest_first, depths)))
    return notes


def _key_of(env: BaseEnv, uid: str) -> str:
    """The key path of an entity's declaration."""
    for section in ("objects", "articulations", "robots"):
        if uid in (getattr(env.cfg, section, None) or {}):
            return f"task.{section}.{uid}"
    return "task.robot"


def _depths(model: mujoco.MjModel, row: NDArray[np.float64], ground: int) -> NDArray[np.float64]:
    """(nbody,) how deep each body is in the ground in a state, m; 0 above it."""
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, row, mujoco.mjtState.mjSTATE_INTEGRATION)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_collision(model, data)
    depths = np.zeros(model.nbody)
    contacts = data.contact
    for first, second in ((contacts.geom1, contacts.geom2), (contacts.geom2, contacts.geom1)):
        touches_ground = first == ground
        bodies = model.geom_bodyid[second[touches_ground]]
        np.maximum.at(depths, bodies, -contacts.dist[touches_ground])
    return depths


def _describe(
    model: mujoco.MjModel,
    uid: str,
    bodies: NDArray[np.int_],
    depths: NDArray[np.float64],
) -> str:
    """Say how deep an entity's bodies are in the ground, the deepest first."""
    name = model.body(int(bodies[0])).name.removeprefix(f"{uid}/")
    fact = f"at the start {name} is {100 * depths[bodies[0]]:.0f} cm below the ground"
    if len(bodies) > 1:
        others = "another part is" if len(bodies) == 2 else f"{len(bodies) - 1} other parts are"
        fact += f", and {others} in the ground too"
    return f"{fact}: it is too low for this pose (m)"
