"""The arms of a task: which action terms move a tool along a path, and which grippers they have."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from embodichain.lab.gym.envs.managers.terms.aliases import AliasSpec
from embodichain.lab.gym.envs.managers.terms.registry import resolve_term
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
    from embodichain.lab.sim.objects.robot import Robot

__all__ = ["Arm", "arms_of", "declared_arms", "find_arm"]

_TOOLS = (EefTerm, OperationalSpace, JointAction)
_ABLE = "eef_delta_pose, eef_pose, operational_space, joint_action (positions)"


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
class Arm:
    """An arm of an environment.

    Attributes:
        name: Its action term; empty without action terms.
        asset: Its robot.
        term: The action term that moves its tool.
        columns: Those of the term in the action.
        gripper: The action term of its gripper, or None.
        fingers: Those of the gripper in the action.
    """

    name: str
    asset: Any
    term: MovesTool
    columns: slice
    gripper: ParallelGripper | None
    fingers: slice


def declared_arms(cfg: EnvCfg, allow_import: bool = True) -> list[DeclaredArm]:
    """The arms that a task's actions declare; terms that cannot be found are left out."""
    tools: list[tuple[str, str]] = []
    grippers: list[tuple[str, str]] = []
    for name, action in cfg.actions.items():
        try:
            spec = resolve_term("action", action.func, allow_import=allow_import)
        except ConfigError:
            continue
        cls: Any = spec.target.func if isinstance(spec, AliasSpec) else spec.func
        reference: Any = action.params.get("of", action.params.get("entity_cfg"))
        uid = reference.get("uid") if isinstance(reference, Mapping) else None
        uid = uid or getattr(reference, "uid", "")
        if isinstance(cls, type) and issubclass(cls, ParallelGripper):
            grippers.append((name, str(uid)))
        elif isinstance(cls, type) and issubclass(cls, _TOOLS) and _positions(action.params):
            tools.append((name, str(uid)))
    return [DeclaredArm(name, uid, _gripper_of(name, uid, grippers)) for name, uid in tools]


def _positions(params: Mapping[str, Any]) -> bool:
    return bool(params.get("control", "position") == "position")


def _gripper_of(arm: str, uid: str, grippers: Iterable[tuple[str, str]]) -> str | None:
    """The gripper of an arm: that of its robot; of several the one with the most similar name."""
    own = [name for name, other in grippers if other == uid]
    shared = {name: len(set(name.split("_")) & set(arm.split("_"))) for name in own}
    return max(own, key=lambda name: shared[name], default=None)


def find_arm(name: str, arms: Iterable[DeclaredArm], path: str, key: str = "arm") -> DeclaredArm:
    """The arm with a name, that of its action term or of its robot; "" is the only one.

    Raises:
        ConfigError: If there is none, or more than one.
    """
    arms = list(arms)
    found = [arm for arm in arms if name in (arm.name, arm.uid)] if name else arms
    if len(found) == 1:
        return found[0]
    names = sorted({arm.name for arm in arms} | {arm.uid for arm in arms})
    there = ", ".join(names) or "none"
    if not arms:
        message = f"no action moves a tool along a path; these can: {_ABLE}"
        raise ConfigError([Problem(path, message)])
    if not name:
        raise ConfigError(
            [Problem(f"{path}.{key}", f"missing value: which arm; there are: {there}")]
        )
    what = "there is no arm" if not found else "more than one arm is"
    hint = did_you_mean(name, names).strip() if not found else ""
    raise ConfigError([Problem(f"{path}.{key}", f"{what} {name!r}; there are: {there}.", hint)])


def arms_of(env: BaseEnv) -> list[tuple[DeclaredArm, Arm]]:
    """The arms of an environment, in the order of its actions."""
    manager = env.action_manager
    if not len(manager):
        return _whole_robot(env)
    instances = {name: term.instance for name, term in manager.terms.items()}
    grippers = {n: t for n, t in instances.items() if isinstance(t, ParallelGripper)}
    uids = [(name, gripper.asset.uid) for name, gripper in grippers.items()]
    found = []
    for name, term in instances.items():
        if not isinstance(term, _TOOLS) or not _has_tool(term):
            continue
        asset: Any = term.asset
        own = _gripper_of(name, asset.uid, uids)
        gripper = grippers.get(own or "")
        fingers = manager.slices[own] if own else slice(0, 0)
        columns = manager.slices[name]
        arm = Arm(name, asset, cast("MovesTool", term), columns, gripper, fingers)
        found.append((DeclaredArm(name, asset.uid, own), arm))
    return found


def _has_tool(term: Any) -> bool:
    try:
        return bool(len(term.solver.moving))
    except ConfigError:
        return False


def _whole_robot(env: BaseEnv) -> list[tuple[DeclaredArm, Arm]]:
    """The robot of an environment without action terms, whose actions are joint positions."""
    robot = env.robot
    if robot is None or env.single_action_space.shape != (len(env.active_joint_ids),):
        return []
    try:
        term = _JointTargets(robot, env.active_joint_ids)
    except (ConfigError, ValueError):
        return []
    columns = slice(0, len(env.active_joint_ids))
    arm = Arm("", robot, term, columns, None, slice(0, 0))
    return [(DeclaredArm("", robot.uid, None), arm)]


class _JointTargets:
    """Joint positions of a robot as a `MovesTool`."""

    orientation: Orientation = "any"
    tool_speeds = (np.inf, np.inf)

    def __init__(self, robot: Robot, joints: Iterable[int]) -> None:
        from embodichain.lab.gym.envs.mdp._tools import usual_speeds

        self._robot, self._joints = robot, list(joints)
        parts = [part for part in robot.control_parts if part in robot.parsed.tools]
        self.solver: ArmSolver = robot.get_solver(parts[0] if len(parts) == 1 else None)
        self._columns = [self._joints.index(int(joint)) for joint in self.solver.moving]
        self.joint_speeds: F64 = usual_speeds(robot, self.solver.moving, self.solver)

    def action_towards(self, pos: F64, quat: F64, qpos: F64) -> F64:
        """(N, A) joint positions; those that do not move the tool keep their targets."""
        target: F64 = self._robot.drives.read_target_qpos()[:, self._joints]
        target[:, self._columns] = qpos
        return target
