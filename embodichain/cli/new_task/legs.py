"""`find_legs`: the legs of a robot that walks, the pose in which it stands, and its gait.

Legs hang below the trunk, as those of dogs and people do, or spread from it, as an insect's do.
"""

from __future__ import annotations

import itertools
import re
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from embodichain.cli.new_task.tool_point import corners_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    import mujoco
    from numpy.typing import NDArray

    F64 = NDArray[np.float64]

__all__ = [
    "FOOT_NAME",
    "Leg",
    "feet_above_trunk",
    "find_legs",
    "foot_origin",
    "foot_position",
    "leg_gains",
    "legs_aside",
    "legs_with_feet",
    "spreads",
    "stand",
    "trot_phases",
]

FOOT_NAME = re.compile(r"foot|toe|sole|ankle_roll", re.IGNORECASE)
"""How links are called on which robots stand."""
_STRAIGHT = 0.94
"""Share of its length from which a leg counts as stretched."""
_FOLDED = 0.5
"""Share of its length below which it counts as folded."""
_ASIDE = 0.35
"""Share of its length by which a foot may be before or behind its hip."""
_STANDING = 0.85
"""Share of its length to which a stretched or folded leg is bent."""
_STANDING_ON_MANY = 0.7
"""The same of robots with more than two legs, under their weight."""
_SPREAD = 0.1
"""Angle in rad by which bent legs point outwards, as those of quadrupeds that are trained do.

With the feet below the hips a robot of four narrow legs falls over when it is pushed.
"""
_LEAST_WIDTH = 0.5
"""Distance of such feet from the middle as a share of the hips' height: some are spread more."""
_BENDS = (0.7, -0.7)
"""Angles in rad of the thigh from which the search for a standing leg begins."""
_MARGIN = 0.03
"""Share of a joint's range that is left free at both ends."""
_ITERATIONS = 100
_ARRIVED = 5e-3
"""Distance in metres at which a foot is where it was sent."""
_SHANK = 0.25
"""Share of a leg from which its last link is a shank, whose end is the foot, and not a foot."""
_PAD = 0.3
"""Radius of a shape that is a foot of its own on a shank, as a share of the shank, at most."""
_SAG = 0.7
"""Angle in rad by which a drive would yield to the weight on a horizontal leg."""
_SAG_OF_SPREAD = 0.1
"""Angle in rad by which a joint of a leg that spreads yields to the weight in its pose, at most."""
_UPRIGHT = 0.5
"""Vertical component of a joint's axis from which the joint does not lift a leg, but turns it."""
_SPREADS = 0.6
"""Least distance of the foot of a leg that spreads beside its hip, as a share of that below it."""
_PLACES_OF_SPREAD = ((0.55, 0.6), (0.4, 0.65), (0.65, 0.45), (0.25, 0.7), (0.4, 0.8), (0.1, 0.75))
"""Places of the foot of such a leg beside and below its hip, as shares of its length from there."""
_PLACES_OF_ONE_JOINT = ((0.8, 0.6), (0.7, 0.7), (0.6, 0.8))
"""The same where a single joint lifts the leg."""
_CLEARANCE = 0.2
"""Height of the trunk above the feet of legs that spread, as a share of their length, at least."""


@dataclass(frozen=True)
class Leg:
    """A leg.

    Attributes:
        foot: What touches the ground.
        kind: Whether that is a link or a geom.
        body: Its body.
        joints: The hinges from the trunk to it.
        length: Distance in metres from its first pitching joint to the foot when stretched.
        tip: Where the foot touches the ground, in its frame, m: the end of a shank without a foot.
    """

    foot: str
    kind: Literal["link", "geom"]
    body: str
    joints: tuple[str, ...] = field(default=())
    length: float = 0.0
    tip: tuple[float, float, float] = (0.0, 0.0, 0.0)


def find_legs(model: mujoco.MjModel, data: mujoco.MjData, links: Sequence[str]) -> list[Leg]:
    """Find the legs of a robot with a floating base.

    Feet are links called so; without any, the lowest shapes of the ends of chains of two hinges
    and more that hang below the trunk.

    Args:
        model: The robot.
        data: A state of it.
        links: Its links.
    """
    feet = [name for name in links if FOOT_NAME.search(name)]
    # Of a foot and a toe on it, the first has the ground's contact, as its child does.
    carried = {name for name in feet if _carrier(model, name, feet)}
    feet = [name for name in feet if name not in carried]
    legs = [
        Leg(foot=name, kind="link", body=name, joints=_hinges(model, model.body(name).id))
        for name in feet
    ]
    legs = [leg for leg in legs if len(leg.joints) >= 2]
    if len(legs) < 2:
        legs = _ends_of_chains(model, data, links)
    return [_with_length(model, data, leg) for leg in legs]


def legs_with_feet(model: mujoco.MjModel, data: mujoco.MjData, feet: Sequence[str]) -> list[Leg]:
    """The legs whose feet are links or geoms with these names."""
    links = {model.body(i).name for i in range(model.nbody)}
    legs = []
    for foot in feet:
        body = foot if foot in links else model.body(int(model.geom(foot).bodyid[0])).name
        kind: Literal["link", "geom"] = "link" if foot in links else "geom"
        joints = _hinges(model, model.body(body).id)
        leg = Leg(foot, kind, body, joints)
        legs.append(_with_length(model, data, leg) if joints else leg)
    return legs


def stand(
    model: mujoco.MjModel, data: mujoco.MjData, legs: Sequence[Leg], *, yields: bool
) -> list[str]:
    """Bend legs that are stretched or folded, in `data`; return the feet of those that were bent.

    More than two legs are spread a little as well. Where not all can hang below their hips, all
    that do not stand yet spread to the sides, each in the plane in which it bends.

    Args:
        model: The robot.
        data: Its first state, which is changed.
        legs: Its legs.
        yields: Whether drives with `leg_gains` move them. More than two legs are then bent less, by
            what such drives yield to the weight: the robot sinks until its feet are below its hips.
    """
    bent: list[str] = []
    first_positions = data.qpos.copy()
    first_aside = legs_aside(model, data, legs)
    is_on_many = len(legs) > 2
    middle = float(np.mean([foot_position(data, leg)[1] for leg in legs])) if legs else 0.0
    for leg in legs:
        if _stands(model, data, leg):
            continue
        hip = _hip_position(model, data, leg)
        foot = foot_position(data, leg)
        drop = leg.length * (_STANDING_ON_MANY if is_on_many else _STANDING)
        place = np.array([hip[0], foot[1], hip[2] - drop])
        if is_on_many and _rolls(model, data, leg):
            aside = foot[1] - middle
            width = max(abs(aside) + drop * np.tan(_SPREAD), _LEAST_WIDTH * drop)
            place[1] = middle + np.sign(aside) * width
        if _bend(model, data, leg, place):
            bent.append(leg.foot)
            if is_on_many and yields:
                _raise(model, data, leg, legs)
    if is_on_many and len(bent) < len(first_aside):
        positions = data.qpos.copy()
        _place(model, data, first_positions)
        spread = [leg.foot for leg in legs if leg.foot in first_aside and _spread(model, data, leg)]
        if len(spread) == len(first_aside):
            return spread
        _place(model, data, positions)
    return bent


def legs_aside(model: mujoco.MjModel, data: mujoco.MjData, legs: Sequence[Leg]) -> list[str]:
    """The feet that are not below their hips, or whose legs are stretched or folded."""
    return [leg.foot for leg in legs if not _stands(model, data, leg)]


def spreads(model: mujoco.MjModel, data: mujoco.MjData, leg: Leg) -> bool:
    """Whether a leg stands far beside its hip, as an insect's does, and not below it."""
    joint = _first_lift(model, data, leg)
    if joint is None:
        return False
    way = foot_position(data, leg) - data.xanchor[model.joint(joint).id]
    return bool(way[2] < 0) and float(np.hypot(way[0], way[1])) > -_SPREADS * float(way[2])


def feet_above_trunk(
    model: mujoco.MjModel, data: mujoco.MjData, legs: Sequence[Leg], root: str
) -> list[Leg]:
    """The legs whose feet are not below the trunk, which lies on the ground between them.

    Args:
        model: The robot.
        data: A state of it.
        legs: Its legs.
        root: Its root link.
    """
    lowest = _lowest_of_trunk(model, data, int(model.body(root).id))
    return [leg for leg in legs if float(foot_position(data, leg)[2]) >= lowest]


def leg_gains(
    model: mujoco.MjModel, data: mujoco.MjData, legs: Sequence[Leg]
) -> tuple[float, float]:
    """Stiffness (N m/rad) and damping (N m s/rad) with which legs bear the robot's weight.

    They are near those with which robots are trained: 25 and 0.5 for a Go2, 80 and 2 for an ANYmal.
    Legs that spread in a state bear it with a longer lever, and get as much as that takes.
    """
    force = _weight_on_each(model, legs)
    torques = [
        float(np.abs(_torques(model, data, leg, force)).max())
        for leg in legs
        if spreads(model, data, leg)
    ]
    lasting = _to_half_a_digit(max(torques, default=0.0) / _SAG_OF_SPREAD)
    stiffness = max(_stiffness_below_hips(model, legs), lasting)
    return stiffness, float(f"{stiffness / 40:.1g}")


def _weight_on_each(model: mujoco.MjModel, legs: Sequence[Leg]) -> float:
    """The share of the robot's weight that each leg bears, N."""
    return 9.81 * float(model.body_subtreemass[0]) / len(legs)


def _stiffness_below_hips(model: mujoco.MjModel, legs: Sequence[Leg]) -> float:
    """Stiffness of drives of legs whose feet are below their hips, N m/rad."""
    length = float(np.mean([leg.length for leg in legs]))
    return _to_half_a_digit(_weight_on_each(model, legs) * length / _SAG)


def _to_half_a_digit(value: float) -> float:
    """A number that is not negative, rounded to halves of its first digit."""
    if value == 0.0:
        return value
    half_a_digit = 0.5 * 10.0 ** np.floor(np.log10(value))
    return float(half_a_digit * round(value / half_a_digit))


def trot_phases(data: mujoco.MjData, legs: Sequence[Leg]) -> list[float]:
    """The phase of each foot in a gait, in periods: diagonal feet together, or left and right.

    On each side of more than four legs neighbours are in turn, and so are opposite feet: six legs
    stand on the outer feet of one side and the middle one of the other.
    """
    places = np.array([foot_position(data, leg)[:2] for leg in legs])
    middle = places.mean(axis=0)
    phases = []
    is_two_legged = len(legs) == 2
    if len(legs) > 4:
        is_on_left = places[:, 1] > middle[1]
        ranks = [
            int(((is_on_left == is_left) & (places[:, 0] > x)).sum())
            for (x, _), is_left in zip(places, is_on_left, strict=True)
        ]
        return [
            0.5 * ((rank + int(not is_left)) % 2)
            for rank, is_left in zip(ranks, is_on_left, strict=True)
        ]
    for x, y in places - middle:
        is_left = y > 0
        is_front = x > 0 and not is_two_legged
        phases.append(0.0 if is_left == is_front else 0.5)
    return phases


def foot_position(data: mujoco.MjData, leg: Leg) -> F64:
    """(3,) where a foot touches the ground, m: its origin, or the end of a shank without a foot."""
    element = data.geom(leg.foot) if leg.kind == "geom" else data.body(leg.foot)
    tip: F64 = element.xpos + element.xmat.reshape(3, 3) @ np.array(leg.tip)
    return tip


def foot_origin(data: mujoco.MjData, leg: Leg) -> F64:
    """(3,) where the origin of a foot is, m, which terms of a task measure."""
    element = data.geom(leg.foot) if leg.kind == "geom" else data.body(leg.foot)
    return element.xpos.copy()


def _stands(model: mujoco.MjModel, data: mujoco.MjData, leg: Leg) -> bool:
    """Whether a foot is below its hip, with the leg neither stretched nor folded."""
    way = foot_position(data, leg) - _hip_position(model, data, leg)
    share = float(np.linalg.norm(way)) / leg.length
    is_aside = abs(float(way[0])) > _ASIDE * leg.length
    return bool(way[2] < 0) and _FOLDED <= share <= _STRAIGHT and not is_aside


def _hip_position(model: mujoco.MjModel, data: mujoco.MjData, leg: Leg) -> F64:
    """(3,) the first joint that swings a leg forwards, m."""
    return data.xanchor[model.joint(_first_pitch(model, data, leg)).id].copy()


def _first_lift(model: mujoco.MjModel, data: mujoco.MjData, leg: Leg) -> str | None:
    """The first joint of a leg that lifts it, whose axis is not upright; None without one."""
    for name in leg.joints:
        if abs(float(data.xaxis[model.joint(name).id, 2])) < _UPRIGHT:
            return name
    return None


def _place(model: mujoco.MjModel, data: mujoco.MjData, positions: F64) -> None:
    """Set all positions."""
    import mujoco

    data.qpos[:] = positions
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)


def _spread(model: mujoco.MjModel, data: mujoco.MjData, leg: Leg) -> bool:
    """Bend a leg in its own plane until its foot is beside its hip and below the trunk.

    Returns:
        Whether its foot is below the trunk now, which it may have been at first.
    """
    name = _first_lift(model, data, leg)
    if name is None:
        return False
    lift = leg.joints.index(name)
    points = [data.xanchor[model.joint(joint).id].copy() for joint in leg.joints[lift:]]
    points.append(foot_position(data, leg))
    length = sum(float(np.linalg.norm(b - a)) for a, b in itertools.pairwise(points))
    hip = points[0]
    axis = data.xaxis[model.joint(name).id]
    outwards = np.array([-axis[1], axis[0], 0.0])
    outwards /= np.linalg.norm(outwards)
    way = points[-1] - hip
    if abs(float(way @ outwards)) < 0.1 * length:  # a leg that hangs
        way = hip - data.xipos[model.body_rootid[model.body(leg.body).id]]
    if float(way @ outwards) < 0:
        outwards = -outwards
    trunk = int(model.body_rootid[model.body(leg.body).id])
    highest = _lowest_of_trunk(model, data, trunk) - _CLEARANCE * length
    first = data.qpos.copy()
    has_one_joint = lift == len(leg.joints) - 1
    arrived = 0.05 * length if has_one_joint else 2e-3 * length
    places = _PLACES_OF_ONE_JOINT if has_one_joint else _PLACES_OF_SPREAD
    for aside, below in places:
        place = hip + length * (aside * outwards - [0.0, 0.0, below])
        if place[2] > highest:
            continue
        poses: list[tuple[float, F64]] = []
        for bend in _BENDS:
            _place(model, data, first)
            if _bend(model, data, leg, place, first_joint=lift, bends=(bend,), arrived=arrived):
                knee = float(data.xanchor[model.joint(leg.joints[-1]).id, 2])
                poses.append((knee, data.qpos.copy()))
        if poses:
            _, positions = max(poses, key=lambda pose: pose[0])  # the knee up, as insects have it
            _place(model, data, positions)
            return True
    _place(model, data, first)
    return bool(foot_position(data, leg)[2] <= highest)


def _lowest_of_trunk(model: mujoco.MjModel, data: mujoco.MjData, root: int) -> float:
    """Height of the lowest corner of the root link and what is fixed on it, m."""
    trunk = [body for body in range(1, model.nbody) if model.body_weldid[body] == root]
    corners = corners_of(model, data, trunk)
    return float(corners[:, 2].min()) if len(corners) else float(data.xpos[root, 2])


def _torques(model: mujoco.MjModel, data: mujoco.MjData, leg: Leg, force: float) -> F64:
    """(K,) torques of a leg's joints in N m that bear a vertical force on its foot, N."""
    import mujoco

    jacobian = np.zeros((3, model.nv))
    mujoco.mj_comPos(model, data)
    mujoco.mj_jac(model, data, jacobian, None, foot_position(data, leg), model.body(leg.body).id)
    dofs = model.jnt_dofadr[[model.joint(name).id for name in leg.joints]]
    torques: F64 = force * jacobian[2, dofs]
    return torques


def _carrier(model: mujoco.MjModel, name: str, others: Sequence[str]) -> bool:
    """Whether one of some links carries another."""
    body = int(model.body(name).parentid[0])
    while body:
        if model.body(body).name in others:
            return True
        body = int(model.body_parentid[body])
    return False


def _hinges(model: mujoco.MjModel, body: int) -> tuple[str, ...]:
    """The hinges between the root and a body, from the root on."""
    import mujoco

    names: list[str] = []
    while body:
        first = int(model.body_jntadr[body])
        for i in reversed(range(int(model.body_jntnum[body]))):
            if model.jnt_type[first + i] == mujoco.mjtJoint.mjJNT_HINGE:
                names.insert(0, model.joint(first + i).name)
        body = int(model.body_parentid[body])
    return tuple(names)


def _ends_of_chains(model: mujoco.MjModel, data: mujoco.MjData, links: Sequence[str]) -> list[Leg]:
    """Legs without a name: chains that end below the trunk, within 10 cm of the lowest end."""
    import mujoco

    parents = {int(parent) for parent in model.body_parentid}
    legs: list[Leg] = []
    heights: list[float] = []
    for name in links:
        body = int(model.body(name).id)
        joints = _hinges(model, body)
        if body in parents or len(joints) < 2:
            continue
        geoms = [int(i) for i in np.flatnonzero(model.geom_bodyid == body)]
        lowest = min(geoms, key=lambda geom: data.geom_xpos[geom, 2], default=None)
        foot = model.geom(lowest).name if lowest is not None else ""
        leg = Leg(foot=name, kind="link", body=name, joints=joints)
        if lowest is not None and foot and model.geom_type[lowest] != mujoco.mjtGeom.mjGEOM_MESH:
            ankle = data.xanchor[model.joint(joints[-1]).id]
            reach = float(np.linalg.norm(corners_of(model, data, [body]) - ankle, axis=1).max())
            if model.geom_rbound[lowest] < _PAD * reach:
                leg = Leg(foot=foot, kind="geom", body=name, joints=joints)
        leg = _with_length(model, data, leg)
        legs.append(leg)
        heights.append(float(foot_position(data, leg)[2]))
    lowest_height = min(heights, default=0.0)
    return [
        leg
        for leg, height in zip(legs, heights, strict=True)
        if height < lowest_height + 0.1 and height < float(data.xpos[1, 2])
    ]


def _rolls(model: mujoco.MjModel, data: mujoco.MjData, leg: Leg) -> bool:
    """Whether a joint of a leg moves it sideways."""
    axes = np.array([data.xaxis[model.joint(name).id] for name in leg.joints])
    return bool((np.abs(axes[:, 0]) > 0.8).any())


def _first_pitch(model: mujoco.MjModel, data: mujoco.MjData, leg: Leg) -> str:
    """The first joint that swings a leg forwards, else its first joint."""
    for name in leg.joints:
        if abs(float(data.xaxis[model.joint(name).id, 1])) > 0.8:
            return name
    return leg.joints[0]


def _with_length(model: mujoco.MjModel, data: mujoco.MjData, leg: Leg) -> Leg:
    """A leg with its length: the way from joint to joint, from the first that pitches on."""
    first = leg.joints.index(_first_pitch(model, data, leg))
    points = [data.xanchor[model.joint(name).id] for name in leg.joints[first:]]
    way_to_ankle = sum(float(np.linalg.norm(b - a)) for a, b in itertools.pairwise(points))
    leg = replace(leg, tip=_tip(model, data, leg, way_to_ankle))
    length = way_to_ankle + float(np.linalg.norm(foot_position(data, leg) - points[-1]))
    return replace(leg, length=length)


def _tip(
    model: mujoco.MjModel, data: mujoco.MjData, leg: Leg, way_to_ankle: float
) -> tuple[float, float, float]:
    """Where a foot touches the ground, in its frame: at its origin, unless it is a shank."""
    body = int(model.body(leg.body).id)
    if leg.kind == "geom" or not model.body_jntnum[body]:
        return (0.0, 0.0, 0.0)
    points = corners_of(model, data, [body])
    way = points - data.xanchor[model.joint(leg.joints[-1]).id]
    distances = np.linalg.norm(way, axis=1)
    if float(distances.max()) < _SHANK * (way_to_ankle + float(distances.max())):
        return (0.0, 0.0, 0.0)
    end = points[distances >= 0.95 * distances.max()].mean(axis=0)
    x, y, z = data.xmat[body].reshape(3, 3).T @ (end - data.xpos[body])
    return (float(x), float(y), float(z))


def _raise(model: mujoco.MjModel, data: mujoco.MjData, leg: Leg, legs: Sequence[Leg]) -> None:
    """Move the pitching joints of a leg back by what drives yield to its share of the weight."""
    import mujoco

    stiffness = _stiffness_below_hips(model, legs)
    torques = _torques(model, data, leg, _weight_on_each(model, legs))
    first = leg.joints.index(_first_pitch(model, data, leg))
    for name, torque in zip(leg.joints[first:], torques[first:].tolist(), strict=True):
        joint = model.joint(name)
        position = float(data.joint(name).qpos[0]) - torque / stiffness
        if joint.limited[0]:
            margin = _MARGIN * float(np.ptp(joint.range))
            position = np.clip(position, joint.range[0] + margin, joint.range[1] - margin)
        data.joint(name).qpos = position
    mujoco.mj_kinematics(model, data)


def _bend(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    leg: Leg,
    place: F64,
    *,
    first_joint: int | None = None,
    bends: Sequence[float] = _BENDS,
    arrived: float = _ARRIVED,
) -> bool:
    """Move a leg's joints until its foot is at a place, if it can be there.

    Args:
        model: The robot.
        data: Its state, which is changed if the foot gets there.
        leg: The leg.
        place: (3,) the place, m.
        first_joint: Index of the joint that is bent first, with the next; None is the first that
            swings the leg forwards.
        bends: Angles in rad of that joint from which the search begins.
        arrived: Distance from the place that counts as none, m.
    """
    import mujoco

    ids = [model.joint(name).id for name in leg.joints]
    columns = model.jnt_qposadr[ids]
    dofs = model.jnt_dofadr[ids]
    is_limited = model.jnt_limited[ids].astype(bool)
    margins = _MARGIN * np.ptp(model.jnt_range[ids], axis=1)
    low = np.where(is_limited, model.jnt_range[ids, 0] + margins, -np.pi)
    high = np.where(is_limited, model.jnt_range[ids, 1] - margins, np.pi)
    first = data.qpos[columns].copy()
    if first_joint is None:
        first_joint = leg.joints.index(_first_pitch(model, data, leg))
    for bend in bends:
        angles = first.copy()
        angles[first_joint] = bend
        angles[first_joint + 1 : first_joint + 2] = -2.0 * bend
        angles = np.clip(angles, low, high)
        for _ in range(_ITERATIONS):
            data.qpos[columns] = angles
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            error = place - foot_position(data, leg)
            if float(np.linalg.norm(error)) < arrived:
                return True
            jacobian = np.zeros((3, model.nv))
            body = model.body(leg.body).id
            mujoco.mj_jac(model, data, jacobian, None, foot_position(data, leg), body)
            part = jacobian[:, dofs]
            step = part.T @ np.linalg.solve(part @ part.T + 1e-4 * np.eye(3), error)
            angles = np.clip(angles + np.clip(step, -0.2, 0.2), low, high)
    data.qpos[columns] = first
    mujoco.mj_kinematics(model, data)
    return False
