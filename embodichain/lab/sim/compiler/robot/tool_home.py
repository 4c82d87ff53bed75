"""`move_to_home`: joint positions at which a robot's tool has the pose of its config's `home`.

The search is damped least squares (Buss, "Introduction to inverse kinematics with Jacobian
transpose, pseudoinverse and damped least squares methods", 2004) on the robot's own model, with
restarts at fixed points.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.cfg import HomeCfg, ObjectBaseCfg
from embodichain.lab.sim.compiler.geoms.poses import initial_pose
from embodichain.lab.sim.compiler.index import F64
from embodichain.lab.sim.compiler.names import FrameAlias, FrameKind, find_frame
from embodichain.lab.sim.compiler.robot.frame_aliases import frames_by_kind
from embodichain.lab.sim.compiler.robot.robot_root import Placement
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.math import quat_conjugate, quat_multiply, quat_rotate
from embodichain.utils.random import RandomStreams

__all__ = ["can_reach", "check_home", "move_to_home"]

_NEAR = 1e-4
"""Metres: a tool that is as near to its home has reached it."""
_TURNED = np.deg2rad(0.1)
"""Likewise, in rad."""
_EXACT = 1e-10
"""m and rad: where a search ends."""
_ITERATIONS = 200
_RESTARTS = 30
_REACH_RESTARTS = 8
_REACHED = 0.005
"""Metres: a place that a tool comes as near to is in its reach."""
_REACHED_TURN = np.deg2rad(1.0)
"""Likewise of an orientation, in rad."""
_DAMPING = 1e-6
_LONGEST_STEP = 0.3
"""rad or m of one joint in one iteration."""


@dataclass(frozen=True, eq=False)
class _Arm:
    """The joints that move a tool, in a robot's model alone.

    Attributes:
        model: The robot's model.
        data: A state of it.
        kind: The kind of the tool's frame.
        tool: MuJoCo's id of that frame.
        joints: (k,) MuJoCo's ids of the joints.
        columns: (k,) the same in the robot's order of joints.
    """

    model: mujoco.MjModel
    data: mujoco.MjData
    kind: FrameKind
    tool: int
    joints: NDArray[np.int64]
    columns: NDArray[np.int64]

    @property
    def body(self) -> int:
        """MuJoCo's id of the body that carries the tool."""
        if self.kind == "site":
            return int(self.model.site_bodyid[self.tool])
        if self.kind == "geom":
            return int(self.model.geom_bodyid[self.tool])
        return self.tool

    def pose(self) -> tuple[F64, F64]:
        """Position (3,) in m and rotation matrix (3, 3) of the tool in the model's world."""
        frame = {"link": self.data.body, "site": self.data.site, "geom": self.data.geom}
        tool = frame[self.kind](self.tool)
        return tool.xpos.copy(), tool.xmat.reshape(3, 3).copy()

    def jacobian(self, point: F64) -> F64:
        """(6, k) velocity of a point of the tool, then angular velocity."""
        linear = np.zeros((3, self.model.nv))
        angular = np.zeros((3, self.model.nv))
        mujoco.mj_jac(self.model, self.data, linear, angular, point, self.body)
        dofs = self.model.jnt_dofadr[self.joints]
        return np.concatenate([linear[:, dofs], angular[:, dofs]])


def check_home(home: HomeCfg) -> list[Problem]:
    """Return what is wrong with the pose of a home itself, with paths below it."""
    try:
        _target(home)
    except ConfigError as error:
        return [
            Problem(problem.path.replace("init_", "", 1), problem.message, problem.hint)
            for problem in error.problems
        ]
    return []


def _target(home: HomeCfg) -> tuple[F64, F64 | None]:
    """Position (3,) and orientation (4,), wxyz, in the environment's frame; None: any."""
    pose = ObjectBaseCfg(init_pos=home.pos, init_rot=home.rot or (0, 0, 0), init_quat=home.quat)
    pos, quat = initial_pose(pose)
    has_orientation = home.rot is not None or home.quat is not None
    return pos, quat if has_orientation else None


def move_to_home(
    home: HomeCfg,
    model: mujoco.MjModel,
    start: F64,
    joints: Sequence[int],
    followers: Sequence[int],
    aliases: Mapping[str, FrameAlias],
    root: str,
    placement: Placement,
) -> tuple[F64, list[Problem]]:
    """Return the joint positions (D,) at which the tool is at its home, rad or m.

    Where it is there already, to 0.1 mm and 0.1 degrees, positions stay as they are.

    Args:
        home: The pose.
        model: The robot's model alone.
        start: (nq,) positions of all joints before.
        joints: (D,) MuJoCo's ids of the robot's joints.
        followers: Those of them, as numbers from 0 to D - 1, that follow others.
        aliases: The robot's further names.
        root: The body with the robot's pose.
        placement: Where the robot is in the scene.
    """
    qpos = start[model.jnt_qposadr[list(joints)]]
    frame, problems = _find_tool(home.link, model, aliases)
    if frame is None:
        return qpos, problems
    kind, name = frame
    element = {"link": model.body, "site": model.site, "geom": model.geom}[kind](name)
    data = mujoco.MjData(model)
    data.qpos[:] = start
    arm = _arm(model, data, kind, int(element.id), joints, followers)
    if not len(arm.joints):
        return qpos, [Problem("link", f"no joint moves {home.link!r}")]

    mujoco.mj_kinematics(model, data)
    pos, quat = _in_model(home, data.body(root), placement)
    shares = RandomStreams(0, 1).uniform("home", (_RESTARTS, len(arm.joints)))[0]
    low, high = _limits(model, arm.joints)
    nearest = np.inf
    for share in [None, *shares]:
        data.qpos[:] = start
        if share is not None:
            data.qpos[model.jnt_qposadr[arm.joints]] = low + (high - low) * share
        found = _search(arm, pos, quat, low, high)
        if found.is_exact:
            solution = qpos.copy()
            solution[arm.columns] = data.qpos[model.jnt_qposadr[arm.joints]]
            return solution, []
        nearest = min(nearest, found.distance)
    message = (
        f"the tool cannot be there: the nearest pose that was found is {1000 * nearest:.0f} mm away"
    )
    return qpos, [Problem("pos", message)]


def can_reach(
    model: mujoco.MjModel,
    *,
    start: F64,
    kind: FrameKind,
    tool: int,
    joints: NDArray[np.int64],
    places: F64,
    orientations: F64 | None,
    low: F64 | None,
    high: F64 | None,
    enough: float,
) -> bool:
    """Whether a tool reaches a share of some places.

    A process searches once for each answer: environments of one task ask the same, and a search
    takes longer than the rest of an environment.

    Args:
        model: A model of the robot, alone or in a scene.
        start: (nq,) positions of all joints, from which searches begin.
        kind: The kind of the tool's frame.
        tool: MuJoCo's id of it.
        joints: (k,) MuJoCo's ids of the joints that may move.
        places: (n, 3) m.
        orientations: (n, 4), wxyz, of the tool at each place; None: any.
        low: (k,) lowest positions of the joints, where the limits are lower; None for the limits.
        high: (k,) highest.
        enough: The share, up to 1.
    """
    arm = _Arm(model, mujoco.MjData(model), kind, tool, joints, np.zeros(0, np.int64))
    lowest, highest = _limits(model, joints)
    if low is not None:
        lowest = np.maximum(lowest, low)
    if high is not None:
        highest = np.minimum(highest, high)
    wanted = _Wanted(start, places, orientations, lowest, highest, enough)
    key = _digest_of(arm, wanted)
    if key not in _ANSWERS:
        _ANSWERS[key] = _reaches(arm, wanted)
    return _ANSWERS[key]


@dataclass(frozen=True, eq=False)
class _Wanted:
    """What `can_reach` is asked of an arm; see there.

    Attributes:
        start: (nq,) positions of all joints.
        places: (n, 3) m.
        orientations: (n, 4), wxyz; None: any.
        lowest: (k,) lowest positions of the joints.
        highest: (k,) highest.
        enough: The share of the places.
    """

    start: F64
    places: F64
    orientations: F64 | None
    lowest: F64
    highest: F64
    enough: float


_KINEMATICS = (
    *("body_parentid", "body_mocapid", "body_pos", "body_quat", "body_ipos", "body_mass"),
    *("jnt_type", "jnt_bodyid", "jnt_qposadr", "jnt_dofadr", "jnt_pos", "jnt_axis", "qpos0"),
    *("site_bodyid", "site_pos", "site_quat", "geom_bodyid", "geom_pos", "geom_quat"),
)
"""Arrays of a model from which the places of its frames follow."""
_ANSWERS: dict[bytes, bool] = {}
"""Digest of an arm and of what was wanted -> whether it reaches that."""


def _digest_of(arm: _Arm, wanted: _Wanted) -> bytes:
    """Return a digest of all that an answer depends on."""
    digest = hashlib.sha256(repr((arm.kind, arm.tool, wanted.enough)).encode())
    arrays = [wanted.start, wanted.places, wanted.lowest, wanted.highest, arm.joints]
    if wanted.orientations is not None:
        arrays.append(wanted.orientations)
    arrays += [getattr(arm.model, name) for name in _KINEMATICS]
    for array in arrays:
        digest.update(repr((array.shape, array.dtype.str)).encode())
        digest.update(array.tobytes())
    return digest.digest()


def _reaches(arm: _Arm, wanted: _Wanted) -> bool:
    """Search for the places, each from several positions of the joints."""
    data = arm.data
    addresses = arm.model.jnt_qposadr[arm.joints]
    lowest = wanted.lowest
    highest = wanted.highest
    shares = RandomStreams(0, 1).uniform("reach", (_REACH_RESTARTS, len(arm.joints)))[0]
    most_missing = int((1.0 - wanted.enough) * len(wanted.places))
    missing = 0
    for i, place in enumerate(wanted.places):
        quat = None if wanted.orientations is None else wanted.orientations[i]
        reached = False
        for share in [None, *shares]:
            data.qpos[:] = wanted.start
            if share is not None:
                data.qpos[addresses] = lowest + (highest - lowest) * share
            found = _search(arm, place, quat, lowest, highest)
            is_near = found.distance < _REACHED and found.turned < _REACHED_TURN
            reached = found.is_exact or is_near
            if reached:
                break
        missing += not reached
        if missing > most_missing:
            return False
    return True


def _find_tool(
    name: str, model: mujoco.MjModel, aliases: Mapping[str, FrameAlias]
) -> tuple[tuple[FrameKind, str] | None, list[Problem]]:
    """Return the kind and the name of the tool's frame, or what is wrong with its name."""
    alias = aliases.get(name)
    if alias is not None:
        if not alias.frames:
            return None, []
        if len(alias.frames) == 1:
            return (alias.kind, alias.frames[0]), []
        return None, [Problem("link", f"{name!r} names several: {', '.join(alias.frames)}")]
    names = frames_by_kind(model)
    return find_frame(name, lambda kind: names[kind], "link")


def _arm(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    kind: FrameKind,
    tool: int,
    joints: Sequence[int],
    followers: Sequence[int],
) -> _Arm:
    """Return the joints between a robot's root and its tool, without those that follow others."""
    arm = _Arm(model, data, kind, tool, np.zeros(0, np.int64), np.zeros(0, np.int64))
    carriers = set()
    body = arm.body
    while body:
        carriers.add(body)
        body = int(model.body_parentid[body])
    columns = [
        i
        for i, joint in enumerate(joints)
        if int(model.jnt_bodyid[joint]) in carriers and i not in followers
    ]
    ids = np.array([joints[i] for i in columns], np.int64)
    return _Arm(model, data, kind, tool, ids, np.array(columns, np.int64))


def _in_model(home: HomeCfg, root: object, placement: Placement) -> tuple[F64, F64 | None]:
    """Return the home in the world of the robot's model alone, where its root is elsewhere."""
    pos, quat = _target(home)
    root_pos = np.array(getattr(root, "xpos"))  # noqa: B009  (MuJoCo's accessors have no types)
    root_quat = np.array(getattr(root, "xquat"))  # noqa: B009
    turn = quat_multiply(root_quat, quat_conjugate(placement.root_quat))
    moved = root_pos + quat_rotate(turn, pos - placement.root_pos)
    return moved, None if quat is None else quat_multiply(turn, quat)


def _limits(model: mujoco.MjModel, joints: NDArray[np.int64]) -> tuple[F64, F64]:
    """Lowest and highest positions (k,); half a turn to both sides of joints without limits."""
    is_limited = model.jnt_limited[joints].astype(np.bool_)
    low: F64 = np.where(is_limited, model.jnt_range[joints, 0], -np.pi)
    high: F64 = np.where(is_limited, model.jnt_range[joints, 1], np.pi)
    return low, high


def _error(arm: _Arm, pos: F64, quat: F64 | None) -> F64:
    """(6,) the way to the target in m, and the turn in rad; (3,) without an orientation."""
    tool_pos, tool_rotation = arm.pose()
    if quat is None:
        return pos - tool_pos
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, quat)
    turn_quat = np.zeros(4)
    turn = np.zeros(3)
    mujoco.mju_mat2Quat(turn_quat, (rotation.reshape(3, 3) @ tool_rotation.T).reshape(9))
    mujoco.mju_quat2Vel(turn, turn_quat, 1.0)
    return np.concatenate([pos - tool_pos, turn])


class _Found(NamedTuple):
    """Where a search ended.

    Attributes:
        is_exact: Whether the pose is reached.
        distance: How far the tool is from it, m.
        turned: The angle between the orientations, rad; 0 where any will do.
    """

    is_exact: bool
    distance: float
    turned: float


def _search(arm: _Arm, pos: F64, quat: F64 | None, low: F64, high: F64) -> _Found:
    """Move the arm's state to a pose; return where it ended."""
    addresses = arm.model.jnt_qposadr[arm.joints]
    first = True
    for _ in range(_ITERATIONS):
        mujoco.mj_kinematics(arm.model, arm.data)
        mujoco.mj_comPos(arm.model, arm.data)
        error = _error(arm, pos, quat)
        distance = float(np.linalg.norm(error[:3]))
        turned = float(np.linalg.norm(error[3:]))
        if first and distance < _NEAR and turned < _TURNED:
            return _Found(is_exact=True, distance=distance, turned=turned)
        first = False
        if distance < _EXACT and turned < _EXACT:
            return _Found(is_exact=True, distance=distance, turned=turned)
        jacobian = arm.jacobian(arm.pose()[0])[: len(error)]
        system = jacobian @ jacobian.T + _DAMPING * np.eye(len(error))
        step = jacobian.T @ np.linalg.solve(system, error)
        step *= min(1.0, _LONGEST_STEP / max(float(np.abs(step).max()), 1e-12))
        before = arm.data.qpos[addresses].copy()
        arm.data.qpos[addresses] = np.clip(before + step, low, high)
        if np.abs(arm.data.qpos[addresses] - before).max() < _EXACT:
            break
    is_exact = distance < 1e-6 and turned < 1e-6
    return _Found(is_exact, distance, turned)
