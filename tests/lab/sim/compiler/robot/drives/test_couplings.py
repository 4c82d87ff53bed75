"""Joints that follow others: a URDF's ``mimic`` is rigid, an MJCF's equality has no leader."""

import dataclasses
import math

import mujoco
import numpy as np
import pytest

from embodichain.lab.sim.cfg import (
    AttachedFileCfg,
    JointDrivePropertiesCfg,
    RobotCfg,
    SimulationManagerCfg,
)
from embodichain.lab.sim.compiler.robot.articulation import parse_articulation
from embodichain.lab.sim.sim_manager import SimulationManager
from tests.lab.sim.compiler.helpers import UR10, scene_of, write

# Links of grams, as of a small hand: a revolute chain, a reversed and a sliding follower.
LINK = """<link name="{name}"><inertial><origin xyz=".012 0 0"/><mass value="{mass}"/>
<inertia ixx="{inertia}" iyy="{inertia}" izz="{inertia}" ixy="0" ixz="0" iyz="0"/></inertial></link>
"""
JOINT = """<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{name}_link"/>
<origin xyz="{x} 0 0"/><axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="5" velocity="3"/>
{mimic}</joint>
"""


def hand(*followers: dict[str, str]) -> str:
    """A URDF: a leader on a palm, and joints with the given attributes that follow."""
    text = LINK.format(name="palm", mass=0.5, inertia=1e-3)
    joints = [{"name": "lead", "parent": "palm", "kind": "revolute"}, *followers]
    for number, joint in enumerate(joints):
        mass, inertia = (0.006, 1e-6) if number == 0 else (0.004, 2e-7)
        text += LINK.format(name=f"{joint['name']}_link", mass=mass, inertia=inertia)
        values = {"kind": "revolute", "x": 0.03, "mimic": "", **joint}
        text += JOINT.format(**values)
    return f'<robot name="hand">{text}</robot>'


def follow(name: str, parent: str, leader: str = "lead", **values: str) -> dict[str, str]:
    """A follower; `values` are attributes of ``mimic``."""
    kind = values.pop("kind", "revolute")
    more = " ".join(f'{key}="{value}"' for key, value in values.items())
    mimic = f'<mimic joint="{leader}" {more}/>'
    return {"name": name, "parent": parent, "kind": kind, "mimic": mimic}


HANDS = {
    "one": hand(follow("tip", "lead_link")),
    "reversed": hand(follow("tip", "palm", multiplier="-1.5", offset="0.1")),
    "chain": hand(
        follow("middle", "lead_link", multiplier="0.8"),
        follow("tip", "middle_link", leader="middle", multiplier="0.5"),
    ),
    "slide": hand(follow("jaw", "palm", kind="prismatic", multiplier="0.04")),
}


def worst(text: str, tmp_path, dt: float, stiffness: float, damping: float, **gains) -> float:
    """The largest distance of a follower from where its leader puts it, held and moved at 1 Hz."""
    drives = JointDrivePropertiesCfg(stiffness=stiffness, damping=damping, **gains)
    cfg = RobotCfg(fpath=write(tmp_path / "h.urdf", text), init_pos=(0, 0, 1), drive_pros=drives)
    manager = SimulationManager(SimulationManagerCfg(headless=True, physics_dt=dt))
    robot = manager.add_robot(dataclasses.replace(cfg, uid="h"))
    model, data = manager.scene.model, mujoco.MjData(manager.scene.model)
    state = mujoco.mjtState.mjSTATE_INTEGRATION
    mujoco.mj_setState(model, data, manager.scene.initial_row, int(state))
    columns = [model.joint(f"h/{name}").qposadr[0] for name in robot.joint_names]
    couplings = zip(
        robot.mimic_ids, robot.mimic_parents, robot.mimic_multipliers, robot.mimic_offsets,
        strict=True,
    )  # fmt: skip
    rows, found = list(couplings), 0.0
    for step in range(round(2.0 / dt)):
        time = step * dt
        data.ctrl[0] = 0.5 * math.sin(2 * math.pi * (time - 0.5)) if 0.5 < time < 1.5 else 0.0
        mujoco.mj_step(model, data)
        qpos = data.qpos[columns]
        found = max([found, *(abs(qpos[i] - m * qpos[lead] - o) for i, lead, m, o in rows)])
    assert abs(qpos[0]) < 0.02  # the leader is where its drive holds it
    return found


@pytest.mark.parametrize("name", HANDS)
@pytest.mark.parametrize("dt", [0.002, 0.01])
@pytest.mark.parametrize("gains", [(1e4, 1e3), (50, 1)])
def test_followers_of_a_urdf_follow_to_a_milliradian_held_and_moving(tmp_path, name, dt, gains):
    assert worst(HANDS[name], tmp_path, dt, *gains) < 1e-3


def test_followers_of_limited_drives_follow(tmp_path):
    assert worst(HANDS["one"], tmp_path, 0.002, 500, 50, max_effort="file") < 1e-3


def test_the_whole_damping_of_a_coupled_drive_is_the_configured_one(tmp_path):
    fpath = write(tmp_path / "h.urdf", HANDS["reversed"])
    model = scene_of({"h": RobotCfg(fpath=fpath)}).model
    damper = -float(model.actuator("h/lead").biasprm[2])
    carried = float(model.dof_damping[model.joint("h/tip").dofadr[0]]) * 1.5**2
    assert carried > 0
    assert damper + carried == pytest.approx(1000.0)


def test_an_armature_that_is_given_is_kept(tmp_path):
    drives = JointDrivePropertiesCfg(armature=0.5)
    cfg = RobotCfg(fpath=write(tmp_path / "h.urdf", HANDS["one"]), drive_pros=drives)
    assert (scene_of({"h": cfg}).model.dof_armature == 0.5).all()


def test_a_drive_for_a_mimic_joint_alone_is_told(tmp_path):
    drives = JointDrivePropertiesCfg(stiffness={"tip": 50, ".*": 10}, damping=1)
    cfg = RobotCfg(fpath=write(tmp_path / "h.urdf", HANDS["one"]), drive_pros=drives)
    (note,) = parse_articulation("h", cfg).notes
    assert "no effect" in note and "stiffness.tip ('tip' mimics 'lead')" in note


# --------------------------------------------------------------------------- equalities of an MJCF

PAIR = """<mujoco><worldbody><body name="base" pos="0 0 1"><geom size=".05"/>
  <body name="a" pos=".1 0 0"><joint name="left" type="slide" axis="1 0 0" range="-1 1"/>
    <geom size=".02"/></body>
  <body name="b" pos="-.1 0 0"><joint name="right" type="slide" axis="-1 0 0" range="-1 1"/>
    <geom size=".02"/></body></body></worldbody>
  <equality><joint joint1="right" joint2="left" polycoef="0 2 0 0 0"/></equality>
  {actuator}</mujoco>"""
SERVO = '<actuator><position name="grip" joint="{joint}" kp="50" kv="2"/></actuator>'


def pair(tmp_path, actuator="", **values) -> RobotCfg:
    """Two sliding fingers; ``right = 2 left``."""
    return RobotCfg(fpath=write(tmp_path / "p.xml", PAIR.format(actuator=actuator)), **values)


def test_drive_pros_drives_a_joint_that_an_mjcf_couples(tmp_path):
    drives = JointDrivePropertiesCfg(stiffness={"right": 300}, damping={"right": 10})
    parsed = parse_articulation("p", pair(tmp_path, drive_pros=drives))
    assert parsed.drives == ("", "right")
    # the joint without a drive is shown as the one that follows: left = right / 2
    assert (parsed.mimic_ids, parsed.mimic_parents) == ((0,), (1,))
    assert parsed.mimic_multipliers == (0.5,)
    drives = JointDrivePropertiesCfg(stiffness=300, damping=10)  # no actuators: all joints
    both = parse_articulation("p", pair(tmp_path, drive_pros=drives))
    assert both.drives == ("left", "right")
    assert not both.mimic_ids


@pytest.mark.parametrize(("joint", "follower"), [("left", 1), ("right", 0)])
def test_of_a_pair_with_one_servo_the_other_joint_follows(tmp_path, joint, follower):
    cfg = pair(tmp_path, SERVO.format(joint=joint))
    parsed = parse_articulation("p", cfg)
    assert parsed.mimic_ids == (follower,)
    assert parsed.drives[1 - follower] == "grip"
    number = JointDrivePropertiesCfg(stiffness=300)  # of what actuators of the file act on
    assert parse_articulation("p", pair(tmp_path, SERVO.format(joint=joint), drive_pros=number))
    assert parse_articulation("p", dataclasses.replace(cfg, drive_pros=number)).drives == (
        ("left", "") if joint == "left" else ("", "right")
    )


def test_a_joint_that_init_qpos_names_takes_the_coupled_one_with_it(tmp_path):
    for given in ({"left": 0.1}, {"right": 0.2}):
        parsed = parse_articulation("p", pair(tmp_path, init_qpos=given))
        np.testing.assert_allclose(parsed.init_qpos, [0.1, 0.2])


def test_equalities_of_an_mjcf_keep_their_parameters(tmp_path):
    drives = JointDrivePropertiesCfg(stiffness=300, damping=10)
    model = scene_of({"p": pair(tmp_path, drive_pros=drives)}).model
    assert model.eq_solref.tolist() == [[0.02, 1.0]]
    attached = {"grip": AttachedFileCfg(fpath=pair(tmp_path).fpath, to="ee_link")}
    drives = JointDrivePropertiesCfg(stiffness={".*": 300}, damping={".*": 10})
    cfg = RobotCfg(fpath=UR10, attach=attached, drive_pros=drives)
    assert parse_articulation("arm", cfg).drives[-2:] == ("grip/left", "grip/right")
    assert scene_of({"arm": cfg}).model.eq_solref.tolist() == [[0.02, 1.0]]


def test_an_attached_urdf_couples_as_rigidly(tmp_path):
    fpath = write(tmp_path / "h.urdf", HANDS["one"])
    cfg = RobotCfg(fpath=UR10, attach={"hand": AttachedFileCfg(fpath=fpath, to="ee_link")})
    model = scene_of({"arm": cfg}, sim=SimulationManagerCfg(headless=True, physics_dt=0.004)).model
    assert model.eq_solref.tolist() == [[0.008, 1.0]]
    parsed = parse_articulation("arm", cfg)
    assert [parsed.joint_names[i] for i in parsed.mimic_ids] == ["hand/tip"]
