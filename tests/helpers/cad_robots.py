"""Robots as files from CAD have them, as text: no feet, no free joint, limits of 0."""

from __future__ import annotations

import math
from collections.abc import Sequence

_INERTIA = '<inertia ixx="1e-3" ixy="0" ixz="0" iyy="1e-3" iyz="0" izz="1e-3"/>'


def _link(name: str, mass: float, place: str, shape: str) -> str:
    return (
        f'<link name="{name}"><inertial><origin xyz="{place}"/><mass value="{mass}"/>{_INERTIA}'
        f'</inertial><collision><origin xyz="{place}"/><geometry>{shape}</geometry></collision>'
        "</link>"
    )


def _joint(name: str, parent: str, child: str, place: str, axis: str, limits: str) -> str:
    return (
        f'<joint name="{name}" type="revolute"><origin xyz="{place}"/><parent link="{parent}"/>'
        f'<child link="{child}"/><axis xyz="{axis}"/><limit {limits} effort="0" velocity="0"/>'
        "</joint>"
    )


def crab(end: str = "tibia") -> str:
    """Four legs of coxa, femur and a last link, whose frame is at the knee."""
    text = _link("base_link", 6.2, "0 0 0", '<box size="0.4 0.2 0.1"/>')
    for name, x, y in (("LF", 0.2, 1), ("RF", 0.2, -1), ("LH", -0.2, 1), ("RH", -0.2, -1)):
        text += _link(f"{name}_coxa", 0.35, "0 0 0", '<sphere radius="0.03"/>')
        text += _link(
            f"{name}_femur", 0.3, "0 0 -0.095", '<cylinder radius="0.018" length="0.19"/>'
        )
        text += _link(f"{name}_{end}", 0.3, "0 0 -0.1", '<cylinder radius="0.018" length="0.2"/>')
        coxa, femur = f"{name}_coxa", f"{name}_femur"
        roll = 'lower="-0.8" upper="0.8"'
        swing = 'lower="-1.2" upper="1.6"'
        bend = 'lower="-2.5" upper="0"'
        text += _joint(f"{name}_j0", "base_link", coxa, f"{x} {0.13 * y} 0", "1 0 0", roll)
        text += _joint(f"{name}_j1", coxa, femur, f"0 {0.05 * y} 0", "0 1 0", swing)
        text += _joint(f"{name}_j2", femur, f"{name}_{end}", "0 0 -0.19", "0 1 0", bend)
    return f'<robot name="crab">{text}</robot>'


def spider() -> str:
    """Six legs that are stretched in a plane around a hub."""
    text = _link("hub", 2.0, "0 0 0", '<cylinder radius="0.1" length="0.04"/>')
    limits = 'lower="-1.5" upper="1.5"'
    for k in range(6):
        angle = math.radians(30 + 60 * k)
        x, y = math.cos(angle), math.sin(angle)
        for part, length in (("a", 0.05), ("b", 0.1), ("c", 0.15)):
            half = f"{0.5 * length * x:.4f} {0.5 * length * y:.4f} 0"
            text += _link(f"{part}{k}", 0.1, half, '<sphere radius="0.02"/>')
        pitch = f"{-y:.4f} {x:.4f} 0"
        text += _joint(f"ja{k}", "hub", f"a{k}", f"{0.1 * x:.4f} {0.1 * y:.4f} 0", "0 0 1", limits)
        text += _joint(
            f"jb{k}", f"a{k}", f"b{k}", f"{0.05 * x:.4f} {0.05 * y:.4f} 0", pitch, limits
        )
        text += _joint(f"jc{k}", f"b{k}", f"c{k}", f"{0.1 * x:.4f} {0.1 * y:.4f} 0", pitch, limits)
    return f'<robot name="spider">{text}</robot>'


def _chain(name: str, place: str, step: str, joints: int) -> str:
    text = ""
    for i in range(joints):
        pos = place if i == 0 else step
        text += f'<body name="{name}{i}" pos="{pos}"><joint name="{name}_j{i}" axis="0 1 0" '
        text += f'range="-1.5 1.5"/><geom type="capsule" fromto="0 0 0 {step}" size="0.01"/>'
    return text + "</body>" * joints


def _mjcf(*bodies: str) -> str:
    trunk = f'<body name="trunk"><geom type="box" size="0.1 0.1 0.05"/>{"".join(bodies)}</body>'
    return f'<mujoco><compiler angle="radian"/><worldbody>{trunk}</worldbody></mujoco>'


def hand() -> str:
    """A palm with four equal fingers that point upwards, without names."""
    places: Sequence[str] = [f"{0.04 * i - 0.06:.2f} 0 0.05" for i in range(4)]
    return _mjcf(*(_chain("abcd"[i], place, "0 0 0.04", 3) for i, place in enumerate(places)))


def two_arms() -> str:
    """A torso on a column, beside which two equal arms hang: they end above its foot."""
    column = '<geom type="cylinder" size="0.05 0.6" pos="0 0 -0.6"/>'
    arms = [_chain(side, f"0 {y} 0.05", "0 0 -0.2", 4) for side, y in (("l", 0.2), ("r", -0.2))]
    return _mjcf(column, *arms)


CART = """<robot name="cart">
<link name="chassis"><inertial><mass value="5"/>
<inertia ixx=".05" ixy="0" ixz="0" iyy=".05" iyz="0" izz=".08"/></inertial>
<collision><geometry><box size="0.4 0.3 0.1"/></geometry></collision></link>
<link name="wheel_l"><inertial><mass value=".4"/>
<inertia ixx=".001" ixy="0" ixz="0" iyy=".001" iyz="0" izz=".001"/></inertial>
<collision><geometry><sphere radius="0.1"/></geometry></collision></link>
<link name="wheel_r"><inertial><mass value=".4"/>
<inertia ixx=".001" ixy="0" ixz="0" iyy=".001" iyz="0" izz=".001"/></inertial>
<collision><geometry><sphere radius="0.1"/></geometry></collision></link>
<joint name="jl" type="continuous"><parent link="chassis"/><child link="wheel_l"/>
<origin xyz="0 0.2 0"/><axis xyz="0 1 0"/></joint>
<joint name="jr" type="continuous"><parent link="chassis"/><child link="wheel_r"/>
<origin xyz="0 -0.2 0"/><axis xyz="0 1 0"/></joint></robot>
"""
"""Two wheels, and nothing else."""


def insect(hanging: float = 0.0) -> str:
    """Six legs at the sides of a long trunk: coxa, femur and tibia, whose frame is at the knee.

    Args:
        hanging: Angle in rad by which the tibia is below the femur where all joints are at zero.
    """
    text = _link("chassis", 2.2, "0 0 0", '<box size="0.36 0.16 0.06"/>')
    places = ((0.16, 1.07), (0.0, 1.57), (-0.16, 2.07))
    for i, (x, yaw) in enumerate(places):
        for side, sign in (("l", 1), ("r", -1)):
            leg = f"{side}{i}"
            text += _link(f"coxa_{leg}", 0.08, "0.025 0 0", '<box size="0.05 0.03 0.03"/>')
            text += _link(f"femur_{leg}", 0.1, "0.05 0 0", '<box size="0.1 0.02 0.02"/>')
            text += _link(f"tibia_{leg}", 0.08, "0.07 0 0", '<box size="0.14 0.02 0.02"/>')
            for number, parent, child, place, turn, axis, limits in (
                (1, "chassis", "coxa", f"{x} {0.08 * sign} 0", f"0 0 {yaw * sign}", "0 0 1", 0.7),
                (2, f"coxa_{leg}", "femur", "0.05 0 0", "0 0 0", "0 1 0", 1.4),
                (3, f"femur_{leg}", "tibia", "0.1 0 0", f"0 {hanging} 0", "0 1 0", 2.4),
            ):
                joint = _joint(
                    f"j{number}_{leg}",
                    parent,
                    f"{child}_{leg}",
                    f'{place}" rpy="{turn}',
                    axis,
                    f'lower="{-limits}" upper="{limits}"',
                )
                text += joint.replace('effort="0"', 'effort="6"')
    return f'<robot name="insect">{text}</robot>'


def ant() -> str:
    """Four legs at the corners of a ball that turn and are lifted by one joint each."""
    legs = []
    for i, (x, y) in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1))):
        legs.append(
            f'<body name="aux{i}" pos="{0.2 * x} {0.2 * y} 0">'
            f'<joint name="hip{i}" axis="0 0 1" range="-0.5 0.5"/>'
            f'<geom type="capsule" fromto="0 0 0 {0.2 * x} {0.2 * y} 0" size="0.06"/>'
            f'<body name="leg{i}" pos="{0.2 * x} {0.2 * y} 0">'
            f'<joint name="ankle{i}" axis="{-y} {x} 0" range="0 1.2"/>'
            f'<geom type="capsule" fromto="0 0 0 {0.4 * x} {0.4 * y} 0" size="0.06"/>'
            "</body></body>"
        )
    trunk = '<body name="torso" pos="0 0 0.75"><freejoint/><geom type="sphere" size="0.2"/>'
    world = f"<worldbody>{trunk}{''.join(legs)}</body></worldbody>"
    return f'<mujoco model="ant"><compiler angle="radian"/>{world}</mujoco>'


def clamp_arm(*, effort: float = 0, velocity: float = 0, scale: float = 1) -> str:
    """An arm of five hinges, with two sliding clamps that no name calls fingers.

    Args:
        effort: The limit of each joint, N m or N.
        velocity: Likewise, rad/s or m/s.
        scale: Of its masses.
    """
    links = (
        ("Part_1", 3.0, "0 0 0.05", '<cylinder radius="0.09" length="0.1"/>'),
        ("Bracket_2", 1.2, "0 0 0.08", '<cylinder radius="0.05" length="0.16"/>'),
        ("Tube_1", 0.9, "0.15 0 0", '<box size="0.3 0.05 0.05"/>'),
        ("Tube_2", 0.6, "0.13 0 0", '<box size="0.26 0.045 0.045"/>'),
        ("Servo_7", 0.3, "0.04 0 0", '<box size="0.08 0.04 0.04"/>'),
        ("Plate", 0.2, "0.015 0 0", '<box size="0.03 0.12 0.05"/>'),
        ("Clamp_A", 0.05, "0.04 0 0", '<box size="0.08 0.012 0.03"/>'),
        ("Clamp_B", 0.05, "0.04 0 0", '<box size="0.08 0.012 0.03"/>'),
    )
    joints = (
        ("Revolute_1", "Part_1", "Bracket_2", "0 0 0.1", "0 0 1", -3.1, 3.1),
        ("Revolute_2", "Bracket_2", "Tube_1", "0 0 0.18", "0 1 0", -2.4, 1.2),
        ("Revolute_3", "Tube_1", "Tube_2", "0.3 0 0", "0 1 0", -0.4, 2.7),
        ("Revolute_4", "Tube_2", "Servo_7", "0.26 0 0", "0 -1 0", -2.2, 2.2),
        ("Revolute_5", "Servo_7", "Plate", "0.08 0 0", "1 0 0", -3.1, 3.1),
        ("Slider_1", "Plate", "Clamp_A", "0.03 0.05 0", "0 -1 0", 0, 0.042),
        ("Slider_2", "Plate", "Clamp_B", "0.03 -0.05 0", "0 1 0", 0, 0.042),
    )
    text = ""
    for name, mass, place, shape in links:
        inertia = mass * scale * 2e-3
        text += (
            f'<link name="{name}"><inertial><origin xyz="{place}"/><mass value="{mass * scale}"/>'
            f'<inertia ixx="{inertia}" ixy="0" ixz="0" iyy="{inertia}" iyz="0" izz="{inertia}"/>'
            f'</inertial><collision><origin xyz="{place}"/><geometry>{shape}</geometry>'
            "</collision></link>"
        )
    for name, parent, child, place, axis, low, high in joints:
        kind = "revolute" if name.startswith("Rev") else "prismatic"
        text += (
            f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{place}"/><axis xyz="{axis}"/><limit lower="{low}" upper="{high}" '
            f'effort="{effort:g}" velocity="{velocity:g}"/></joint>'
        )
    return f'<robot name="Assembly">{text}</robot>'
