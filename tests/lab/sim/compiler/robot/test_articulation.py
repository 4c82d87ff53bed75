import math
import struct

import mujoco
import numpy as np
import pytest

from embodichain.lab.sim.cfg import (
    ArticulationCfg,
    JointDrivePropertiesCfg,
    RigidBodyAttributesCfg,
    RobotCfg,
    SimulationManagerCfg,
)
from embodichain.lab.sim.compiler.compile_scene import compile_scene
from embodichain.lab.sim.compiler.robot.articulation import parse_articulation
from embodichain.lab.sim.compiler.scene_parts import SceneParts
from embodichain.utils.errors import ConfigError
from tests.lab.sim.compiler.helpers import (
    GRIPPER_URDF,
    HOME,
    HOPPER_MJCF,
    INERTIAL,
    UR10,
    scene_of,
    start,
    touching,
    write,
)


def test_the_ur10_has_its_names_limits_and_start():
    parsed = parse_articulation("ur10", RobotCfg(fpath=UR10, init_qpos=HOME))
    assert parsed.joint_names == tuple(f"Joint{i}" for i in range(1, 7))
    assert parsed.root_link_name == parsed.link_names[0] == "base_link"
    assert parsed.link_names[-1] == "ee_link"  # a fixed tool frame keeps its body
    np.testing.assert_allclose(parsed.qpos_limits[0], [-2 * math.pi, 2 * math.pi])
    np.testing.assert_allclose(parsed.qpos_limits[2], [-math.pi, math.pi])
    np.testing.assert_allclose(parsed.qvel_limits, np.radians([120, 120, 180, 180, 180, 180]))
    assert parsed.init_qpos.tolist() == HOME
    assert parsed.fixed_base


def test_everything_of_an_entity_is_named_after_it():
    scene = scene_of({"ur10": RobotCfg(fpath=UR10)})
    model, index = scene.model, scene.entities["ur10"]
    assert model.joint("ur10/Joint1").qposadr[0] == index.qpos_adr[0]
    assert model.actuator("ur10/Joint6").id == index.actuator_ids[5]
    assert model.body("ur10/base_link").id == index.root_body_id
    assert all(model.geom(int(g)).name.startswith("ur10/") for g in index.geom_ids)


def test_the_same_file_can_be_added_twice_and_parsed_robots_compiled_again():
    robots = [
        parse_articulation("left", RobotCfg(fpath=UR10, init_pos=(0, 1, 0))),
        parse_articulation("right", RobotCfg(fpath=UR10, init_pos=(0, -1, 0))),
    ]
    scene = compile_scene(SceneParts(SimulationManagerCfg(), robots))
    again = compile_scene(SceneParts(SimulationManagerCfg(), robots))
    assert scene.model.nq == again.model.nq == 12
    assert scene.entities["right"].qpos_adr.tolist() == [6, 7, 8, 9, 10, 11]
    assert scene.entities["right"].actuator_ids.tolist() == [6, 7, 8, 9, 10, 11]


def test_a_files_keyframe_is_the_start_and_its_sensors_survive(tmp_path):
    name = write(tmp_path / "hopper.xml", HOPPER_MJCF)
    own = RobotCfg(fpath=name, fix_base=False)
    parsed = parse_articulation("h", own)
    assert parsed.init_qpos.tolist() == [0.5]  # of the keyframe called home
    assert parsed.init_ctrl.tolist() == [0.0, 0.5]
    model = scene_of({"h": own}).model
    index = scene_of({"h": own}).entities["h"]
    assert index.actuator_ids.tolist() == [1]
    assert [model.actuator(int(a)).name for a in index.own_actuator_ids] == ["h/spare", "h/servo"]
    names = [model.sensor(i).name for i in range(model.nsensor)]
    assert names == ["h/angle", "h/effort", "h/gyro"]
    np.testing.assert_allclose(parsed.qpos_limits, np.radians([[-90, 90]]))


def test_drives_replace_the_files_actuators_and_what_reads_them(tmp_path):
    name = write(tmp_path / "hopper.xml", HOPPER_MJCF)
    cfg = RobotCfg(fpath=name, drive_pros=JointDrivePropertiesCfg(stiffness=9.0))
    parsed = parse_articulation("h", cfg)
    model = scene_of({"h": cfg}).model
    assert [model.actuator(i).name for i in range(model.nu)] == ["h/hip"]
    assert parsed.qf_limits.tolist() == [6.0]  # the motor's ctrlrange times its gear
    assert model.actuator_forcerange.tolist() == [[-6.0, 6.0]]
    assert [model.sensor(i).name for i in range(model.nsensor)] == ["h/angle", "h/gyro"]


def test_nested_defaults_of_a_file_survive(tmp_path):
    name = write(tmp_path / "hopper.xml", HOPPER_MJCF)
    cfg = ArticulationCfg(fpath=name)
    model = scene_of({"h": cfg}).model
    assert model.dof_damping.tolist() == [3.0]
    assert model.dof_armature.tolist() == [0.02]
    foot = model.body("h/leg").geomadr[0]
    assert model.geom_rgba[foot].tolist() == [1, 0, 0, 1]
    assert model.geom_friction[foot, 0] == 0.9


def test_a_files_lights_and_ground_are_left_out_and_its_other_shapes_stay(tmp_path, caplog):
    name = write(tmp_path / "hopper.xml", HOPPER_MJCF)
    model = scene_of({"h": RobotCfg(fpath=name)}).model
    geoms = [model.geom(i).name for i in range(model.ngeom)]
    assert "h/post" in geoms and "h/floor" not in geoms
    assert [model.light(i).name for i in range(model.nlight)] == ["default"]
    assert "its floor 'floor' is the scene's ground" in caplog.text
    assert "lights left out: 'lamp'" in caplog.text


def test_options_of_a_file_that_the_scene_replaces_are_reported_once(tmp_path, caplog):
    name = write(tmp_path / "hopper.xml", HOPPER_MJCF)
    scene = scene_of({"h": RobotCfg(fpath=name)})
    option = scene.model.opt
    assert (option.timestep, option.impratio) == (0.01, 1.0)
    assert option.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    assert not option.disableflags & mujoco.mjtDisableBit.mjDSBL_CONTACT
    assert not option.enableflags
    lines = [r.getMessage() for r in caplog.records if "replaces its options" in r.getMessage()]
    assert len(lines) == 1
    for part in (
        "timestep 0.003 -> 0.01",
        "integrator rk4 -> implicitfast",
        "impratio 10 -> 1",
        "disableflags contact -> off",
        "enableflags energy -> off",
    ):
        assert part in lines[0]


def test_a_file_without_options_is_not_reported(caplog):
    scene_of({"ur10": RobotCfg(fpath=UR10)})
    assert caplog.text == ""


def test_auto_reset_is_off():
    flags = scene_of({"ur10": RobotCfg(fpath=UR10)}).model.opt.disableflags
    assert flags & mujoco.mjtDisableBit.mjDSBL_AUTORESET


# -- collision -----------------------------------------------------------------------------------

FOLDED = """<mujoco><worldbody><body name="a"><geom size="0.1"/>
<body name="b" pos="0.15 0 0"><joint name="j1" axis="0 1 0"/><geom size="0.1"/>
<body name="c" pos="-0.05 0 0"><joint name="j2" axis="0 1 0"/><geom size="0.1"/></body></body>
</body></worldbody></mujoco>"""


@pytest.mark.parametrize("disabled", [True, False])
def test_links_of_one_articulation_collide_unless_switched_off(tmp_path, disabled):
    name = write(tmp_path / "folded.xml", FOLDED)
    cfg = RobotCfg(fpath=name, init_pos=(0, 0, 1), disable_self_collision=disabled)
    scene = scene_of({"r": cfg})
    pairs = touching(scene, start(scene, {}))
    # MuJoCo lets the children of a fixed body collide with it.
    as_in_the_file = {frozenset({"r/a", "r/b"}), frozenset({"r/a", "r/c"})}
    assert pairs == (set() if disabled else as_in_the_file)


def test_different_articulations_collide_with_each_other_and_with_the_ground(tmp_path):
    name = write(tmp_path / "folded.xml", FOLDED)
    scene = scene_of(
        {
            "r": RobotCfg(fpath=name, init_pos=(0, 0, 0.05), disable_self_collision=True),
            "s": RobotCfg(fpath=name, init_pos=(0, 0, 0.15), disable_self_collision=True),
        }
    )
    pairs = touching(scene, start(scene, {}))
    assert frozenset({"r/b", "s/b"}) in pairs
    assert frozenset({"world", "r/b"}) in pairs
    assert not any({name[0] for name in pair} == {"r"} for pair in pairs)


def test_visual_shapes_are_drawn_and_never_collide(tmp_path):
    scene = scene_of({"g": RobotCfg(fpath=write(tmp_path / "g.urdf", GRIPPER_URDF))})
    model = scene.model
    base = [g for g in range(model.ngeom) if model.geom_bodyid[g] == model.body("g/base").id]
    assert [int(model.geom_group[g]) for g in base] == [2, 3]
    visual, collision = base
    assert model.geom_contype[visual] == model.geom_conaffinity[visual] == 0
    assert model.geom_contype[collision] != 0
    left = model.body("g/left").geomadr[0]  # no visual shape: its collision shape is drawn
    assert model.geom_group[left] < 3


def test_collision_can_be_switched_off_and_friction_set(tmp_path):
    attrs = RigidBodyAttributesCfg(enable_collision=False, dynamic_friction=0.3)
    model = scene_of({"ur10": RobotCfg(fpath=UR10, attrs=attrs)}).model
    mine = model.geom_bodyid > 0
    assert not model.geom_contype[mine].any() and not model.geom_conaffinity[mine].any()
    assert (model.geom_friction[mine, 0] == 0.3).all()
    assert set(model.geom_group[mine]) == {2, 3}


# -- meshes --------------------------------------------------------------------------------------


def tetrahedron(path, size):
    path.parent.mkdir(parents=True, exist_ok=True)
    corners = size * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    with path.open("wb") as file:
        file.write(bytes(80) + struct.pack("<I", 4))
        for face in ([0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]):
            file.write(struct.pack("<12fH", 0, 0, 0, *corners[face].ravel(), 0))
    return path


def meshed(visual, collision):
    return (
        f'<robot name="m"><link name="base">{INERTIAL}'
        f'<visual><geometry><mesh filename="{visual}"/></geometry></visual>\n'
        f'<collision><geometry><mesh filename="{collision}"/></geometry></collision>\n'
        "</link></robot>"
    )


@pytest.mark.parametrize(
    "prefix", ["package://my_robot/", "../", "{absolute}/", "file://{absolute}/"]
)
def test_meshes_are_found_by_package_relative_and_absolute_names(tmp_path, prefix):
    root = tmp_path / "my_robot"
    tetrahedron(root / "visual/part.stl", 0.2)
    tetrahedron(root / "collision/part.stl", 0.1)  # the same file name in another folder
    prefix = prefix.format(absolute=root)
    urdf = meshed(f"{prefix}visual/part.stl", f"{prefix}collision/part.stl")
    model = scene_of({"m": RobotCfg(fpath=write(root / "urdf/m.urdf", urdf))}).model
    assert model.nmesh == 2
    visual, collision = model.geom_rbound[model.geom_bodyid == 1]
    assert visual == pytest.approx(2 * collision, rel=1e-6)


def test_a_visual_mesh_that_cannot_be_read_is_left_out_with_one_warning(tmp_path, caplog):
    tetrahedron(tmp_path / "part.stl", 0.1)
    bad = write(tmp_path / "part.dae", "<COLLADA")
    name = write(tmp_path / "m.urdf", meshed("part.dae", "part.stl"))
    scene = scene_of({"m": RobotCfg(fpath=name)})
    assert scene.model.ngeom == 2  # the ground and the collision mesh
    assert scene.model.geom_group[1] < 3  # which is drawn
    (message,) = [r.getMessage() for r in caplog.records]
    assert message.startswith(
        f"m: {name}: visual mesh of link 'base' left out: {bad}: not readable as COLLADA:"
    )


def test_a_collision_mesh_that_cannot_be_read_is_an_error_that_names_the_format(tmp_path):
    bad = write(tmp_path / "part.step", "")
    name = write(tmp_path / "m.urdf", meshed("part.step", "part.step"))
    with pytest.raises(ConfigError) as raised:
        parse_articulation("m", RobotCfg(fpath=name))
    assert str(raised.value) == (
        f"m.fpath: {name}: collision mesh of link 'base': {bad}: format .step is not one of .dae, "
        ".glb, .gltf, .obj, .off, .ply, .stl"
    )


def test_a_missing_mesh_is_an_error_that_lists_where_it_was_looked_for(tmp_path):
    name = write(tmp_path / "m.urdf", meshed("nowhere.stl", "nowhere.stl"))
    with pytest.raises(ConfigError, match=r"(?s)mesh of link 'base'.*nowhere\.stl.*relative to"):
        parse_articulation("m", RobotCfg(fpath=name))


def test_a_broken_visual_mesh_is_left_out_too(tmp_path, caplog):
    tetrahedron(tmp_path / "part.stl", 0.1)
    write(tmp_path / "broken.stl", "not a mesh")
    name = write(tmp_path / "m.urdf", meshed("broken.stl", "part.stl"))
    assert scene_of({"m": RobotCfg(fpath=name)}).model.ngeom == 2
    assert "visual mesh of link 'base' left out" in caplog.text
    assert "broken.stl: it contains no triangles" in caplog.text


def test_links_held_by_fixed_joints_without_an_inertial_have_no_mass(tmp_path):
    urdf = f"""<robot name="r"><link name="base">{INERTIAL}</link>
    <link name="cover"><collision><geometry><box size="1 1 1"/></geometry></collision></link>
    <joint name="j" type="fixed"><parent link="base"/><child link="cover"/></joint></robot>"""
    model = scene_of({"r": RobotCfg(fpath=write(tmp_path / "r.urdf", urdf))}).model
    assert model.body("r/cover").mass[0] == 0.0


# -- mistakes ------------------------------------------------------------------------------------

BAD_FILES = {
    "cut.urdf": (
        '<robot name="x">\n<link name="a">\n</robot>',
        ":3: not well-formed XML: mismatched tag",
    ),
    "joint.urdf": (
        '<?xml version="1.0"?>\n<robot name="x"><link\n name="a"/>\n<!-- note -->\n'
        '<joint name="j" type="revolute"><parent link="a"/><child link="gone"/></joint></robot>',
        ":5: joint 'j' has the child 'gone', and no link is called so; there are: a",
    ),
    "typo.urdf": (
        '<robot name="x"><link name="tube_long_1"/><link name="b"/>\n'
        '<joint name="j" type="fixed">\n<parent link="Tube_lnog_1"/>'
        '<child link="b"/></joint></robot>',
        ":3: joint 'j' has the parent 'Tube_lnog_1', and no link is called so; "
        "there are: tube_long_1, b. Did you mean 'tube_long_1'?",
    ),
    "childless.urdf": (
        '<robot name="x"><link name="a"/>\n'
        '<joint name="j" type="fixed"><parent link="a"/></joint></robot>',
        ":2: joint 'j' has no <child link=\"...\">",
    ),
    "empty.urdf": ('<robot name="x"/>', ": the robot has no <link>"),
    "xacro.urdf": (
        '<robot name="x" xmlns:xacro="http://wiki.ros.org/xacro"><xacro:if value="1"/></robot>',
        ":1: <xacro:if>: xacro has to be expanded to URDF first: `xacro xacro.urdf > robot.urdf`",
    ),
    "page.xml": ("<html/>", ": neither URDF nor MJCF: its root is <html>, not <robot> or <mujoco>"),
    "type.xml": (
        '<mujoco>\n<worldbody>\n<body>\n<geom type="boxx"/></body></worldbody></mujoco>',
        ":4: invalid keyword: 'boxx' (element 'geom')",
    ),
    "world.xml": ("<mujoco><worldbody/></mujoco>", ": the file contains no bodies"),
}


@pytest.mark.parametrize("name", BAD_FILES)
def test_a_malformed_file_is_one_line_with_file_and_line(tmp_path, name):
    text, expected = BAD_FILES[name]
    path = write(tmp_path / name, text)
    with pytest.raises(ConfigError) as raised:
        parse_articulation("x", RobotCfg(fpath=path))
    assert str(raised.value).startswith(f"x.fpath: {path}{expected}")
    assert "\n" not in str(raised.value)


def test_a_missing_file_says_where_it_was_looked_for_and_what_is_close():
    with pytest.raises(ConfigError, match="Did you mean 'UniversalRobots/UR10/UR10.urdf'"):
        parse_articulation("x", RobotCfg(fpath="UniversalRobots/UR10/UR11.urdf"))


@pytest.mark.parametrize(
    ("init_qpos", "message"),
    [
        (
            [0.0] * 5,
            "a.init_qpos: must be 6 values, one for each joint (Joint1, Joint2, Joint3, Joint4, "
            "Joint5, Joint6), got 5",
        ),
        (
            {"Elbow": 1.0},
            "a.init_qpos.Elbow: no joint matches 'Elbow'; there are: Joint1, Joint2, Joint3, "
            "Joint4, Joint5, Joint6",
        ),
        (
            {"Joint3": 3.5},
            "a.init_qpos: joint 'Joint3' starts at 3.5, outside its limits [-3.14159, 3.14159]",
        ),
        ({"Joint1": "x"}, "a.init_qpos.Joint1: must be a number in rad or m, got 'x'"),
        (
            [float("nan")] + [0.0] * 5,
            "a.init_qpos: joint 'Joint1' starts at nan, outside its limits [-6.28319, 6.28319]",
        ),
    ],
)
def test_an_initial_position_that_does_not_fit_is_named(init_qpos, message):
    with pytest.raises(ConfigError) as raised:
        parse_articulation("a", RobotCfg(fpath=UR10, init_qpos=init_qpos))
    assert str(raised.value) == message


def test_initial_positions_by_regex_leave_the_others_at_zero():
    parsed = parse_articulation(
        "a", RobotCfg(fpath=UR10, init_qpos={"Joint[12]": 0.3, "Joint2": 0.4})
    )
    assert parsed.init_qpos.tolist() == [0.3, 0.4, 0, 0, 0, 0]


def test_every_mistake_is_reported_at_once():
    cfg = RobotCfg(
        fpath=UR10,
        init_qpos=[0.0],
        body_scale=(2, 1, 1),
        control_parts={"arm": ["joint.*"]},
        init_quat=(0, 0, 0, 0),
        drive_pros=JointDrivePropertiesCfg(stiffness={"Jiont1": 1.0}),
    )
    with pytest.raises(ConfigError) as raised:
        parse_articulation("a", cfg)
    paths = {p.path for p in raised.value.problems}
    assert paths == {
        "a.init_qpos",
        "a.body_scale",
        "a.control_parts.arm",
        "a.init_quat",
        "a.drive_pros.stiffness.Jiont1",
    }


def test_shapes_with_repeated_names_are_no_matter(tmp_path, capfd):
    urdf = GRIPPER_URDF.replace("<visual>", '<visual name="x">').replace(
        "<collision>", '<collision name="x">'
    )
    model = scene_of({"g": RobotCfg(fpath=write(tmp_path / "g.urdf", urdf))}).model
    assert model.ngeom == 5
    assert capfd.readouterr().err == ""


def test_assets_of_an_mjcf_file_are_found_and_stay_apart(tmp_path):
    xml = """<mujoco><compiler meshdir="assets"/><asset><mesh name="part" file="part.stl"/></asset>
    <worldbody><body><geom type="mesh" mesh="part"/></body></worldbody></mujoco>"""
    for uid, size in (("small", 0.1), ("large", 0.3)):
        write(tmp_path / uid / "robot.xml", xml)
        tetrahedron(tmp_path / uid / "assets/part.stl", size)
    robots = {uid: RobotCfg(fpath=str(tmp_path / uid / "robot.xml")) for uid in ("small", "large")}
    scene = scene_of(robots)
    small, large = (scene.model.geom_rbound[scene.entities[uid].geom_ids[0]] for uid in robots)
    assert large == pytest.approx(3 * small, rel=1e-6)
    files = {mesh.file for mesh in scene.spec.meshes}
    assert len(files) == 2
