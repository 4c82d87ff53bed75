"""A robot's tool by the entity of a term: `tool_links` names it, `arm_solver` moves it.

`MovesTool` is an action that does; `moving_joints` are the joints, `usual_speeds` how fast they
may turn.
"""

from __future__ import annotations

import dataclasses
import logging
from typing import TYPE_CHECKING, Literal, Protocol

import numpy as np

from embodichain.lab.gym.envs.managers.scene_entity import UNLIMITED
from embodichain.lab.sim.reads.frames import link_frame
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.notes import warn_once

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
    from embodichain.lab.sim.objects.arms.arm_solver import ArmSolver
    from embodichain.lab.sim.objects.articulation import Articulation
    from embodichain.utils.array_types import Floats

__all__ = [
    "JointRange",
    "MovesTool",
    "Orientation",
    "arm_solver",
    "moving_joints",
    "tool_links",
    "tool_orientation",
    "usual_speeds",
]

_log = logging.getLogger(__name__)

Orientation = Literal["any", "keep", "free"]
"""Whether an action chooses the tool's orientation, keeps it, or leaves it free."""
_USUAL_HINGE_SPEED = np.pi
"""Speed in rad/s of hinges for which neither file nor drive has a limit."""
_USUAL_SLIDE_SPEED = 1.0
"""Speed in m/s of slides, likewise."""


@dataclasses.dataclass(frozen=True)
class JointRange:
    """Positions that an action can ask for, rad or m.

    Attributes:
        low: (k,) lowest ones.
        high: (k,) highest.
    """

    low: Floats
    high: Floats


class MovesTool(Protocol):
    """An action term by which a tool can be moved along a path."""

    @property
    def solver(self) -> ArmSolver:
        """The kinematics of the tool."""

    @property
    def orientation(self) -> Orientation:
        """What the action does with the tool's orientation."""

    @property
    def joint_speeds(self) -> Floats:
        """(k,) largest speeds of the solver's moving joints, rad/s or m/s."""

    @property
    def tool_speeds(self) -> tuple[float, float]:
        """Largest speeds of the tool, m/s and rad/s, that the action can ask for."""

    @property
    def joint_range(self) -> JointRange | None:
        """Positions of the solver's moving joints that the action can ask for; None is no bound."""

    def action_towards(self, pos: Floats, quat: Floats, qpos: Floats) -> Floats:
        """The action that asks for a pose of the tool, within the action's bounds.

        Args:
            pos: (N, 3) m, in the environment's frame.
            quat: (N, 4) wxyz.
            qpos: (N, k) positions of the solver's moving joints that have this pose.

        Returns:
            (N, A).
        """


def tool_orientation(rotation: str) -> Orientation:
    """What a term's parameter `rotation` means for the tool's orientation."""
    if rotation == "keep":
        return "keep"
    if rotation == "free":
        return "free"
    return "any"


def tool_links(entity: ResolvedEntity) -> list[str]:
    """The name of the tool link; several or none where it is not unique.

    It is the tool point in the robot's `solver_cfg` for the picked control part (or the whole
    robot), else the farthest link that all picked joints move.
    """
    from embodichain.lab.sim.objects.arms.arm_solver import tool_bodies

    asset = entity.articulation
    parts = entity.control_parts or ("default",)
    if len(parts) == 1 and parts[0] in asset.parsed.tools:
        return [asset.parsed.tools[parts[0]]]
    link_bodies = list(asset.index.body_ids)
    link_names = asset.parsed.link_names
    return [link_names[link_bodies.index(body)] for body in tool_bodies(asset, entity.joint_ids)]


def arm_solver(entity: ResolvedEntity, path: str = "entity_cfg") -> ArmSolver:
    """The kinematics of an entity's tool, with the settings of its control part.

    Args:
        entity: The robot; its picked joints move, its picked link, site or geom is the tool (by
            default the link of `tool_links`).
        path: The parameter, for messages.

    Raises:
        ConfigError: If there is no tool or more than one, or no picked joint moves it.
    """
    from embodichain.lab.sim.cfg import SolverCfg
    from embodichain.lab.sim.objects.arms.arm_solver import ArmSolver

    asset = entity.articulation
    if not entity.joint_ids:
        raise ConfigError([Problem(f"{path}.uid", f"{entity.uid!r} has no joints")])
    names = list(entity.frame_names) or tool_links(entity)
    if len(names) != 1:
        suggested = names or "none"
        message = f"cannot tell which {entity.kind} is the tool, name it; candidates: {suggested}"
        raise ConfigError([Problem(f"{path}.{entity.kind}_names", message)])
    tool = entity.frame if entity.frame_names else link_frame(asset.body_of(names[0]))
    part = entity.control_parts[0] if len(entity.control_parts) == 1 else None
    # An articulation that is not a robot has no settings.
    solver_cfg = getattr(asset, "solver_cfg", None)
    settings = SolverCfg() if solver_cfg is None else solver_cfg(part)
    return ArmSolver(asset, entity.joint_ids, tool, settings, path)


def moving_joints(entity: ResolvedEntity, solver: ArmSolver) -> ResolvedEntity:
    """The entity with those of its joints picked that move the tool, from root to tool."""
    joints = tuple(map(int, solver.moving))
    return dataclasses.replace(entity, joint_ids=joints, joint_names=solver.names, all_joints=False)


def usual_speeds(asset: Articulation, joints: NDArray[np.int64], solver: ArmSolver) -> Floats:
    """(k,) rad/s or m/s: the smaller of file and drive, else pi rad/s or 1 m/s.

    Args:
        asset: The robot.
        joints: (k,) some of its joints.
        solver: The kinematics of a tool that these joints move.
    """
    parsed = asset.parsed
    limits = np.minimum(parsed.qvel_limits, parsed.max_velocity)[joints]
    is_hinge = solver.chain.hinges[np.isin(solver.chain.joints, joints)]
    usual = np.where(is_hinge, _USUAL_HINGE_SPEED, _USUAL_SLIDE_SPEED)
    is_limited = limits < UNLIMITED
    unlimited_names = [parsed.joint_names[i] for i in joints[~is_limited]]
    zero_names = [name for name in unlimited_names if name in parsed.zero_velocity]
    if zero_names:
        warn_once(
            _log,
            f'{parsed.path}: velocity="0" is taken as no limit for joints {", ".join(zero_names)}: '
            f"the tool is moved by at most {_USUAL_HINGE_SPEED:.3g} rad/s of a hinge and "
            f"{_USUAL_SLIDE_SPEED:g} m/s of a slide; drive_pros.max_velocity gives limits",
        )
    return np.where(is_limited, limits, usual)
