"""Which links of a robot collide: the rule of its file, `self_collision`, and the switch."""

import math

import mujoco
import numpy as np
import pytest

from embodichain.lab.sim.cfg import (
    AttachedFileCfg,
    AttachmentCfg,
    RigidObjectCfg,
    RobotCfg,
    SelfCollisionCfg,
)
from embodichain.lab.sim.compiler.robot.articulation import parse_articulation
from embodichain.lab.sim.compiler.robot.contacts.link_siblings import sibling_pairs
from embodichain.lab.sim.compiler.robot.overlaps import overlapping_links
from embodichain.lab.sim.shapes import CubeCfg, SphereCfg
from embodichain.utils.errors import ConfigError
from tests.lab.sim.compiler.helpers import INERTIAL, scene_of, start, touching, write

# Two pads on rails above a palm, which meet after 0.05 m each.
FINGERS = """<mujoco><option timestep="0.002"/><worldbody>
<body name="palm" pos="0 0 0.5"><geom name="palm" type="box" size="0.1 0.03 0.02"/>
 <body name="l" pos="-0.06 0 0.08"><joint name="l" type="slide" axis="1 0 0" range="-0.02 0.1"/>
  <geom name="lf" type="box" size="0.01 0.02 0.05" mass="0.2"/></body>
 <body name="r" pos="0.06 0 0.08"><joint name="r" type="slide" axis="-1 0 0" range="-0.02 0.1"/>
  <geom name="rf" type="box" size="0.01 0.02 0.05" mass="0.2"/></body>
</body></worldbody>
<actuator><motor name="lm" joint="l" ctrlrange="0 5"/><motor name="rm" joint="r" ctrlrange="0 5"/>
</actuator><keyframe><key name="squeeze" ctrl="2 2"/></keyframe>{more}</mujoco>"""


@pytest.fixture
def fingers(tmp_path):
    return write(tmp_path / "fingers.xml", FINGERS.format(more=""))


def stroke(scene, steps=1000):
    data = mujoco.MjData(scene.model)
    mujoco.mj_setState(scene.model, data, scene.initial_row, mujoco.mjtState.mjSTATE_INTEGRATION)
    scene.model.opt.timestep = 0.002
    for _ in range(steps):
        mujoco.mj_step(scene.model, data)
    return data.qpos


# -- MJCF ----------------------------------------------------------------------------------------


def test_fingers_of_an_mjcf_stop_at_each_other(fingers):
    np.testing.assert_allclose(stroke(scene_of({"r": RobotCfg(fpath=fingers)})), 0.05, atol=1e-3)
    off = RobotCfg(fpath=fingers, disable_self_collision=True)
    np.testing.assert_allclose(stroke(scene_of({"r": off})), 0.1, atol=2e-3)
    apart = SelfCollisionCfg(exclude=[("l", "r")])
    off = RobotCfg(fpath=fingers, self_collision=apart)
    np.testing.assert_allclose(stroke(scene_of({"r": off})), 0.1, atol=2e-3)


@pytest.mark.parametrize("disabled", [False, True])
def test_contact_bits_of_an_mjcf_stay_as_written(tmp_path, disabled):
    # Of three plates on the ground (bits 1, 1) only the first meets it; none meets another.
    plates = "".join(
        f'<body name="{name}" pos="{x} 0 0"><joint type="slide" axis="0 0 1"/>'
        f'<geom name="{name}" type="box" size="0.1 0.1 0.1" contype="{a}" conaffinity="{b}"/>'
        "</body>"
        for name, x, a, b in (("p", 0.3, 1, 1), ("q", 0.6, 2, 4), ("s", 0.9, 0, 2))
    )
    text = f'<mujoco><worldbody><body name="base">{plates}</body></worldbody></mujoco>'
    cfg = RobotCfg(fpath=write(tmp_path / "p.xml", text), disable_self_collision=disabled)
    scene = scene_of({"r": cfg})
    for name, contype, conaffinity in (("p", 1, 1), ("q", 2, 4), ("s", 0, 2)):
        geom = scene.model.geom(f"r/{name}")
        assert (geom.contype[0], geom.conaffinity[0]) == (contype, conaffinity)
    assert touching(scene, start(scene, {})) == {frozenset({"world", "r/p"})}


CHAIN = """<mujoco><worldbody><geom name="wall" type="box" size="0.01 0.3 0.3" pos="0.26 0 0.5"/>
<body name="a" pos="0 0 0.5">
 <geom name="a" type="box" size="0.1 0.1 0.1" friction="0.3 0.01 0.001" condim="4" solmix="3"
  solref="0.01 0.9" solimp="0.8 0.9 0.01 0.4 2" margin="0.02" gap="0.005" priority="{priority}"/>
 <body name="b" pos="0.15 0 0"><joint name="j1" axis="0 1 0"/>
  <geom name="b" size="0.1" friction="0.7" margin="0.01"/>
  <body name="c" pos="-0.05 0 0"><joint name="j2" axis="0 1 0"/>
   <geom name="c" size="0.1" friction="0.1" condim="6"/></body></body></body>
</worldbody></mujoco>"""


def contacts(model):
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return {
        frozenset(model.geom(g).name for g in c.geom): (
            c.dim,
            c.exclude,
            *np.round([c.dist, c.includemargin, *c.friction, *c.solref, *c.solimp], 12),
        )
        for c in data.contact
    }


@pytest.mark.parametrize("priority", [0, 2, -1])
def test_a_fixed_base_meets_its_children_as_in_mujoco(tmp_path, priority):
    # Here the base is a mocap body, whose children MuJoCo leaves out.
    path = write(tmp_path / "chain.xml", CHAIN.format(priority=priority))
    alone = contacts(mujoco.MjModel.from_xml_path(path))
    assert {frozenset("ab"), frozenset({"wall", "b"})} <= set(alone)
    assert contacts(parse_articulation("r", RobotCfg(fpath=path)).model) == alone


def test_a_child_out_of_reach_of_the_base_costs_no_contact_pair(tmp_path):
    text = CHAIN.format(priority=0).replace('pos="0.26 0 0.5"', 'pos="0.6 0 0.5"')
    path = write(tmp_path / "chain.xml", text)
    model = parse_articulation("r", RobotCfg(fpath=path)).model
    pairs = [
        {model.geom(int(g)).name for g in pair}
        for pair in zip(model.pair_geom1, model.pair_geom2, strict=True)
    ]
    assert pairs == [{"a", "b"}]  # the wall is 0.34 m from b, and b turns about its middle
    floating = parse_articulation("r", RobotCfg(fpath=path, fix_base=False))
    assert floating.model.npair == 0  # its parent moves: MuJoCo leaves the pair out


# -- URDF ----------------------------------------------------------------------------------------


def humanoid(size=0.1):
    """A trunk with two arms of two links; hands at y = +-0.3 meet the trunk if turned inwards."""
    links, joints = "", ""
    box = f'<collision><geometry><box size="{size} {size} {size}"/></geometry></collision>'
    for name in ("trunk", "left_arm", "left_hand", "right_arm", "right_hand"):
        links += f'<link name="{name}">{INERTIAL}{box}</link>'
    for side, sign in (("left", 1), ("right", -1)):
        joints += (
            f'<joint name="{side}_shoulder" type="revolute"><parent link="trunk"/>'
            f'<child link="{side}_arm"/><origin xyz="0 {0.2 * sign} 0"/><axis xyz="0 0 1"/>'
            '<limit lower="-3" upper="3" effort="10" velocity="1"/></joint>'
            f'<joint name="{side}_elbow" type="prismatic"><parent link="{side}_arm"/>'
            f'<child link="{side}_hand"/><origin xyz="0 {0.2 * sign} 0"/>'
            f'<axis xyz="0 {-sign} 0"/><limit lower="0" upper="0.5" effort="10" velocity="1"/>'
            "</joint>"
        )
    return f'<robot name="h">{links}{joints}</robot>'


@pytest.fixture
def path(tmp_path):
    return write(tmp_path / "h.urdf", humanoid())


def pairs_of(parsed):
    """Pairs of bodies that the model excludes."""
    model = parsed.model
    found = [(int(s) >> 16, int(s) & 0xFFFF) for s in model.exclude_signature]
    return {frozenset({model.body(a).name, model.body(b).name}) for a, b in found}


LEFT, RIGHT = frozenset({"trunk", "left_hand"}), frozenset({"trunk", "right_hand"})
INWARDS = {"left_elbow": 0.35}  # the hand's middle is 0.05 m from the trunk's: 0.05 m deep


def test_links_of_a_urdf_collide_unless_they_overlap_at_the_start(path, caplog):
    assert pairs_of(parse_articulation("h", RobotCfg(fpath=path))) == set()
    shallow = RobotCfg(fpath=path, init_qpos={"left_elbow": 0.3009})  # 0.9 mm
    assert pairs_of(parse_articulation("h", shallow)) == set()
    deep = RobotCfg(fpath=path, init_qpos={"left_elbow": 0.3011})  # 1.1 mm
    assert pairs_of(parse_articulation("h", deep)) == {LEFT, RIGHT}
    scene = scene_of({"h": RobotCfg(fpath=path, init_qpos=INWARDS, init_pos=(0, 0, 1))})
    assert touching(scene, start(scene, {"h": [0, 0.35, 0, 0.35]})) == set()
    # The hands are still stopped by each other and by the other arm.
    assert frozenset({"h/left_hand", "h/right_hand"}) in touching(
        scene, start(scene, {"h": [0, 0.42, 0, 0.42]})
    )
    (line,) = [r.getMessage() for r in caplog.records]
    assert "trunk and left_hand (50 mm); those named like pairs that are" in line
    assert line.count("trunk and right_hand") == 1


def test_include_and_exclude_decide_about_pairs(path, caplog):
    def decided(init_qpos=None, **lists):
        given = SelfCollisionCfg(**lists)
        cfg = RobotCfg(fpath=path, init_qpos=init_qpos, self_collision=given)
        return parse_articulation("h", cfg)

    assert pairs_of(decided(exclude=[("left_.*", "right_.*")])) == {
        frozenset({f"left_{a}", f"right_{b}"}) for a in ("arm", "hand") for b in ("arm", "hand")
    }
    brought = decided(INWARDS, include=[("trunk", "left_hand")])
    assert pairs_of(brought) == {RIGHT}
    assert "right_hand" in brought.self_collision.note()
    both = decided(exclude=[(".*", ".*")], include=[("left_hand", "right_hand")])
    assert frozenset({"left_hand", "right_hand"}) not in pairs_of(both)
    assert LEFT in pairs_of(both)
    named = decided(INWARDS, exclude=[("trunk", ".*_hand")])
    assert pairs_of(named) == {LEFT, RIGHT} and named.self_collision.note() == ""
    with_parent = decided({"left_shoulder": 0.1}, include=[("trunk", "left_arm")]).model
    assert with_parent.npair == 1


@pytest.mark.parametrize(
    ("given", "where", "message"),
    [
        ({"exclude": [("trunk", "left_hnd")]}, "exclude.0.1", "no link matches 'left_hnd'"),
        ({"exclude": [("trunk", "(")]}, "exclude.0.1", "malformed regex"),
        ({"include": [("trunk", "trunk")]}, "include.0", "is one link"),
        ({"include": [("trunk",)]}, "include.0", "expected two links"),
        ({"include": [("left_hand", "palm")]}, "include.0", "fixed to each other"),
        ({"include": [("trunk", "frame")]}, "include.0", "no shapes whose contact bits meet"),
        (
            {"include": [("trunk", "left_hand")], "exclude": [("left_hand", "trunk")]},
            "include.0",
            "is excluded too",
        ),
    ],
)
def test_mistakes_are_named(tmp_path, given, where, message):
    palm = (
        '<link name="palm"><collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision>'
        '</link><joint name="p" type="fixed"><parent link="left_hand"/><child link="palm"/></joint>'
        '<link name="frame"/><joint name="f" type="fixed"><parent link="left_hand"/>'
        '<child link="frame"/></joint></robot>'
    )
    path = write(tmp_path / "h.urdf", humanoid().replace("</robot>", palm))
    cfg = RobotCfg(fpath=path, self_collision=SelfCollisionCfg(**given))
    with pytest.raises(ConfigError) as raised:
        parse_articulation("h", cfg)
    (problem,) = raised.value.problems
    assert problem.path == f"h.self_collision.{where}"
    assert message in problem.message
    if "hnd" in message:
        assert "left_hand" in problem.hint


# -- the switch ----------------------------------------------------------------------------------


def test_the_switch_leaves_out_pairs_of_links_and_nothing_else(tmp_path, path):
    objects = {"cube": RigidObjectCfg(shape=CubeCfg(size=[0.1] * 3), init_pos=(0, 0.2, 1.05))}
    cfg = RobotCfg(fpath=path, init_qpos=INWARDS, init_pos=(0, 0, 1), disable_self_collision=True)
    scene = scene_of({"h": cfg, "g": RobotCfg(fpath=path, init_pos=(0, 0.4, 1))}, objects)
    pairs = touching(scene, start(scene, {"h": [0, 0.42, 0, 0.42], "g": [0] * 4}))
    assert not any({name[0] for name in pair} == {"h"} for pair in pairs)
    assert frozenset({"h/left_arm", "cube"}) in pairs
    assert any({name[0] for name in pair} == {"h", "g"} for pair in pairs)
    kept = SelfCollisionCfg(include=[("left_hand", "right_hand")])
    cfg = RobotCfg(fpath=path, init_pos=(0, 0, 1), disable_self_collision=True, self_collision=kept)
    scene = scene_of({"h": cfg})
    assert touching(scene, start(scene, {"h": [0, 0.42, 0, 0.42]})) == {
        frozenset({"h/left_hand", "h/right_hand"})
    }


def test_contact_pairs_and_excludes_of_the_file_follow_the_config(tmp_path):
    more = (
        '<contact><pair geom1="lf" geom2="rf"/><exclude body1="palm" body2="l"/>'
        '<exclude body1="palm" body2="r"/></contact>'
    )
    path = write(tmp_path / "f.xml", FINGERS.format(more=more))

    def model(**fields):
        return parse_articulation("r", RobotCfg(fpath=path, **fields)).model

    assert model().npair == 1
    assert model(disable_self_collision=True).npair == 0
    assert model(self_collision=SelfCollisionCfg(exclude=[("l", "r")])).npair == 0
    again = model(self_collision=SelfCollisionCfg(include=[("palm", "l")]))
    assert again.npair == 2 and again.nexclude == 1


def test_more_than_thirty_robots_can_be_switched_off(tmp_path, fingers):
    robots = {
        f"r{i}": RobotCfg(fpath=fingers, init_pos=(i, 0, 0), disable_self_collision=True)
        for i in range(32)
    }
    np.testing.assert_allclose(stroke(scene_of(robots), 600), 0.1, atol=5e-3)


# -- several files -------------------------------------------------------------------------------


def test_an_attached_file_keeps_its_own_rule(tmp_path, path):
    # The pads are in each other, and the left one in the arm above the hand that it is fixed on.
    text = FINGERS.format(more="").replace('pos="-0.06', 'pos="0.045').replace("0 0 0.5", "0 0 0")
    hand = write(tmp_path / "hand.xml", text.replace("0 0 0.08", "0 0 0"))
    gripper = AttachedFileCfg(fpath=hand, to="left_hand", pos=(0, -0.2, 0))
    parsed = parse_articulation("h", RobotCfg(fpath=path, attach={"grip": gripper}))
    assert pairs_of(parsed) == {frozenset({"left_arm", "grip/l"})}
    rule = parsed.self_collision.rule
    assert "grip/: its file decides" in rule


def test_attachments_follow_the_rule_of_a_urdf(fingers):
    ball = AttachmentCfg(link="l", shape=SphereCfg(radius=0.2))
    parsed = parse_articulation("r", RobotCfg(fpath=fingers, attachments={"ball": ball}))
    assert pairs_of(parsed) == {frozenset({"ball", "r"})}


# -- names ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("names", "pair", "others"),
    [
        ("base FL_thigh FR_thigh RL_thigh RR_thigh", (0, 1), {(0, 2), (0, 3), (0, 4)}),
        ("LF_HIP LF_FOOT RH_HIP RH_FOOT", (0, 1), {(2, 3)}),
        ("FL_hip FL_calf FR_hip FR_calf", (0, 3), {(1, 2)}),
        ("FL_t FR_t RL_t RR_t", (0, 1), {(2, 3)}),
        ("palm leftfinger rightfinger", (0, 1), {(0, 2)}),
        ("LHip l_arm RHip r_arm", (0, 1), {(2, 3)}),
        ("palm finger_1 finger_2 finger_3", (0, 2), {(0, 1), (0, 3)}),
        ("leg1 leg2 leg3 leg4", (0, 1), {(1, 2), (2, 3)}),
        ("palm thumb index", (0, 1), set()),
    ],
)
def test_mirrored_and_repeated_pairs_are_found_by_name(names, pair, others):
    links = ["world", *names.split()]
    found = sibling_pairs([(pair[0] + 1, pair[1] + 1)], links, [0] * len(links))
    assert {(a - 1, b - 1) for a, b in found} == others


def test_links_of_one_chain_are_no_siblings():
    names = [f"link_{i}" for i in range(6)]
    assert sibling_pairs([(1, 3)], names, [0, 0, 1, 2, 3, 4]) == set()


def test_a_gripper_on_one_arm_is_no_mirror_of_the_other_arm():
    names = ["trunk", "left_arm", "right_arm", "grip/l", "grip/r"]
    assert sibling_pairs([(1, 3)], names, [0, 0, 0, 1, 1]) == set()


# -- real robots ---------------------------------------------------------------------------------


def test_the_base_and_the_thighs_of_a_go2_overlap():
    stance = {".*_hip_joint": 0, ".*_thigh_joint": 0.9, ".*_calf_joint": -1.8}
    cfg = RobotCfg(fpath="go2_description/urdf/go2.urdf", fix_base=False, init_qpos=stance)
    legs = ("FL", "FR", "RL", "RR")
    assert pairs_of(parse_articulation("go2", cfg)) == {
        frozenset({"base", f"{leg}_thigh"}) for leg in legs
    }


def test_a_g1_without_torques_falls_on_itself_as_in_mujoco():
    cfg = RobotCfg(fpath="g1_description/urdf/g1_29dof_rev_1_0.urdf")
    parsed = parse_articulation("g1", cfg)
    touch = {frozenset({"left_knee_link", "right_knee_link"})}
    assert not touch & pairs_of(parsed)
    model, data = parsed.model, mujoco.MjData(parsed.model)
    data.qpos[model.joint("left_hip_roll_joint").qposadr[0]] = -0.4
    mujoco.mj_forward(model, data)
    met = {
        frozenset(model.body(int(model.geom_bodyid[g])).name for g in c.geom) for c in data.contact
    }
    assert touch & met


# -- postures ------------------------------------------------------------------------------------


def test_links_that_overlap_in_many_postures_are_named(tmp_path):
    # A ball 0.2 m from the axis meets a post of the base within +-2 asin(0.1 / 0.4) of its place:
    # in 2 * 2 asin(0.25) / 2 pi = 16.1 % of a turn.
    text = """<mujoco><default><default class="none"><geom size="0.01" contype="0" conaffinity="0"/>
      </default></default><worldbody><body name="base"><freejoint/><geom class="none"/>
      <body name="hub"><joint name="h" range="-0.001 0.001"/><geom class="none"/>
      <body name="arm"><joint name="a"/><geom class="none"/>
      <body name="ball" pos="0.2 0 0"><joint name="b" range="-0.001 0.001"/>
       <geom name="ball" size="0.05"/></body></body></body>
      <body name="post" pos="-0.2 0 0"><joint name="p" range="-0.001 0.001"/>
       <geom name="post" size="0.05"/></body></body></worldbody></mujoco>"""
    path = write(tmp_path / "p.xml", text)
    found = overlapping_links(parse_articulation("p", RobotCfg(fpath=path, fix_base=False)))
    ((pair, share),) = found.items()
    assert set(pair) == {"ball", "post"}
    assert share == pytest.approx(4 * math.asin(0.25) / (2 * math.pi), abs=0.06)
    for given in (SelfCollisionCfg(exclude=[pair]), SelfCollisionCfg(include=[pair])):
        cfg = RobotCfg(fpath=path, fix_base=False, self_collision=given)
        assert overlapping_links(parse_articulation("p", cfg)) == {}
