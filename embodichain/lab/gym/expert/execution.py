"""`Execution`: which instruction each arm of each environment performs, and what has failed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from embodichain.lab.gym.expert.arms import Arm, DeclaredArm, arms_of, find_arm
from embodichain.lab.gym.expert.fingers import read_fingers, unclear_fingers
from embodichain.lab.gym.expert.instructions import EXACT, Goal, Grip, Move, Wait
from embodichain.lab.gym.expert.program import Program, check_steps, targets_in
from embodichain.lab.gym.expert.pushes import Pushes
from embodichain.lab.gym.expert.reading import ReadStep
from embodichain.lab.gym.expert.targets import WORLD, TargetPoses, target_name
from embodichain.lab.gym.expert.touches import is_touching, obstacles
from embodichain.lab.gym.expert.trajectories import ToolPath, as_place, length
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.math import (
    euler_xyz_to_quat,
    quat_conjugate,
    quat_multiply,
    quat_rotate,
    quat_to_matrix,
    rotvec_to_quat,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.lab.sim.engine.api import F64, EnvIndex

    Rows = NDArray[np.int64]

__all__ = ["Execution"]

_MOVE, _GRIP, _WAIT, _IDLE = range(4)
_PATIENCE = 2.0
"""Seconds after the end of its path in which the tool must arrive."""
_TURN_TOLERANCES = 0.03, 0.2
"""Rad: how exact the tool's orientation must be where its position must be exact, and elsewhere."""
_FINGERS_REST = 0.003
"""Share of the gripper's opening: fingers that move less in a control step rest."""
_FINGERS_TIME = 2.0, 0.5
"""Seconds after which fingers are taken to rest, and where their opening cannot be measured."""
_NOTHING = 0.01
"""Share of the gripper's opening that is left when it closes on nothing."""
_SLIP = 0.03
"""M: what moves farther in the gripper since it was grasped has been dropped."""
_VERTICAL = 0.7
"""The z component of the axis of a tool that points up or down."""


class Execution:
    """The steps of a task under way.

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
        self.env, count = env, env.num_envs
        pairs = arms_of(env)
        declared = [one for one, _ in pairs]
        steps, problems = check_steps(values, declared)
        self._targets = TargetPoses(env)
        for path, target in targets_in(steps):
            try:
                self._targets.add(target, path)
            except ConfigError as error:
                problems += error.problems
        problems = problems or _orientations(steps, [arm for _, arm in pairs], declared)
        self._fingers = [read_fingers(arm) for _, arm in pairs]
        problems = problems or unclear_fingers(steps, pairs, self._fingers)
        if problems:
            raise ConfigError(problems)
        self._targets.add(WORLD, "")
        self._program = program = Program(steps, declared)
        self._arms: list[Arm] = [arm for _, arm in pairs]
        self._paths = [ToolPath(arm, count, env.step_dt) for arm in self._arms]
        kinds = {Move: _MOVE, Grip: _GRIP, Wait: _WAIT}
        self._kinds = np.array([*(kinds[type(one)] for one in program.instructions), _IDLE])
        close = [one.tolerance if isinstance(one, Move) else None for one in program.instructions]
        self._tolerances = np.array([np.inf if one is None else one for one in [*close, None]])
        self._taken = program.taken()
        self._taken_bodies = [self._targets.bodies(target) for target in self._taken]
        self._shape = count, sum(env.single_action_space.shape or ())
        shape = count, len(self._arms)
        self._phase: Rows = np.zeros(count, np.int64)
        self._now: Rows = np.full(shape, -1)  # the instruction that each arm performs, or -1
        self._steps: Rows = np.zeros(shape, np.int64)  # control steps since it began
        self._limit: Rows = np.zeros(shape, np.int64)  # of waiting
        self._command: F64 = np.zeros(shape)  # of the gripper
        self._opening: F64 = np.zeros(shape)
        self._still: Rows = np.zeros(shape, np.int64)  # control steps in which fingers rested
        self._held: Rows = np.full(shape, -1)  # what is held, a number in _taken
        self._grasp: F64 = np.zeros((*shape, 3))  # its position in the tool's axes
        self._fresh = np.ones(count, np.bool_)
        self._pushes = Pushes(env, self._arms, pushes) if pushes else None
        self.done: NDArray[np.bool_] = np.zeros(count, np.bool_)
        self.failures: list[str | None] = [None] * count

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Begin anew in these environments, at the next action."""
        rows = np.arange(self.env.num_envs) if env_ids is None else np.asarray(env_ids)
        self._fresh[rows] = True
        self.done[rows] = False
        for row in rows:
            self.failures[row] = None

    def act(self) -> F64:
        """(N, A) the next actions, within the bounds of the action space."""
        for path in self._paths:
            path.measure()
        self._begin()
        self._look()
        for _ in range(len(self._program.instructions) + 1):
            if not self._proceed():
                break
        self._steps += 1
        return self._action()

    # -- what happens ------------------------------------------------------------------------------

    def _begin(self) -> None:
        """Set out in environments whose episode begins."""
        rows = np.flatnonzero(self._fresh)
        if not len(rows):
            return
        self._fresh[rows] = False
        self._phase[rows], self._now[rows], self._held[rows] = -1, -1, -1
        for a, (arm, path) in enumerate(zip(self._arms, self._paths, strict=True)):
            path.rest(rows)
            if arm.gripper is not None:
                self._command[rows, a] = arm.gripper.home()

    def _look(self) -> None:
        """See whether fingers rest and what they hold is still there."""
        for a, arm in enumerate(self._arms):
            opening = None if arm.gripper is None else arm.gripper.opening()
            if opening is not None:
                rests = np.abs(opening - self._opening[:, a]) < _FINGERS_REST
                self._still[:, a] = np.where(rests, self._still[:, a] + 1, 0)
                self._opening[:, a] = opening
            for number, target in enumerate(self._taken):
                held = self._held[:, a] == number
                if not held.any():
                    continue
                here = self._in_tool(a, target)
                moved = held & (length(here - self._grasp[:, a]) > _SLIP) & ~self.done
                lost = [i for i in np.flatnonzero(moved).tolist() if not self._grips(i, a, number)]
                self._grasp[moved, a] = here[moved]  # what only turns is held on there
                why = f"the gripper has lost {target_name(target)}"
                self._fail(np.array(lost, np.int64), a, why)

    def _grips(self, row: int, a: int, number: int) -> bool:
        """Whether fingers touch what they hold in an environment."""
        fingers, held = self._fingers[a].bodies, self._taken_bodies[number]
        return is_touching(self.env.sim.engine, row, fingers, held)

    def _in_tool(self, a: int, target: Any) -> F64:
        """(N, 3) position of a target in the axes of a tool."""
        path = self._paths[a]
        return quat_rotate(quat_conjugate(path.quat), self._targets(target)[0] - path.pos)

    def _proceed(self) -> bool:
        """Go on to the next instruction where one is over; return whether any was."""
        over = self._over()
        if not over.any():
            return False
        for index in np.unique(self._now[over]):
            if index >= 0:
                a = int(self._program.arm[index])
                self._end(index, a, np.flatnonzero(over[:, a] & (self._now[:, a] == index)))
        over &= ~self.done[:, None]
        following = np.append(self._program.next, -1)[self._now]
        begun = over & (following >= 0)
        self._now = np.where(over, following, self._now)
        finished = np.flatnonzero((self._now < 0).all(axis=1) & ~self.done)
        if len(finished):
            self._phase[finished] += 1
            end = self._phase[finished] >= len(self._program.first)
            self.done[finished[end]] = True
            rows = finished[~end]
            self._now[rows] = self._program.first[self._phase[rows]]
            begun[rows] = self._now[rows] >= 0
        for index in np.unique(self._now[begun]):
            a = int(self._program.arm[index])
            self._start(int(index), a, np.flatnonzero(begun[:, a] & (self._now[:, a] == index)))
        return True

    def _over(self) -> NDArray[np.bool_]:
        """(N, arms) whether an arm's instruction is over; fails motions that do not arrive."""
        kind, over = self._kinds[self._now], np.zeros(self._now.shape, np.bool_)
        limit = round(_PATIENCE / self.env.step_dt)
        slow, blind = (round(seconds / self.env.step_dt) for seconds in _FINGERS_TIME)
        for a, (arm, path) in enumerate(zip(self._arms, self._paths, strict=True)):
            steps, tolerance = self._steps[:, a], self._tolerances[self._now[:, a]]
            distance, angle = path.remaining()
            exact = tolerance < EXACT
            near = (distance <= tolerance) & (angle <= np.where(exact, *_TURN_TOLERANCES))
            near &= path.at_rest() | ~exact
            there = path.asked() & (near | ~np.isfinite(tolerance))
            late = (kind[:, a] == _MOVE) & ~there & (steps > path.steps + limit) & ~self.done
            for row in np.flatnonzero(late).tolist():
                missing = f"{1000 * distance[row]:.0f} mm and {angle[row]:.2f} rad are missing"
                touched = self._obstacles(row, a)
                self._fail(np.array([row]), a, f"the tool has not arrived: {touched}; {missing}")
            known = arm.gripper is not None and arm.gripper.opening() is not None
            rest = (self._still[:, a] >= 2) & (steps >= 3) if known else steps >= blind
            over[:, a] |= (kind[:, a] == _MOVE) & there
            over[:, a] |= (kind[:, a] == _GRIP) & (rest | (steps >= slow))
            over[:, a] |= (kind[:, a] == _WAIT) & (steps >= self._limit[:, a])
        over |= (self._phase < 0)[:, None]  # nothing was begun
        over &= ~self.done[:, None]
        return over

    def _obstacles(self, row: int, a: int) -> str:
        """What an arm's robot, and what the arm holds, touches in an environment."""
        number = self._held[row, a]
        held = self._taken_bodies[number] if number >= 0 else frozenset()
        robot = frozenset(map(int, self._arms[a].asset.entity.body_ids))
        return obstacles(self.env.sim.engine, row, robot, held)

    def _start(self, index: int, a: int, rows: Rows) -> None:
        """Begin an instruction in some environments."""
        one = self._program.instructions[index]
        self._steps[rows, a] = 0
        if isinstance(one, Wait):
            self._limit[rows, a] = max(1, round(one.seconds / self.env.step_dt))
        elif isinstance(one, Grip):
            gripper = self._arms[a].gripper
            if gripper is None:
                raise ValueError("there is no gripper")
            self._command[rows, a] = (gripper.high if one.opens else gripper.low)[0]
            self._still[rows, a] = 0
            if one.opens:
                self._held[rows, a] = -1
        elif isinstance(one, Move):
            if one.goal.held:
                empty = rows[self._held[rows, a] < 0]
                self._fail(empty, a, "the gripper holds nothing")
                rows = rows[self._held[rows, a] >= 0]
            if len(rows):
                pos, quat = self._goal(one.goal, a, rows)
                reached = self._paths[a].plan(rows, pos, quat, one.speed)
                for row, place in zip(rows[~reached], pos[~reached], strict=True):
                    why = f"{as_place(place)}: {self._paths[a].obstacles[int(row)]}"
                    self._fail(np.array([row]), a, f"no straight line of the tool to {why}")

    def _end(self, index: int, a: int, rows: Rows) -> None:
        """See what an instruction has achieved."""
        one = self._program.instructions[index]
        if not isinstance(one, Grip) or one.takes is None:
            return
        gripper = self._arms[a].gripper
        opening = None if gripper is None else gripper.opening()
        if opening is not None:
            empty = opening[rows] < _NOTHING
            self._fail(rows[empty], a, "the fingers closed on nothing")
            rows = rows[~empty]
        self._held[rows, a] = self._taken.index(one.takes)
        self._grasp[rows, a] = self._in_tool(a, one.takes)[rows]

    def _fail(self, rows: Rows, a: int, why: str) -> None:
        """Stop in these environments: all arms stay where they are."""
        for row in rows[~self.done[rows]]:
            index = self._now[row, a]
            if index < 0:  # what another arm does, while this one has finished
                index = self._now[row].max()
            self.failures[row] = f"{self._program.instructions[index].step}: {why}"
            self.done[row] = True
            for path in self._paths:
                path.stop(row)

    def _action(self) -> F64:
        """(N, A) the actions."""
        env = self.env
        manager = env.action_manager
        action: F64 = (
            manager.hold() if len(manager) else np.zeros((env.num_envs, self._arms[0].columns.stop))
        )
        for a, (arm, path) in enumerate(zip(self._arms, self._paths, strict=True)):
            moves = self._kinds[self._now[:, a]] == _MOVE
            action[:, arm.columns] = path.action(moves & ~self.done)
            if arm.gripper is not None:
                action[:, arm.fingers] = self._command[:, a, None]
        return action if self._pushes is None else self._pushes.added(action, self.done)

    # -- goals -------------------------------------------------------------------------------------

    def _goal(self, goal: Goal, a: int, rows: Rows) -> tuple[F64, F64]:
        """Position (n, 3) and orientation (n, 4) of the tool for a goal."""
        path = self._paths[a]
        tool_pos, tool_quat = path.path_pos[rows], path.path_quat[rows]
        place, axes = tool_pos, tool_quat
        if goal.target is not None:
            place, axes = (part[rows] for part in self._targets(goal.target))
        if goal.start is not None:
            place = place + goal.beyond * self._direction(goal, rows)
        if goal.axes == "world":
            axes = np.tile([1.0, 0.0, 0.0, 0.0], (len(rows), 1))
        elif goal.axes == "tool":
            axes = tool_quat
        place = place + quat_rotate(axes, np.tile(goal.offset, (len(rows), 1)))
        place = place + np.array([0.0, 0.0, goal.above])
        held_pos, held_quat = self._held_pose(goal, a, rows)
        quat = tool_quat
        if goal.rpy is not None:
            given = quat_conjugate(euler_xyz_to_quat(-np.asarray(goal.rpy, np.float64)))
            quat = quat_multiply(axes, np.tile(given, (len(rows), 1)))
        elif goal.align is not None and self._arms[a].term.orientation == "any":
            facing = quat_multiply(tool_quat, held_quat)
            if not goal.held:
                facing = self._fingers_along_x(facing, a)
            quat = quat_multiply(self._turn(goal, facing, tool_quat, rows), tool_quat)
        back = np.tile([0.0, 0.0, goal.back], (len(rows), 1))
        return place - quat_rotate(quat, held_pos + back), quat

    def _fingers_along_x(self, quat: F64, a: int) -> F64:
        """(n, 4) orientations whose x axis is the line along which the tool's fingers move."""
        angle = self._fingers[a].angle
        if not angle:
            return quat
        turn = rotvec_to_quat(np.array([0.0, 0.0, angle]))
        return quat_multiply(quat, np.tile(turn, (len(quat), 1)))

    def _direction(self, goal: Goal, rows: Rows) -> F64:
        """(n, 3) horizontal unit vectors, away from `goal.start` through the target."""
        end, start = (self._targets(one or WORLD)[0] for one in (goal.target, goal.start))
        way = (end - start)[rows]
        way[:, 2] = 0.0
        return way / np.maximum(length(way), 1e-9)[:, None]

    def _held_pose(self, goal: Goal, a: int, rows: Rows) -> tuple[F64, F64]:
        """Pose of what is held in the tool's frame, (n, 3), (n, 4); none without `goal.held`."""
        pos, quat = np.zeros((len(rows), 3)), np.tile([1.0, 0.0, 0.0, 0.0], (len(rows), 1))
        if not goal.held:
            return pos, quat
        path, held = self._paths[a], self._held[rows, a]
        back = quat_conjugate(path.quat[rows])
        for number in np.unique(held):
            which, target = held == number, self._taken[number]
            place, facing = (part[rows][which] for part in self._targets(target))
            pos[which] = quat_rotate(back[which], place - path.pos[rows][which])
            quat[which] = quat_multiply(back[which], facing)
        return pos, quat

    def _turn(self, goal: Goal, facing: F64, tool_quat: F64, rows: Rows) -> F64:
        """(n, 4) smallest rotation about the vertical that makes axes parallel to the target's."""
        wanted = self._targets(goal.align or WORLD)[1][rows]
        part = 2.0 * np.pi / goal.symmetry
        angle = _heading(wanted) - _heading(facing) + 0.5 * part
        angle = angle - part * np.floor(angle / part) - 0.5 * part
        if not goal.level:
            upright = np.abs(quat_to_matrix(tool_quat)[:, 2, 2]) > _VERTICAL
            angle = np.where(upright, angle, 0.0)
        zero = np.zeros_like(angle)
        return rotvec_to_quat(np.stack([zero, zero, angle], axis=1))


def _heading(quat: F64) -> F64:
    """(n,) rad: direction in the plane of the x axis; if that is steep, of the y axis less 90°."""
    matrix = quat_to_matrix(quat)
    x = np.arctan2(matrix[:, 1, 0], matrix[:, 0, 0])
    y = np.arctan2(matrix[:, 1, 1], matrix[:, 0, 1]) - 0.5 * np.pi
    return np.where(np.abs(matrix[:, 2, 0]) < _VERTICAL, x, y)


def _orientations(
    steps: Sequence[ReadStep], arms: Sequence[Arm], declared: Sequence[DeclaredArm]
) -> list[Problem]:
    """Steps that ask for an orientation of an arm whose action does not choose it."""
    problems = []
    kinds = {arm.name: arm.term.orientation for arm in arms}
    for read in (one for step in steps for one in step.flat() if not one.within):
        for arm, lane in (pair for phase in read.phases for pair in phase.items()):
            goals = [one.goal for one in lane if isinstance(one, Move)]
            turns = any(g.rpy or (g.align is not None and g.level) for g in goals)
            name = find_arm(arm, declared, read.path).name
            if turns and kinds[name] != "any":
                message = f"the action {name!r} does not choose the tool's orientation"
                problems.append(Problem(read.path, message))
    return problems
