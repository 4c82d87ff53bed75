"""`Teleop`: the policy of a person who moves a robot's tool with keys, a gamepad or the mouse.

A viewer is the `Operator`: it makes a `ToolCommand` of what is pressed. The policy makes actions of
it, through the same action terms that other policies use.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.managers.param_types import Positive
from embodichain.utils.arrays import tensor_of
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.math import quat_rotate

if TYPE_CHECKING:
    import torch

    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.lab.gym.envs.mdp.actions.parallel_gripper import ParallelGripper
    from embodichain.lab.sim.engine.api import F64, EnvIndex
    from embodichain.lab.sim.types import EnvObs

__all__ = [
    "DISCARDED",
    "TELEOPERATED",
    "IdleOperator",
    "Operator",
    "Teleop",
    "ToolCommand",
    "ToolTerm",
    "Vector",
    "check_teleop",
]

_log = logging.getLogger(__name__)

Vector = tuple[float, float, float]
_ZERO: Vector = (0.0, 0.0, 0.0)
DISCARDED = "discarded by the operator"
"""What has failed in an episode that the operator discarded."""
TELEOPERATED = ("eef_delta_pose", "eef_pose", "operational_space")
"""The package's action terms with a tool that a person can move."""


@dataclass(frozen=True, slots=True)
class ToolCommand:
    """What an operator asks for at a moment. Without one, the tool stays where it is.

    Attributes:
        linear: Velocity along x, y, z, as a share of the largest, each in [-1, 1].
        angular: Rotation about x, y, z, likewise.
        axes: Of both: ``world``, the environment's, or ``tool``, the tool's own.
        speed: Factor of the largest velocities.
        goal: Position in the environment, m, to which the tool moves instead of `linear`; None for
            none.
        grips: How often the gripper was told to change between open and closed.
        switches: How often the next tool was chosen.
        ends: How often an episode was ended, which is then judged by the task.
        discards: How often an episode was discarded.
    """

    linear: Vector = _ZERO
    angular: Vector = _ZERO
    axes: Literal["world", "tool"] = "world"
    speed: float = 1.0
    goal: Vector | None = None
    grips: int = 0
    switches: int = 0
    ends: int = 0
    discards: int = 0


class Operator(Protocol):
    """Where commands come from: a viewer."""

    def command(self, begins: bool) -> ToolCommand:
        """Return the present command. Waits until an operator is connected or the run is stopped.

        Args:
            begins: Whether an episode begins: then it waits for something to be pressed, too.

        Raises:
            EmbodichainError: If the viewer is gone.
        """


class IdleOperator:
    """An `Operator` whose command moves nothing; `validate` takes a step with it."""

    def command(self, begins: bool) -> ToolCommand:
        """Return a command at which nothing moves."""
        return ToolCommand()


@runtime_checkable
class ToolTerm(Protocol):
    """An action term that moves a tool; poses are in the environment, quaternions wxyz."""

    def tool_pose(self) -> tuple[F64, F64]:
        """Measured position (N, 3) and orientation (N, 4) of the tool."""

    def target_pose(self) -> tuple[F64, F64]:
        """The pose that a motion is added to, (N, 3) and (N, 4)."""

    def action_for(self, shift: F64, turn: F64) -> F64:
        """(N, A) the actions that move the tool by (N, 3) metres and (N, 3) rotation vectors."""


class _Tool(NamedTuple):
    """A tool, its gripper if it has one, and their columns in the action."""

    name: str
    term: ToolTerm
    columns: slice
    gripper: ParallelGripper | None
    grip: slice


def check_teleop(terms: Mapping[str, tuple[str, Any]]) -> list[Problem]:
    """Check that one of a task's actions moves a tool.

    Args:
        terms: Name of an action term to its `func` in the config, and its class.
    """
    if any(isinstance(cls, type) and issubclass(cls, ToolTerm) for _, cls in terms.values()):
        return []
    actions = ", ".join(f"{name}: {func}" for name, (func, _) in terms.items())
    message = (
        f"teleop moves a tool: the task needs an action {', '.join(TELEOPERATED[:-1])} or "
        f"{TELEOPERATED[-1]}; its actions are {actions or 'joint positions'}"
    )
    return [Problem("policy", message)]


class Teleop:
    """A person moves the tool of one environment; without an operator the run waits.

    It needs `viewer=web` or `viewer=native`, one environment, and an action that moves a tool:
    `eef_delta_pose`, `eef_pose` or `operational_space`. A `parallel_gripper` of the same robot is
    opened and closed; further actions keep their targets. It is a `PlannedPolicy`: the operator
    says when an episode is done, or discards it, and either ends the episode.

    Args:
        linear_speed: Largest speed of the tool along an axis, m/s.
        angular_speed: Largest speed about an axis, rad/s.

    Attributes:
        operator: Where commands come from; set it before the first step.
        linear_speed, angular_speed: As given.
        max_steps: Control steps after which an episode ends; -1 for no limit.
    """

    operator: Operator | None

    def __init__(self, linear_speed: Positive = 0.25, angular_speed: Positive = 1.0) -> None:
        self.linear_speed = linear_speed
        self.angular_speed = angular_speed
        self.operator = None
        self.max_steps = -1
        self._tools: list[_Tool] = []
        self._tool = 0
        # Whether each tool's gripper is told to open; empty before the first step of an episode.
        self._open: list[bool] = []
        self._has_begun = False
        self._last_command = ToolCommand()
        self._done = np.zeros(1, np.bool_)
        self._failures: list[str | None] = [None]

    @property
    def done(self) -> NDArray[np.bool_]:
        """(1,) whether the operator has ended the episode."""
        return self._done

    @property
    def failures(self) -> list[str | None]:
        """Whether the operator discarded the episode, in words; else None."""
        return self._failures

    @property
    def robot_uid(self) -> str | None:
        """Uid of the robot of the active tool, if its action term names it."""
        return getattr(self._tools[self._tool].term, "robot_uid", None)

    @property
    def tool_names(self) -> list[str]:
        """The action terms of the tools; empty before `bind`."""
        return [tool.name for tool in self._tools]

    @property
    def active(self) -> int:
        """Index of the tool that moves."""
        return self._tool

    @property
    def axes(self) -> str:
        """``world`` or ``tool``: the axes of the present motion."""
        return self._last_command.axes

    def tool_pose(self) -> tuple[F64, F64]:
        """Position (3,) and orientation (4,) of the tool that moves."""
        pos, quat = self._tools[self._tool].term.tool_pose()
        return pos[0], quat[0]

    @property
    def is_open(self) -> bool | None:
        """Whether the gripper of the active tool was told to open; None without a gripper."""
        if self._tools[self._tool].gripper is None:
            return None
        are_open = self._open or self._initially_open()
        return are_open[self._tool]

    def bind(self, env: BaseEnv) -> None:
        """Find the tools of an environment; called by viewers and at the first step.

        Raises:
            ConfigError: If there is more than one environment, or no action that moves a tool.
        """
        if self._tools:
            return
        if env.num_envs != 1:
            message = f"policy: teleop moves one robot; set num_envs=1, not {env.num_envs}"
            raise ConfigError([Problem("num_envs", message)])
        self._tools = _tools_of(env)
        self.max_steps = int(env.max_episode_steps)

    def __call__(self, obs: EnvObs, env: BaseEnv) -> torch.Tensor:
        """Return the action (1, A) for the operator's present command.

        Raises:
            ConfigError: If there is no operator, or as for `bind`.
        """
        self.bind(env)
        if self.operator is None:
            message = "teleop needs a viewer: viewer=web or viewer=native"
            raise ConfigError([Problem("policy", message)])
        begins = not self._has_begun
        self._has_begun = True
        command = self.operator.command(begins)
        self._open = self._open or self._initially_open()
        if begins:
            # What was pressed before this episode does not end it.
            self._last_command = replace(
                self._last_command, ends=command.ends, discards=command.discards
            )
        self._follow_presses(command, env)
        active_tool = self._tools[self._tool]
        shift, turn = self._motion(command, active_tool.term, env.step_dt)
        action = env.action_manager.hold()
        action[:, active_tool.columns] = active_tool.term.action_for(shift, turn)
        for tool, is_open in zip(self._tools, self._open, strict=True):
            if tool.gripper is not None:
                action[:, tool.grip] = tool.gripper.high if is_open else tool.gripper.low
        return tensor_of(action.astype(np.float32))

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Begin an episode: the grippers are as the task begins."""
        self._open = []
        self._done = np.zeros(1, np.bool_)
        self._failures = [None]
        self._has_begun = False

    def _follow_presses(self, command: ToolCommand, env: BaseEnv) -> None:
        """Do what was pressed since the last step; each press counts once."""
        last = self._last_command
        self._last_command = command
        self._tool = (self._tool + command.switches - last.switches) % len(self._tools)
        if (command.grips - last.grips) % 2:
            self._open[self._tool] = not self._open[self._tool]
        is_discarded = command.discards > last.discards
        if is_discarded:
            self._failures = [DISCARDED]
            _log.info("control step %d: the operator discarded the episode", env.control_step)
        if is_discarded or command.ends > last.ends:
            self._done = np.ones(1, np.bool_)
            env.truncate(np.zeros(1, np.int64))

    def _motion(self, command: ToolCommand, term: ToolTerm, seconds: float) -> tuple[F64, F64]:
        """Metres (1, 3) and rotation vector (1, 3) of a step, in the environment's axes."""
        longest_shift = self.linear_speed * command.speed * seconds
        largest_turn = self.angular_speed * command.speed * seconds
        shift = np.array([command.linear]) * longest_shift
        turn = np.array([command.angular]) * largest_turn
        if command.axes == "tool":
            _, quat = term.target_pose()
            shift = quat_rotate(quat, shift)
            turn = quat_rotate(quat, turn)
        if command.goal is not None:
            pos, _ = term.target_pose()
            way = np.array([command.goal]) - pos
            shift = way * min(1.0, longest_shift / max(float(np.linalg.norm(way)), 1e-9))
        return shift, turn

    def _initially_open(self) -> list[bool]:
        """Whether each tool's gripper has an open target at present; True without a gripper."""
        return [tool.gripper is None or _is_open(tool.gripper) for tool in self._tools]


def _is_open(gripper: ParallelGripper) -> bool:
    """Whether the present command of a gripper is in the upper half of its range."""
    command = float(np.ravel(gripper.hold())[0])
    return command * 2 >= float(gripper.low[0] + gripper.high[0])


def _tools_of(env: BaseEnv) -> list[_Tool]:
    """The tools of an environment's actions, in their order.

    Raises:
        ConfigError: If there is none.
    """
    from embodichain.lab.gym.envs.mdp.actions.parallel_gripper import ParallelGripper

    manager = env.action_manager
    problems = check_teleop(
        {name: (str(term.cfg.func), type(term.instance)) for name, term in manager.terms.items()}
    )
    if problems:
        raise ConfigError(problems)
    terms = {name: term.instance for name, term in manager.terms.items()}
    grippers = {name: term for name, term in terms.items() if isinstance(term, ParallelGripper)}
    tools: list[_Tool] = []
    for name, term in terms.items():
        if not isinstance(term, ToolTerm):
            continue
        columns = manager.slices[name]
        tool = _Tool(name, term, columns, gripper=None, grip=columns)
        uid = getattr(term, "robot_uid", None)
        for gripper_name, gripper in grippers.items():
            if gripper.robot_uid == uid:
                # Of a robot with two tools, each gets another gripper, in their order.
                del grippers[gripper_name]
                tool = _Tool(name, term, columns, gripper, grip=manager.slices[gripper_name])
                break
        tools.append(tool)
    return tools
