"""A robot's tool by the entity of a term: `tool_links` names it, `arm_solver` moves it.

`moving_joints` are the joints that do.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
    from embodichain.lab.sim.solvers.arm_solver import ArmSolver

__all__ = ["arm_solver", "moving_joints", "tool_links"]


def tool_links(entity: ResolvedEntity) -> list[str]:
    """The name of the tool link; several or none where it is not unique.

    It is the tool point in the robot's `solver_cfg` for the picked control part (or the whole
    robot), else the farthest link that all picked joints move.
    """
    from embodichain.lab.sim.solvers.arm_solver import tool_bodies

    asset, parts = entity.asset, entity.control_parts or ("default",)
    if len(parts) == 1 and parts[0] in asset.parsed.tools:
        return [asset.parsed.tools[parts[0]]]
    bodies = list(asset.entity.body_ids)
    found = tool_bodies(asset, entity.joint_ids)
    return [asset.parsed.link_names[bodies.index(body)] for body in found]


def arm_solver(entity: ResolvedEntity, path: str = "entity_cfg") -> ArmSolver:
    """The kinematics of an entity's tool, with the settings of its control part.

    Args:
        entity: The robot; its picked joints move, its picked link is the tool (by default that of
            `tool_links`).
        path: The parameter, for messages.

    Raises:
        ConfigError: If there is no such link or more than one, or no picked joint moves it.
    """
    from embodichain.lab.sim.cfg import SolverCfg
    from embodichain.lab.sim.solvers.arm_solver import ArmSolver

    asset = entity.asset
    if not entity.joint_ids:
        raise ConfigError([Problem(f"{path}.uid", f"{entity.uid!r} has no joints")])
    links = list(entity.link_names) or tool_links(entity)
    if len(links) != 1:
        message = f"name one link as the tool; the picked joints suggest {links or 'none'}"
        raise ConfigError([Problem(f"{path}.link_names", message)])
    part = entity.control_parts[0] if len(entity.control_parts) == 1 else None
    settings = getattr(asset, "solver_cfg", lambda part: SolverCfg())(part)
    return ArmSolver(asset, entity.joint_ids, asset.body_of(links[0]), settings, path)


def moving_joints(entity: ResolvedEntity, solver: ArmSolver) -> ResolvedEntity:
    """The entity with those of its joints picked that move the tool, from root to tool."""
    joints = tuple(map(int, solver.moving))
    return dataclasses.replace(entity, joint_ids=joints, joint_names=solver.names, all_joints=False)
