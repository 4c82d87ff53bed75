"""What an MJCF robot says is what moves: every field and 200 steps are those of the file alone.

Each robot is written for kinds of elements and attributes; MuJoCo, which loads the same file
without this package, says what is right.
"""

from __future__ import annotations

import struct
from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy.spatial import ConvexHull

from embodichain.lab.sim.cfg import (
    AttachmentCfg,
    RigidBodyAttributesCfg,
    RigidObjectCfg,
    RobotCfg,
    SimulationManagerCfg,
)
from embodichain.lab.sim.compiler.robot.articulation import parse_articulation
from embodichain.lab.sim.compiler.robot.files.robot_files import read_model
from embodichain.lab.sim.shapes import MeshCfg
from embodichain.utils.errors import ConfigError
from tests.helpers.kept_files import Twin, in_scene
from tests.lab.sim.compiler.helpers import scene_of, write

FLOOR = '<geom name="floor" type="plane" size="5 5 .1" {}/>'
BALL = '<body name="{name}" pos="{pos}"><freejoint/><geom size=".1"/></body>'


def robot(
    bodies: str,
    rest: str = "",
    *,
    floor: str | None = "",
    compiler: str = "",
    option: str = "",
    head: str = "",
) -> str:
    """The text of an MJCF file; `floor` are attributes of its floor, None is no floor."""
    ground = "" if floor is None else FLOOR.format(floor)
    return (
        f'<mujoco><compiler angle="radian" {compiler}/><option {option}/>{head}'
        f"<worldbody>{ground}{bodies}</worldbody>{rest}</mujoco>"
    )


LEG = """<body name="torso" pos="0 0 {height}">
  {root}
  <geom name="hull" type="box" size=".1 .08 .06" mass="3"/>
  <body name="thigh" pos="0 0 -.1">
    <joint name="hip" axis="0 1 0" range="-1 1" damping=".3" armature=".01" stiffness="2"
      springref=".1" frictionloss=".05"/>
    <geom name="femur" type="capsule" fromto="0 0 -.02 0 0 -.2" size=".03" mass=".5"/>
    <body name="shin" pos="0 0 -.25">
      <joint name="knee" axis="0 1 0" range="-2 0" ref="-.6" damping=".1"/>
      <geom name="foot" size=".04" pos="0 0 -.2" mass=".2" friction=".6 .01 .001" condim="4"
        solref=".01 .8" solimp=".8 .9 .01" margin=".002" priority="0"/>
      <site name="sole" pos="0 0 -.24"/>
    </body>
  </body>
</body>"""
SERVOS = """<actuator>
  <position name="hip" joint="hip" kp="20" kv="1" ctrlrange="-1 1"/>
  <motor name="knee" joint="knee" gear="2"/>
</actuator>"""

ROBOTS = {
    "a floating leg on its floor": robot(
        LEG.format(root='<freejoint name="float"/>', height=0.62), SERVOS, floor='friction=".7"'
    ),
    "a hopper whose joints have a ref": robot(
        LEG.format(
            height=1.25,
            root='<joint name="x" type="slide" axis="1 0 0" pos="0 0 -1.25"/>'
            '<joint name="z" type="slide" axis="0 0 1" ref="1.25"/>'
            '<joint name="pitch" axis="0 1 0" ref=".2"/>',
        ),
        SERVOS,
    ),
    "damping, armature, friction and stiffness of a free joint, and a motor on it": robot(
        '<body name="drone" pos="0 0 1"><joint name="root" type="free" damping=".7" armature=".05"'
        ' frictionloss=".02" stiffness="3"/><geom type="box" size=".1 .1 .03" mass="1"/></body>',
        '<actuator><motor name="lift" joint="root" gear="0 0 1 0 0 0"/></actuator>'
        '<sensor><framelinvel objtype="body" objname="drone"/></sensor>',
    ),
    "feet that touch only by pairs": robot(
        LEG.format(root="<freejoint/>", height=0.62).replace(
            "<geom ", '<geom contype="0" conaffinity="0" '
        ),
        '<contact><pair name="step" geom1="foot" geom2="floor" condim="3" friction=".9'
        ' .4 .01 .1 .1"'
        ' solref=".03 1" margin=".01" gap=".004"/><exclude body1="world" body2="thigh"/>'
        '<exclude body1="torso" body2="shin"/></contact>'
        '<sensor><distance name="clearance" geom1="foot" geom2="floor" cutoff="2"/>'
        '<contact name="touch" geom1="floor" geom2="foot" data="found force"/></sensor>'
        '<custom><tuple name="pads"><element objtype="geom" objname="floor"/></tuple></custom>',
    ),
    "collision groups": robot(
        '<body name="a" pos="0 0 .5"><joint name="a" type="slide" axis="0 0 1"/>'
        '<geom type="box" size=".2 .2 .05" contype="2" conaffinity="4"/></body>'
        '<body name="b" pos="0 0 .8"><joint name="b" type="slide" axis="0 0 1"/>'
        '<geom type="box" size=".2 .2 .05" contype="0" conaffinity="2"/></body>'
        '<body name="c" pos="1 0 .5"><joint name="c" type="slide" axis="0 0 1"/>'
        '<geom size=".1" contype="8" conaffinity="0"/></body>',
        floor='contype="0" conaffinity="8"',
    ),
    "a total mass": robot(
        LEG.format(root="<freejoint/>", height=0.62), compiler='settotalmass="12"'
    ),
    "bounded and balanced inertias": robot(
        '<body name="a" pos="0 0 .5"><joint name="j" axis="0 1 0"/><geom size=".01" density="1"/>'
        '<body name="b" pos="0 0 .1"><joint name="k" axis="1 0 0"/><inertial pos="0 0 0" mass="1"'
        ' diaginertia=".1 .01 .01"/></body></body>',
        compiler='boundmass=".02" boundinertia="1e-4" balanceinertia="true"',
    ),
    "inertias from geoms, degrees, another euler sequence": (
        '<mujoco><compiler inertiafromgeom="true" inertiagrouprange="0 1" angle="degree"'
        ' eulerseq="ZYX"/><worldbody><body name="a" pos="0 0 1" euler="10 20 30">'
        '<joint name="j" axis="0 1 0" range="-40 50" ref="15"/>'
        '<inertial pos="1 1 1" mass="50" diaginertia="1 1 1"/>'
        '<geom size=".1" mass="2"/><geom size=".3" group="3" mass="9"/></body></worldbody></mujoco>'
    ),
    "bodies fixed to the world, and shapes and sites of the world": robot(
        '<geom name="step" type="box" size=".3 .3 .1" pos=".2 0 .1"/><site name="hook"'
        ' pos="0 0 2"/>'
        + LEG.format(root='<joint name="lift" type="slide" axis="0 0 1" damping="2"/>', height=0.9)
        + '<body name="post" pos="1 0 .5"><geom type="box" size=".05 .05 .5"/></body>',
        '<tendon><spatial name="rope" range="0 1.3" stiffness="4"><site site="hook"/>'
        '<site site="sole"/></spatial></tendon>' + SERVOS,
    ),
    "a base that touches its first link": robot(
        '<body name="base" pos="0 0 1"><geom name="pad" type="box" size=".2 .2 .02" friction=".3"'
        ' solref=".03 1" solmix="2"/><body name="slider" pos="0 0 .1"><joint name="fall"'
        ' type="slide"'
        ' axis="0 0 1"/><geom name="block" type="box" size=".05 .05 .05" friction=".8 .1 .1"'
        ' condim="6" solimp=".7 .9 .002"/></body><body name="plate" pos=".5 0 .1"><joint'
        ' name="turn"'
        ' axis="0 1 0"/><geom type="box" size=".4 .02 .01"/></body></body>',
        floor=None,
    ),
    "welds, connects and joints equal to others, in the world too": robot(
        '<body name="base" pos="0 0 1"><geom size=".05"/>'
        '<body name="a"><joint name="a" axis="0 1 0"/><geom type="capsule" size=".02"'
        ' fromto="0 0 0 .3 0 0"/></body>'
        '<body name="b" pos="0 .2 0"><joint name="b" axis="0 1 0"/><geom type="capsule" size=".02"'
        ' fromto="0 0 0 .3 0 0"/><body name="tip" pos=".3 0 0"><joint name="c" axis="0 1 0"/>'
        '<geom size=".04"/></body></body></body>',
        '<equality><joint joint1="a" joint2="b" polycoef=".1 .5 .1 0 0" solref=".05 1"/>'
        '<connect name="pin" body1="tip" anchor="0 0 .05"/>'
        '<weld name="glue" body1="a" relpose="0 0 1.1 1 0 .1 0" solref=".1 1" torquescale=".5"/>'
        '<weld body1="world" body2="tip" active="false"/></equality>'
        '<sensor><framepos objtype="body" objname="tip" reftype="body" refname="world"/></sensor>',
        floor=None,
    ),
    "tendons, muscles and other actuators": robot(
        '<body name="base" pos="0 0 1"><geom size=".05"/><site name="s0" pos=".05 0 0"/>'
        '<body name="a"><joint name="a" axis="0 1 0" damping=".1" actuatorfrcrange="-6 6"'
        ' actuatorgravcomp="true"/><geom type="capsule" size=".02" fromto="0 0 0 .3 0 0"/>'
        '<site name="s1" pos=".1 0 .03"/><body name="b" pos=".3 0 0" gravcomp=".5"><joint name="b"'
        ' axis="0 1 0" type="hinge" range="-1 1" solreflimit=".03 1" margin=".1"/>'
        '<geom size=".05"/><body name="c" pos=".1 0 0"><joint name="socket" type="ball"'
        ' damping=".2"'
        ' range="0 1"/><geom type="ellipsoid" size=".03 .04 .05"/></body></body></body></body>',
        '<tendon><spatial name="cord" springlength=".1 .2" stiffness="40" damping="2"'
        ' limited="true"'
        ' range="0 .5" frictionloss=".1"><site site="s0"/><site site="s1"/></spatial>'
        '<fixed name="sum" armature=".01"><joint joint="a" coef="1"/><joint joint="b" coef="-.5"/>'
        "</fixed></tendon><actuator>"
        '<muscle name="m" tendon="cord" ctrlrange="0 1" lengthrange=".05 .2"/>'
        '<general name="g" joint="a" dyntype="filterexact" dynprm=".1" gainprm="7"'
        ' biastype="affine"'
        ' biasprm="0 -7 -1" actlimited="true" actrange="-1 1"/>'
        '<intvelocity name="i" joint="b" kp="5" actrange="-1 1"/><damper name="d" joint="b" kv="2"'
        ' ctrlrange="0 1"/><general name="on_site" site="s1" gear="1 0 0 0 0 1"/>'
        '<position name="fixed" tendon="sum" kp="9" dampratio="1" forcerange="-2 3"/></actuator>'
        '<sensor><actuatorfrc name="f" actuator="m" cutoff="5"/><accelerometer site="s1"'
        ' noise=".1"/></sensor>',
        floor=None,
    ),
    "a keyframe called home, and room for more": robot(
        LEG.format(root="<freejoint/>", height=0.62),
        SERVOS
        + '<keyframe><key name="low" qpos="0 0 .5 1 0 0 0 .1 -1"/><key name="home" ctrl=".2 .1"'
        ' qpos=".1 .2 .7 .8 .6 0 0 .3 -.9" qvel=".1 0 .3 0 .4 0 .5 .6"/></keyframe>',
        head='<size nkey="5" nuser_geom="3" nuser_jnt="2" memory="3M"/>',
    ),
    "a fluid": robot(
        LEG.format(root="<freejoint/>", height=2).replace(
            'name="foot"', 'name="foot" fluidshape="ellipsoid"'
        ),
        option='density="1000" viscosity=".01" wind="1 0 0" timestep=".001"',
        floor=None,
    ),
    "a static body and a wall beside a floating robot": robot(
        '<geom name="wall" type="plane" size="1 1 .1" pos=".3 0 0" zaxis="-1 0 0"/>'
        + LEG.format(root="<freejoint/>", height=0.62)
        + '<body name="beacon" pos=".1 0 0"><geom type="box" size=".1 .1 .02"/></body>'
        '<body name="gate" pos="0 1 1"><joint name="hinge" axis="0 0 1"/><geom size=".1"/></body>'
    ),
    "a floating robot that a mocap body pulls": robot(
        '<body name="hand" mocap="true" pos="0 .1 .9"><geom size=".02" contype="0"'
        ' conaffinity="0"/>'
        "</body>" + LEG.format(root="<freejoint/>", height=0.62),
        '<equality><weld body1="hand" body2="torso" relpose="0 0 -.1 1 0 0 0"/></equality>',
    ),
    "bodies that MuJoCo computes as simple": robot(
        '<body name="hand" pos="0 0 1"><geom type="box" size=".05 .05 .05" mass="1"/>'
        '<body name="left" pos=".1 0 0"><joint name="left" type="slide" axis="1 0 0"'
        ' armature=".1"/>'
        '<geom type="box" size=".01 .02 .05" mass=".015"/></body>'
        '<body name="right" pos="-.1 0 0"><joint name="right" type="slide" axis="1 0 0"/>'
        '<geom type="box" size=".01 .02 .05" mass=".015"/></body></body>',
        '<equality><joint joint1="left" joint2="right" polycoef="0 -1 0 0 0"/></equality>',
        floor=None,
    ),
    "a floor at another height": robot(
        LEG.format(root="<freejoint/>", height=0.3), floor='pos="0 0 -.4"'
    ),
    "limits that the start is beyond": robot(
        '<body name="base" pos="0 0 1"><geom size=".05"/><body name="a"><joint name="a"'
        ' axis="0 1 0"'
        ' range=".5 1"/><geom type="capsule" size=".02" fromto="0 0 0 .3 0 0"/></body></body>',
        floor=None,
    ),
}


@pytest.mark.parametrize("name", ROBOTS)
def test_every_field_and_200_steps_are_those_of_the_file(tmp_path, name):
    path = tmp_path / "robot.xml"
    path.write_text(ROBOTS[name])
    twin = Twin(path, in_scene(path))
    assert list(twin.differences()) == []
    assert twin.drift() < 1e-9
    _, ours = twin.start()
    for _ in range(200):
        mujoco.mj_step(twin.model, ours)
    assert np.isfinite(ours.qpos).all()


def test_a_fixed_base_carries_what_is_anchored_in_the_files_world(tmp_path):
    path = tmp_path / "robot.xml"
    path.write_text(ROBOTS["welds, connects and joints equal to others, in the world too"])
    here = RobotCfg(disable_self_collision=False)
    there = RobotCfg(disable_self_collision=False, init_pos=(3, -2, 1))
    twins = [Twin(path, in_scene(path, cfg)) for cfg in (here, there)]
    moved = []
    for twin in twins:
        _, data = twin.start()
        for _ in range(200):
            mujoco.mj_step(twin.model, data)
        moved.append(data.qpos.copy())
    np.testing.assert_allclose(moved[0], moved[1], atol=1e-8)
    assert np.abs(moved[0]).max() > 1e-3
    # The base moves afterwards: what is anchored follows.
    model, data = twins[0].model, twins[0].start()[1]
    data.mocap_pos[0] += [3, -2, 1]
    for _ in range(200):
        mujoco.mj_step(model, data)
    np.testing.assert_allclose(moved[0], data.qpos, atol=1e-8)


def test_the_ground_takes_the_contact_parameters_of_a_files_floor(tmp_path, caplog):
    floor = 'friction=".3 .02 .003" condim="4" solref=".03 .9" solimp=".8 .9 .002" margin=".01"'
    floor += ' gap=".002" contype="3" conaffinity="5" priority="1" solmix="2"'
    text = robot(LEG.format(root="<freejoint/>", height=0.62), floor=floor)
    other = robot(LEG.format(root="<freejoint/>", height=0.62), floor='friction=".4"')
    scene = scene_of(
        {
            "a": RobotCfg(fpath=write(tmp_path / "a.xml", text), fix_base=False),
            "b": RobotCfg(
                fpath=write(tmp_path / "b.xml", other), fix_base=False, init_pos=(2, 0, 0.6)
            ),
        }
    )
    ground, alone = scene.model.geom("default_plane"), mujoco.MjModel.from_xml_string(text)
    for field in ("friction", "condim", "solref", "solimp", "margin", "gap", "contype"):
        assert getattr(ground, field).tolist() == getattr(alone.geom("floor"), field).tolist()
    assert ground.conaffinity[0] == 5 and ground.priority[0] == 1 and ground.solmix[0] == 2
    assert "a: its floor 'floor' is the scene's ground; the ground takes its" in caplog.text
    assert "b: its floor 'floor' is the scene's ground; the ground does not have its" in caplog.text


def test_without_a_ground_the_files_floor_stays(tmp_path, caplog):
    text = robot(LEG.format(root="<freejoint/>", height=0.62))
    cfg = RobotCfg(fpath=write(tmp_path / "a.xml", text), fix_base=False)
    sim = SimulationManagerCfg(headless=True, ground_plane=False)
    model = scene_of({"a": cfg}, sim=sim).model
    assert model.geom("a/floor").bodyid[0] == 0
    assert "its floor 'floor' stays: the scene has no ground" in caplog.text


def test_what_cannot_touch_the_ground_is_named(tmp_path, caplog):
    text = ROBOTS["collision groups"].replace('conaffinity="8"', 'conaffinity="16"')
    scene_of({"a": RobotCfg(fpath=write(tmp_path / "a.xml", text), disable_self_collision=False)})
    assert "a: no shape of it can touch the ground, whose bits are contype 0" in caplog.text


def _bumpy(points: int) -> tuple[np.ndarray, ConvexHull]:
    """The corners of an ellipsoid, on a Fibonacci spiral, and their hull."""
    k = np.arange(points) + 0.5
    polar, turn = np.arccos(1 - 2 * k / points), np.pi * (1 + 5**0.5) * k
    xyz = np.stack(
        [np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)], axis=1
    )
    xyz *= [0.1, 0.07, 0.05]
    return xyz, ConvexHull(xyz)


def _triangles(points: int) -> list[np.ndarray]:
    """(3, 3) corners of each triangle of the hull, counterclockwise from outside."""
    xyz, hull = _bumpy(points)
    found = []
    for face in hull.simplices:
        corners = xyz[face]
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        found.append(corners if normal @ corners[0] > 0 else corners[::-1])
    return found


def _binary_stl(points: int) -> bytes:
    triangles = _triangles(points)
    data = b"\0" * 80 + struct.pack("<I", len(triangles))
    for corners in triangles:
        data += struct.pack("<12fH", 0, 0, 0, *corners.reshape(-1), 0)
    return data


def _ascii_stl(points: int) -> str:
    """MuJoCo does not read this: it is converted, and weighs as its hull."""
    lines = ["solid ball"]
    for corners in _triangles(points):
        lines += ["facet normal 0 0 0", "outer loop"]
        lines += [f"vertex {x:.9g} {y:.9g} {z:.9g}" for x, y, z in corners]
        lines += ["endloop", "endfacet"]
    return "\n".join([*lines, "endsolid ball"])


def test_a_limit_on_hull_vertices_changes_no_mass_of_an_object(tmp_path):
    path = tmp_path / "ball.stl"
    path.write_text(_ascii_stl(400))
    _, hull = _bumpy(400)
    ball = RigidObjectCfg(
        shape=MeshCfg(fpath=str(path)), attrs=RigidBodyAttributesCfg(mass=0.0, density=500.0)
    )
    carried = AttachmentCfg(link="a", shape=MeshCfg(fpath=str(path)), mass=2.0)
    arm = robot('<body name="a"><joint name="j"/><geom size=".1"/></body>')
    cfg = RobotCfg(fpath=write(tmp_path / "arm.xml", arm), attachments={"load": carried})
    model = scene_of({"arm": cfg}, {"ball": ball}).model
    assert model.mesh("ball/mesh").vertnum[0] >= 400
    assert model.body("ball").mass[0] == pytest.approx(500.0 * hull.volume, rel=1e-6)
    assert model.body("arm/load").mass[0] == pytest.approx(2.0, rel=1e-12)
    # Both are the same body, of another mass.
    moments = model.body("ball").inertia / model.body("ball").mass[0]
    np.testing.assert_allclose(model.body("arm/load").inertia / 2.0, moments, rtol=1e-9)


@pytest.mark.parametrize("inertia", ["convex", "exact", "legacy", "shell"])
def test_a_limit_on_hull_vertices_changes_no_mass(tmp_path, inertia):
    (tmp_path / "ball.stl").write_bytes(_binary_stl(400))
    path = tmp_path / "robot.xml"
    path.write_text(
        robot(
            '<body name="a" pos="0 0 1"><joint name="j" axis="0 1 0"/><geom type="mesh" mesh="ball"'
            ' pos=".1 .2 .3" euler=".3 .2 .1"/></body>',
            head=f'<asset><mesh name="ball" file="ball.stl" inertia="{inertia}"/></asset>',
            floor=None,
        )
    )
    scene = in_scene(path)
    twin = Twin(path, scene)
    # A mesh has its frame in the middle of what weighs: of the hull, where that has the mass.
    moved = ("geom_", "mesh_") if inertia == "convex" else ()
    assert [line for line in twin.differences() if not line.startswith(moved)] == []
    parsed = parse_articulation("r", RobotCfg(fpath=str(path)))
    assert [(hull.mesh, hull.vertices) for hull in parsed.hulls] == [("ball", 400)]
    assert any("hulls of at most 64 vertices" in note for note in parsed.notes)


BALL_OF_A_FILE = robot(
    '<body name="a" pos="0 0 1"><joint name="j"/><geom type="mesh" mesh="ball" mass="1"/></body>',
    head='<asset><mesh name="ball" file="ball.stl"/></asset>',
    floor=None,
)


def test_limited_hulls_are_in_mujocos_cache(tmp_path):
    """Without them each compilation of a robot makes all of its hulls again."""
    (tmp_path / "ball.stl").write_bytes(_binary_stl(400))
    path = Path(write(tmp_path / "robot.xml", BALL_OF_A_FILE))
    cache = mujoco.mj_getCache()
    mujoco.mj_clearCache(cache)
    file = read_model(path)
    size_of_file = mujoco.mj_getCacheSize(cache)
    assert size_of_file > 0
    assert [mesh.file for mesh in file.spec.meshes] == [str(tmp_path / "ball.stl")]
    parse_articulation("r", RobotCfg(fpath=str(path)))
    size = mujoco.mj_getCacheSize(cache)
    assert size > size_of_file
    parse_articulation("r", RobotCfg(fpath=str(path)))
    assert mujoco.mj_getCacheSize(cache) == size


def test_a_broken_mesh_is_named_by_its_own_path(tmp_path):
    (tmp_path / "ball.stl").write_bytes(_binary_stl(400)[:200])
    path = write(tmp_path / "robot.xml", BALL_OF_A_FILE)
    with pytest.raises(ConfigError) as raised:
        parse_articulation("r", RobotCfg(fpath=path))
    text = str(raised.value)
    assert str(tmp_path / "ball.stl") in text
    assert "/proc/" not in text


def test_a_free_joint_that_fix_base_removes_takes_its_actuators_along_and_says_so(tmp_path):
    text = ROBOTS["damping, armature, friction and stiffness of a free joint, and a motor on it"]
    parsed = parse_articulation("r", RobotCfg(fpath=write(tmp_path / "r.xml", text)))
    assert parsed.model.nv == parsed.model.nactuator == 0
    assert any("left out with its free joint: actuator 'lift'" in note for note in parsed.notes)


def test_a_start_beyond_limits_is_the_files_and_is_said(tmp_path):
    name = write(tmp_path / "r.xml", ROBOTS["limits that the start is beyond"])
    parsed = parse_articulation("r", RobotCfg(fpath=name))
    assert parsed.init_qpos.tolist() == [0.0]
    assert any("outside their limits, as in the file: a 0 of [0.5, 1]" in n for n in parsed.notes)


def test_two_floating_bodies_are_named_and_no_others(tmp_path):
    text = robot(
        BALL.format(name="one", pos="0 0 1")
        + BALL.format(name="two", pos="0 0 2")
        + '<body name="post"><geom size=".1"/></body>'
    )
    with pytest.raises(ConfigError, match="2 bodies of the file float: 'one', 'two'; make"):
        parse_articulation("r", RobotCfg(fpath=write(tmp_path / "r.xml", text), fix_base=False))


def test_shapes_of_the_world_do_not_float_along(tmp_path):
    text = ROBOTS["bodies fixed to the world, and shapes and sites of the world"]
    cfg = RobotCfg(fpath=write(tmp_path / "r.xml", text), fix_base=False)
    with pytest.raises(ConfigError, match="shapes of the file's world would float along: 'step'"):
        parse_articulation("r", cfg)


@pytest.mark.parametrize(
    ("pos", "rot", "expected"),
    [
        (None, None, [0.1, 0.2, 0.7, 0.8, 0.6, 0, 0]),
        ((1, 2, 3), None, [1, 2, 3, 0.8, 0.6, 0, 0]),
        (None, (0, 0, 180), [0.1, 0.2, 0.7, 0, 0, 0, 1]),
        ((1, 2, 3), (0, 0, 0), [1, 2, 3, 1, 0, 0, 0]),
    ],
)
def test_a_floating_robot_is_placed_absolutely(tmp_path, pos, rot, expected):
    name = write(tmp_path / "r.xml", ROBOTS["a keyframe called home, and room for more"])
    cfg = RobotCfg(fpath=name, fix_base=False, init_pos=pos, init_rot=rot)
    index = scene_of({"r": cfg}).entities["r"]
    np.testing.assert_allclose([*index.pos0, *index.quat0], expected, atol=1e-12)


@pytest.mark.parametrize(
    "text",
    [
        "<!-- one link -- and a motor -->{}",
        '\n\n<?xml version="1.0"?>\n{}',
        "{}</mujoco>",
        '<?xml version="1.0" encoding="gb2312"?>{}',
        "{}<!-- R&D -->",
    ],
)
def test_text_that_mujoco_reads_is_read(tmp_path, text):
    path = tmp_path / "r.xml"
    path.write_text(text.format(robot(LEG.format(root="", height=1))))
    assert mujoco.MjModel.from_xml_path(str(path)).njnt == 2
    assert parse_articulation("r", RobotCfg(fpath=str(path))).joint_names == ("hip", "knee")


URDF = """<robot name="arm"><link name="base"/><link name="arm"><inertial><mass value="1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="j" type="continuous"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
</joint>
</robot>"""


@pytest.mark.parametrize(
    "text",
    [
        "<!-- one link -- and a motor -->{}",
        '\n\n<?xml version="1.0"?>\n{}',
        "{}</robot>",
        "{}\n<!-- unfinished",
        "<!-- caf\u00e9 & bar -->{}",
        "\ufeff{}",
        '<?xml version="1.0" encoding="gb2312"?>{}',
    ],
)
def test_urdf_text_that_ros_and_mujoco_read_is_read(tmp_path, text):
    path = tmp_path / "r.urdf"
    path.write_text(text.format(URDF.replace('name="arm">', 'name="a &amp; b">', 1)), "utf-8")
    assert parse_articulation("r", RobotCfg(fpath=str(path))).joint_names == ("j",)


def test_text_that_is_no_xml_is_an_error_with_its_line(tmp_path):
    path = tmp_path / "r.urdf"
    path.write_text(f"<!-- a -- b\n -->\n{URDF.replace('</joint>', '</link>')}")
    with pytest.raises(ConfigError, match=r"r\.urdf:6: not well-formed XML: mismatched tag"):
        parse_articulation("r", RobotCfg(fpath=str(path)))
