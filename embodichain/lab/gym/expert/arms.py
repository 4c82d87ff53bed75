"""The arms of a task: which action terms move a tool along a path, and which grippers they have."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from embodichain.lab.gym.envs.managers.terms.aliases import AliasSpec
from embodichain.lab.gym.envs.managers.terms.registry import resolve_term
from embodichain.lab.gym.envs.mdp._tools import usual_speeds
from embodichain.lab.gym.envs.mdp.actions.eef_action import EefTerm
from embodichain.lab.gym.envs.mdp.actions.joint_action import JointAction
from embodichain.lab.gym.envs.mdp.actions.operational_space import OperationalSpace
from embodichain.lab.gym.envs.mdp.actions.parallel_gripper import ParallelGripper
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.lab.gym.envs.cfg import EnvCfg
    from embodichain.lab.gym.envs.mdp._tools import MovesTool, Orientation
    from embodichain.lab.sim.engine.api import F64
    from embodichain.lab.sim.objects.arms.arm_solver import ArmSolver
    from embodichain.lab.sim.objects.articulation import Articulation
    from embodichain.lab.sim.objects.robot import Robot

__all__ = ["ControlledArm", "arms_of", "declared_arms", "find_arm"]

_TOOL_TERMS = (EefTerm, OperationalSpace, JointAction)
"""Classes of action terms that move a tool along a path; joint actions if they are positions."""
_TOOL_TERM_NAMES = "eef_delta_pose, eef_pose, operational_space, joint_action (positions)"


@dataclass(frozen=True)
class DeclaredArm:
    """An arm as the config of a task declares it.

    Attributes:
        name: Its action term.
        uid: Its robot.
        gripper: The action term of its gripper, or None.
    """

    name: str
    uid: str
    gripper: str | None


@dataclass(frozen=True)
class ControlledArm:
    """An arm of an environment, and the actions that control it.

    Attributes:
        name: Its action term; empty without action terms.
        asset: Its robot.
        term: The action term that moves its tool.
        columns: Those of the term in the action.
        gripper: The action term of its gripper, or None.
        fingers: Those of the gripper in the action.
    """

    name: str
    asset: Articulation
    term: MovesTool
    columns: slice
    gripper: ParallelGripper | None
    fingers: slice


def declared_arms(cfg: EnvCfg, allow_import: bool = True) -> list[DeclaredArm]:
    """The arms that a task's actions declare; terms that cannot be found are left out."""
    # Name of the action term -> uid of its robot.
    tools: dict[str, str] = {}
    grippers: dict[str, str] = {}
    for name, action in cfg.actions.items():
        try:
            spec = resolve_term("action", action.func, allow_import=allow_import)
        except ConfigError:
            continue
        term_class: Any = spec.target.func if isinstance(spec, AliasSpec) else spec.func
        if not isinstance(term_class, type):
            continue
        uid = _uid_of(action.params.get("of", action.params.get("entity_cfg")))
        if issubclass(term_class, ParallelGripper):
            grippers[name] = uid
        elif issubclass(term_class, _TOOL_TERMS) and _commands_positions(action.params):
            tools[name] = uid
    return [DeclaredArm(name, uid, _gripper_of(name, uid, grippers)) for name, uid in tools.items()]


def _uid_of(reference: Any) -> str:
    """The uid in a reference to an entity, a map or an object."""
    uid = None
    if isinstance(reference, Mapping):
        uid = reference.get("uid")
    return str(uid or getattr(reference, "uid", ""))


def _commands_positions(params: Mapping[str, Any]) -> bool:
    """Whether an action commands positions; only joint actions have other controls."""
    return bool(params.get("control", "position") == "position")


def _gripper_of(arm: str, uid: str, grippers: Mapping[str, str]) -> str | None:
    """The gripper of an arm: that of its robot; of several the one with the most similar name.

    Args:
        arm: The action term of the arm.
        uid: Its robot.
        grippers: Action terms of grippers -> their robots.
    """
    words = set(arm.split("_"))
    candidates = [name for name, robot in grippers.items() if robot == uid]
    return max(candidates, key=lambda name: len(words & set(name.split("_"))), default=None)


def find_arm(name: str, arms: Iterable[DeclaredArm], path: str, key: str = "arm") -> DeclaredArm:
    """The arm with a name, that of its action term or of its robot; "" is the only one.

    Raises:
        ConfigError: If there is none, or more than one.
    """
    arms = list(arms)
    matching_arms = [arm for arm in arms if name in ("", arm.name, arm.uid)]
    if len(matching_arms) == 1:
        return matching_arms[0]
    if not arms:
        message = f"no action moves a tool along a path; these can: {_TOOL_TERM_NAMES}"
        raise ConfigError([Problem(path, message)])
    names = sorted({arm.name for arm in arms} | {arm.uid for arm in arms})
    allowed = ", ".join(names)
    path = f"{path}.{key}"
    if not name:
        message = f"missing value: which arm; there are: {allowed}"
        raise ConfigError([Problem(path, message)])
    if matching_arms:
        message = f"more than one arm is {name!r}; there are: {allowed}."
        raise ConfigError([Problem(path, message)])
    message = f"there is no arm {name!r}; there are: {allowed}."
    raise ConfigError([Problem(path, message, did_you_mean(name, names).strip())])


def arms_of(env: BaseEnv) -> list[tuple[DeclaredArm, ControlledArm]]:
    """The arms of an environment, in the order of its actions."""
    manager = env.action_manager
    if not len(manager):
        return _whole_robot(env)
    instances = {name: term.instance for name, term in manager.terms.items()}
    grippers = {name: term for name, term in instances.items() if isinstance(term, ParallelGripper)}
    robot_of_gripper = {name: gripper.asset.uid for name, gripper in grippers.items()}
    arms: list[tuple[DeclaredArm, ControlledArm]] = []
    for name, term in instances.items():
        if not isinstance(term, _TOOL_TERMS) or not _has_tool(term):
            continue
        asset = term.asset
        gripper_name = _gripper_of(name, asset.uid, robot_of_gripper)
        gripper: ParallelGripper | None = None
        fingers = slice(0, 0)
        if gripper_name is not None:
            gripper = grippers[gripper_name]
            fingers = manager.slices[gripper_name]
        arm = ControlledArm(
            name=name,
            asset=asset,
            term=cast("MovesTool", term),
            columns=manager.slices[name],
            gripper=gripper,
            fingers=fingers,
        )
        arms.append((DeclaredArm(name, asset.uid, gripper_name), arm))
    return arms


def _has_tool(term: Any) -> bool:
    """Whether joints of an action move a tool; a term without a solver has none."""
    try:
        return bool(len(term.solver.moving))
    except ConfigError:
        return False


def _whole_robot(env: BaseEnv) -> list[tuple[DeclaredArm, ControlledArm]]:
    """The robot of an environment without action terms, whose actions are joint positions."""
    robot = env.robot
    if robot is None or env.single_action_space.shape != (len(env.active_joint_ids),):
        return []
    try:
        term = _JointTargets(robot, env.active_joint_ids)
    except (ConfigError, ValueError):
        return []
    arm = ControlledArm(
        name="",
        asset=robot,
        term=term,
        columns=slice(0, len(env.active_joint_ids)),
        gripper=None,
        fingers=slice(0, 0),
    )
    return [(DeclaredArm("", robot.uid, None), arm)]


class _JointTargets:
    """Joint positions of a robot as a `MovesTool`."""

    orientation: Orientation = "any"
    tool_speeds = (np.inf, np.inf)
    joint_range = None

    def __init__(self, robot: Robot, joints: Iterable[int]) -> None:
        self._robot = robot
        self._joints = list(joints)
        parts_with_tool = [part for part in robot.control_parts if part in robot.parsed.tools]
        part = parts_with_tool[0] if len(parts_with_tool) == 1 else None
        self.solver: ArmSolver = robot.get_solver(part)
        self._columns = [self._joints.index(int(joint)) for joint in self.solver.moving]
        self.joint_speeds: F64 = usual_speeds(robot, self.solver.moving, self.solver)

    def action_towards(self, pos: F64, quat: F64, qpos: F64) -> F64:
        """(N, A) joint positions; those that do not move the tool keep their targets."""
        target: F64 = self._robot.drives.read_target_qpos()[:, self._joints]
        target[:, self._columns] = qpos
        return target
