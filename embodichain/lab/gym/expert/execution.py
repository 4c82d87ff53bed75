"""`Execution`: which instruction each arm of each environment performs, and what has failed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from embodichain.lab.gym.expert.arms import ControlledArm, arms_of
from embodichain.lab.gym.expert.fingers import Fingers, read_fingers, unclear_fingers
from embodichain.lab.gym.expert.grasps import NOTHING, Grasp
from embodichain.lab.gym.expert.instructions import EXACT, Facing, Grip, Instruction, Move, Wait
from embodichain.lab.gym.expert.program import Program, check_steps, targets_in
from embodichain.lab.gym.expert.pushes import Pushes
from embodichain.lab.gym.expert.targets import WORLD, TargetPoses, target_name
from embodichain.lab.gym.expert.tool_goals import ToolGoals, check_orientations
from embodichain.lab.gym.expert.touches import obstacles
from embodichain.lab.gym.expert.trajectories import ToolPath, as_place
from embodichain.utils.errors import ConfigError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.lab.sim.engine.api import F64, EnvIndex
    from embodichain.utils.array_types import EnvIds

    Ints = NDArray[np.int64]
    Mask = NDArray[np.bool_]

__all__ = ["Execution"]

_NO_INSTRUCTION = -1
_BEFORE_FIRST_PHASE = -1
_ARRIVAL_TIMEOUT_S = 2.0
"""Time after the end of its path in which the tool must arrive."""
_EXACT_TURN = 0.03
"""Angle in rad within which the tool must be turned where its position must be exact."""
_COARSE_TURN = 0.2
"""Angle in rad elsewhere."""
_SHORTEST_GRIP_STEPS = 3
"""Control steps before fingers are asked whether they rest: at first they have not moved yet."""
_LONGEST_GRIP_S = 2.0
"""Time after which fingers are taken to rest."""
_UNMEASURED_GRIP_S = 0.5
"""Time after which they are, where the opening of the gripper cannot be measured."""


class _ArmExecution:
    """One arm: its tool, its gripper, and how far it has come with its instruction.

    Attributes:
        controlled: The arm.
        path: Its tool on its way.
        grasp: What its gripper holds.
        goals: Where its tool has to be.
        instruction: (N,) index into the program, or -1.
        elapsed_steps: (N,) control steps since it began.
        wait_steps: (N,) control steps that a `Wait` takes.
    """

    def __init__(
        self,
        env: BaseEnv,
        arm: ControlledArm,
        fingers: Fingers,
        objects: list[Any],
        targets: TargetPoses,
    ) -> None:
        self.controlled = arm
        self.path = ToolPath(arm, env.num_envs, env.step_dt)
        self.grasp = Grasp(env, arm, self.path, fingers, objects, targets)
        self.goals = ToolGoals(arm, self.path, fingers, self.grasp, targets)
        self.instruction: Ints = np.full(env.num_envs, _NO_INSTRUCTION, np.int64)
        self.elapsed_steps: Ints = np.zeros(env.num_envs, np.int64)
        self.wait_steps: Ints = np.zeros(env.num_envs, np.int64)

    def reset(self, env_ids: EnvIds) -> None:
        """Begin anew: the tool rests where it is, the gripper goes home."""
        self.instruction[env_ids] = _NO_INSTRUCTION
        self.path.rest(env_ids)
        self.grasp.reset(env_ids)


class Execution:
    """The steps of a task under way.

    Each phase of the program has a list of instructions for each arm. Arms perform theirs side by
    side; the next phase begins in an environment when all of them are done.

    Args:
        env: The environment.
        values: The steps, as in a task file.
        pushes: Standard deviation of pushes, as a share of half the actions' range.

    Attributes:
        env: The environment.
        done: (N,) whether nothing is left to do.
        failures: For each environment the step that failed and why, or None.

    Raises:
        ConfigError: If the steps are wrong or cannot be done in this environment.
    """

    def __init__(self, env: BaseEnv, values: Sequence[Any], pushes: float = 0.0) -> None:
        self.env = env
        pairs = arms_of(env)
        declared_arms = [declared for declared, _ in pairs]
        arms = [arm for _, arm in pairs]
        steps, problems = check_steps(values, declared_arms)
        targets = TargetPoses(env)
        for path, target in targets_in(steps):
            try:
                targets.add(target, path)
            except ConfigError as error:
                problems += error.problems
        # Later checks need steps, arms and targets that are right.
        problems = problems or check_orientations(steps, arms, declared_arms)
        fingers = [read_fingers(arm) for arm in arms]
        problems = problems or unclear_fingers(steps, pairs, fingers)
        if problems:
            raise ConfigError(problems)
        targets.add(WORLD, "")

        self._program = Program(steps, declared_arms)
        objects = self._program.taken()
        self._arms = [
            _ArmExecution(env, arm, arm_fingers, objects, targets)
            for arm, arm_fingers in zip(arms, fingers, strict=True)
        ]
        self._pushes = Pushes(env, arms, pushes) if pushes else None
        instructions = self._program.instructions
        self._is_move = _mark(instructions, Move)
        self._is_grip = _mark(instructions, Grip)
        self._is_wait = _mark(instructions, Wait)
        self._tolerance = _tolerances(instructions)
        self._phase: Ints = np.full(env.num_envs, _BEFORE_FIRST_PHASE, np.int64)
        self._is_new_episode: Mask = np.ones(env.num_envs, np.bool_)
        self.done: Mask = np.zeros(env.num_envs, np.bool_)
        self.failures: list[str | None] = [None] * env.num_envs

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Begin anew in these environments, at the next action."""
        env_ids = np.arange(self.env.num_envs) if env_ids is None else np.asarray(env_ids)
        self._is_new_episode[env_ids] = True
        self.done[env_ids] = False
        for env_id in env_ids:
            self.failures[env_id] = None

    def act(self) -> F64:
        """(N, A) the next actions, within the bounds of the action space."""
        for arm in self._arms:
            arm.path.measure()
        self._begin_episodes()
        for arm in self._arms:
            arm.grasp.measure()
            for target, env_ids in arm.grasp.find_dropped(is_watched=~self.done):
                self._fail(arm, env_ids, f"the gripper has lost {target_name(target)}")
        # An instruction may be over as soon as it begins: at most all of them are.
        for _ in range(len(self._program.instructions) + 1):
            if not self._advance():
                break
        for arm in self._arms:
            arm.elapsed_steps += 1
        return self._command()

    # -- the course of the program -----------------------------------------------------------------

    def _begin_episodes(self) -> None:
        """Set out in environments whose episode begins."""
        env_ids = np.flatnonzero(self._is_new_episode)
        if not len(env_ids):
            return
        self._is_new_episode[env_ids] = False
        self._phase[env_ids] = _BEFORE_FIRST_PHASE
        for arm in self._arms:
            arm.reset(env_ids)

    def _advance(self) -> bool:
        """Go on to the next instruction where one is over; return whether any was."""
        is_over: list[Mask] = []
        for arm in self._arms:
            has_arrived = self._has_arrived(arm)
            self._fail_late_moves(arm, has_arrived)
            is_over.append(self._is_over(arm, has_arrived))
        # A failure of one arm ends the program for all arms of its environment.
        for over in is_over:
            over &= ~self.done
        if not any(over.any() for over in is_over):
            return False
        for index, arm, env_ids in self._by_instruction(is_over):
            self._finish(index, arm, env_ids)
        begins: list[Mask] = []
        # An arm without an instruction has index -1, which finds the last entry: it stays without.
        following = np.append(self._program.next, _NO_INSTRUCTION)
        for arm, over in zip(self._arms, is_over, strict=True):
            over &= ~self.done  # what has failed goes on nowhere
            arm.instruction = np.where(over, following[arm.instruction], arm.instruction)
            begins.append(over & (arm.instruction != _NO_INSTRUCTION))
        self._begin_phases(begins)
        for index, arm, env_ids in self._by_instruction(begins):
            self._start(index, arm, env_ids)
        return True

    def _by_instruction(self, masks: Sequence[Mask]) -> list[tuple[int, _ArmExecution, EnvIds]]:
        """Return the instructions of arms in some environments, in order, with their numbers.

        Args:
            masks: For each arm, (N,) the environments.
        """
        parts = [
            (index, arm, np.flatnonzero(mask & (arm.instruction == index)))
            for arm, mask in zip(self._arms, masks, strict=True)
            for index in np.unique(arm.instruction[mask]).tolist()
            if index != _NO_INSTRUCTION
        ]
        return sorted(parts, key=lambda part: part[0])

    def _begin_phases(self, begins: list[Mask]) -> None:
        """Begin the next phase where all arms are idle; mark the instructions that begin."""
        is_idle = ~self.done
        for arm in self._arms:
            is_idle &= arm.instruction == _NO_INSTRUCTION
        env_ids = np.flatnonzero(is_idle)
        self._phase[env_ids] += 1
        is_end = self._phase[env_ids] >= len(self._program.first)
        self.done[env_ids[is_end]] = True
        env_ids = env_ids[~is_end]
        for number, (arm, begin) in enumerate(zip(self._arms, begins, strict=True)):
            arm.instruction[env_ids] = self._program.first[self._phase[env_ids], number]
            begin[env_ids] = arm.instruction[env_ids] != _NO_INSTRUCTION

    def _is_over(self, arm: _ArmExecution, has_arrived: Mask) -> Mask:
        """(N,) whether an arm's instruction is over.

        Args:
            arm: The arm.
            has_arrived: (N,) the result of `_has_arrived`.
        """
        index = arm.instruction
        over: Mask = self._is_move[index] & has_arrived
        over |= self._is_grip[index] & self._has_gripped(arm)
        over |= self._is_wait[index] & (arm.elapsed_steps >= arm.wait_steps)
        # At the start nothing is under way: that counts as over, so that the first phase begins.
        over |= self._phase == _BEFORE_FIRST_PHASE
        return over

    def _has_arrived(self, arm: _ArmExecution) -> Mask:
        """(N,) whether an arm's tool is at the end of its path."""
        path = arm.path
        tolerance = self._tolerance[arm.instruction]
        distance, angle = path.remaining()
        is_exact = tolerance < EXACT
        is_near = (distance <= tolerance) & (angle <= np.where(is_exact, _EXACT_TURN, _COARSE_TURN))
        is_near &= path.at_rest() | ~is_exact
        is_waypoint = ~np.isfinite(tolerance)  # passed without stopping
        return path.is_at_end() & (is_near | is_waypoint)

    def _fail_late_moves(self, arm: _ArmExecution, has_arrived: Mask) -> None:
        """Fail the environments in which an arm's tool has had its time and has not arrived.

        Args:
            arm: The arm.
            has_arrived: (N,) the result of `_has_arrived`.
        """
        path = arm.path
        deadline = path.steps + self._in_steps(_ARRIVAL_TIMEOUT_S)
        is_late = self._is_move[arm.instruction] & (arm.elapsed_steps > deadline)
        is_late &= ~has_arrived & ~self.done
        if not is_late.any():
            return
        distance, angle = path.remaining()
        for env_id in np.flatnonzero(is_late).tolist():
            gap = f"{1000 * distance[env_id]:.0f} mm and {angle[env_id]:.2f} rad from its goal"
            why = f"the tool has not arrived, it is {gap}: {self._obstacles(arm, env_id)}"
            self._fail(arm, np.array([env_id]), why)

    def _has_gripped(self, arm: _ArmExecution) -> Mask:
        """(N,) whether an arm's fingers have come to rest, or had time to."""
        elapsed_steps = arm.elapsed_steps
        if not arm.grasp.is_measured:
            shorter = min(_UNMEASURED_GRIP_S, _LONGEST_GRIP_S)
            return elapsed_steps >= self._in_steps(shorter)
        rests: Mask = arm.grasp.has_come_to_rest() & (elapsed_steps >= _SHORTEST_GRIP_STEPS)
        return rests | (elapsed_steps >= self._in_steps(_LONGEST_GRIP_S))

    def _in_steps(self, seconds: float) -> int:
        """Return a time in control steps."""
        return round(seconds / self.env.step_dt)

    # -- instructions ------------------------------------------------------------------------------

    def _start(self, index: int, arm: _ArmExecution, env_ids: EnvIds) -> None:
        """Begin an instruction in some environments."""
        instruction = self._program.instructions[index]
        arm.elapsed_steps[env_ids] = 0
        if isinstance(instruction, Wait):
            arm.wait_steps[env_ids] = max(1, self._in_steps(instruction.seconds))
        elif isinstance(instruction, Grip):
            arm.grasp.start(env_ids, instruction.opens)
        elif isinstance(instruction, Move):
            self._start_move(instruction, arm, env_ids)

    def _start_move(self, move: Move, arm: _ArmExecution, env_ids: EnvIds) -> None:
        """Plan the path of a tool from where it is."""
        if move.goal.held:
            is_empty = arm.grasp.object[env_ids] == NOTHING
            self._fail(arm, env_ids[is_empty], "the gripper holds nothing")
            env_ids = env_ids[~is_empty]
        if not len(env_ids):
            return
        pos, quat = arm.goals.pose(move.goal, env_ids)
        is_reachable = self._plan(arm, move, env_ids, pos, quat)
        # Where a joint's limit is in the way, other directions that are as good.
        symmetry = move.goal.turn.symmetry if isinstance(move.goal.turn, Facing) else 1
        for turns in range(1, symmetry):
            missed = np.flatnonzero(~is_reachable)
            if not len(missed):
                break
            other_pos, other_quat = arm.goals.pose(move.goal, env_ids[missed], turns)
            is_reachable[missed] = self._plan(arm, move, env_ids[missed], other_pos, other_quat)
        for env_id, place in zip(env_ids[~is_reachable], pos[~is_reachable], strict=True):
            reason = arm.path.unreachable[int(env_id)]
            why = f"no straight line of the tool to {as_place(place)}: {reason}"
            self._fail(arm, np.array([env_id]), why)

    def _plan(
        self, arm: _ArmExecution, move: Move, env_ids: EnvIds, pos: F64, quat: F64
    ) -> NDArray[np.bool_]:
        """Plan a path of a tool to poses; (n,) whether they can be reached."""
        return arm.path.plan(
            env_ids,
            pos,
            quat,
            move.speed,
            free=move.goal.free,
            along=move.goal.along,
        )

    def _finish(self, index: int, arm: _ArmExecution, env_ids: EnvIds) -> None:
        """See what an instruction has achieved: what a gripper closed on."""
        instruction = self._program.instructions[index]
        if isinstance(instruction, Grip) and instruction.takes is not None:
            empty = arm.grasp.take(env_ids, instruction.takes)
            self._fail(arm, empty, "the fingers closed on nothing")

    def _fail(self, arm: _ArmExecution, env_ids: EnvIds, why: str) -> None:
        """Stop in these environments: all arms stay where they are."""
        for env_id in env_ids[~self.done[env_ids]]:
            index = arm.instruction[env_id]
            if index == _NO_INSTRUCTION:  # it has finished: the failure is another arm's
                index = max(other.instruction[env_id] for other in self._arms)
            self.failures[env_id] = f"{self._program.instructions[index].step}: {why}"
            self.done[env_id] = True
            for other in self._arms:
                other.path.stop(env_id)

    def _obstacles(self, arm: _ArmExecution, env_id: int) -> str:
        """Return what an arm's robot, and what the arm holds, touches in an environment."""
        robot = frozenset(map(int, arm.controlled.asset.index.body_ids))
        return obstacles(self.env.sim.engine, env_id, robot, arm.grasp.held_bodies(env_id))

    # -- actions -----------------------------------------------------------------------------------

    def _command(self) -> F64:
        """Take each tool one step along its path, hold everything else; return (N, A) actions."""
        manager = self.env.action_manager
        if len(manager):
            action: F64 = manager.hold()
        else:  # a class's own actions: those of its only arm
            action = np.zeros((self.env.num_envs, self._arms[0].controlled.columns.stop))
        for arm in self._arms:
            is_moving = self._is_move[arm.instruction] & ~self.done
            action[:, arm.controlled.columns] = arm.path.advance(is_moving)
            if arm.controlled.gripper is not None:
                action[:, arm.controlled.fingers] = arm.grasp.command[:, None]
        if self._pushes is None:
            return action
        return self._pushes.add_pushes(action, self.done)


def _mark(instructions: Sequence[Instruction], kind: type[Instruction]) -> Mask:
    """(I + 1,) whether each is of a kind; `_NO_INSTRUCTION` finds the last entry, False."""
    return np.array([*(isinstance(item, kind) for item in instructions), False])


def _tolerances(instructions: Sequence[Instruction]) -> F64:
    """(I + 1,) metres: how near each must come; inf for waypoints and for what does not move."""
    tolerances = [item.tolerance if isinstance(item, Move) else None for item in instructions]
    return np.array([np.inf if value is None else value for value in [*tolerances, None]])
