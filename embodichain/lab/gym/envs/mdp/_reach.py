"""`fitted_share`: how far places around a robot have to be drawn in, so that its tool reaches them.

Computed once, on MuJoCo's own model, whatever the arrays of the simulation are.
"""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Any

import lazy_loader
import numpy as np

from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean

if TYPE_CHECKING:
    import mujoco

    from embodichain.lab.gym.envs.managers.context import TermContext
    from embodichain.lab.sim.reads.frames import BodyFrames
    from embodichain.utils.array_types import Floats
else:
    mujoco = lazy_loader.load("mujoco")

__all__ = ["fitted_share", "initial_pose_of"]

_log = logging.getLogger(__name__)
_ENOUGH = 0.95
"""Share of the places that the tool must reach."""
_SHARES = 20
"""Shares that are tried are multiples of one in so many."""


def initial_state(env: TermContext) -> mujoco.MjData:
    """The scene before any event."""
    sim: Any = getattr(env, "sim")  # noqa: B009  (the protocol leaves it out)
    engine = sim.engine
    data = mujoco.MjData(engine.model)
    row = sim.initial_row
    data.qpos[:] = row[engine.component("qpos")]
    data.mocap_pos[:] = row[engine.component("mocap_pos")].reshape(-1, 3)
    data.mocap_quat[:] = row[engine.component("mocap_quat")].reshape(-1, 4)
    mujoco.mj_kinematics(engine.model, data)
    return data


def initial_pose_of(env: TermContext, frame: BodyFrames) -> tuple[Floats, Floats]:
    """Position (3,) in m and orientation (4,), wxyz, of a frame before any event."""
    data = initial_state(env)
    element = {"link": data.body, "site": data.site, "geom": data.geom}[frame.kind](int(frame.ids))
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, element.xmat.reshape(9))
    return np.array(element.xpos), quat


def fitted_share(
    env: TermContext,
    action: str,
    origin: Floats,
    offsets: Floats,
    orientations: Floats | None = None,
) -> float:
    """The largest share of offsets at which a tool reaches 19 of 20 places, 1 at most.

    Args:
        env: The environment.
        action: The action term that moves the tool, within its bounds.
        origin: (3,) m, where the offsets begin.
        offsets: (n, 3) m.
        orientations: (n, 4), wxyz, that the tool has at each place; None: any.

    Returns:
        The share; 1, with a warning, if there is no such action or it moves no tool.

    Raises:
        ConfigError: If no share of the offsets is reached.
    """
    from embodichain.lab.sim.compiler.robot.tool_home import can_reach  # imports MuJoCo

    actions: Any = getattr(env, "action_manager")  # noqa: B009
    terms = {name: built.instance for name, built in actions.terms.items()}
    term = terms.get(action)
    if term is None or not hasattr(type(term), "joint_range"):
        movers = [name for name, other in terms.items() if hasattr(type(other), "joint_range")]
        # A task whose actions were replaced goes on, with the places that it asks for.
        message = f"no action {action!r} moves a tool; these do: {', '.join(movers) or 'none'}"
        hint = did_you_mean(action, movers)
        _log.warning("reachable_by: %s.%s The range stays as it is", message, hint)
        return 1.0
    try:
        # Velocities and efforts reach as far as positions, though no tool follows a path by them.
        solver = term.kinematics if hasattr(type(term), "kinematics") else term.solver
    except ConfigError as error:
        _log.warning("reachable_by: %s. The range stays as it is", error.problems[0].message)
        return 1.0
    index = term.asset.index
    data = initial_state(env)
    model = data.model
    joints = model.dof_jntid[np.asarray(index.dof_adr)[solver.moving]]
    low = None if term.joint_range is None else term.joint_range.low
    high = None if term.joint_range is None else term.joint_range.high
    for tenths in range(_SHARES, 0, -1):
        share = tenths / _SHARES
        places = origin + share * offsets
        reached = can_reach(
            model,
            start=np.array(data.qpos),
            kind=solver.chain.tool.kind,
            tool=int(solver.chain.tool.ids),
            joints=joints,
            places=places,
            orientations=orientations,
            low=low,
            high=high,
            enough=_ENOUGH,
        )
        if reached:
            return share
    message = f"cannot: the tool that {action!r} moves reaches too few of the places, however near"
    raise ConfigError([Problem("reachable_by", message)])
