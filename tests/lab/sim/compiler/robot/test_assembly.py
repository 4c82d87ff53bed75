"""Robots of several URDF files: names, places, masses and mimics of an arm with a gripper."""

import dataclasses
import math

import mujoco
import numpy as np
import pytest
import yaml

from embodichain.cli import main
from embodichain.compat.gym_config.env_cfg import config_to_cfg
from embodichain.lab.gym.envs import EmbodiedEnv, EnvCfg
from embodichain.lab.sim import SimulationManager, SimulationManagerCfg
from embodichain.lab.sim.cfg import JointDrivePropertiesCfg, RobotCfg, URDFCfg
from embodichain.lab.sim.compiler.robot.articulation import parse_articulation
from embodichain.lab.sim.compiler.robot.robot_assembly import attach
from embodichain.utils.errors import ConfigError
from embodichain.utils.fields.type_errors import from_dict

UR10 = "UniversalRobots/UR10/UR10.urdf"
ARM = ["base_link", "shoulder_link", "upper_arm_link", "forearm_link"]
ARM += ["wrist_1_link", "wrist_2_link", "wrist_3_link", "ee_link"]
HOME = [0.0, -1.57, 1.57, -1.57, -1.57, 0.0]
TURN = [[0, -1, 0, 0.01], [1, 0, 0, 0.02], [0, 0, 1, 0.1], [0, 0, 0, 1]]

_LINK = """<link name="{name}"><inertial><mass value="{mass}"/>
<inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><geometry><box size="0.02 0.02 0.04"/></geometry></collision></link>"""
_FINGER = """<joint name="{name}" type="prismatic"><origin xyz="{x} 0 0.05"/>
<parent link="base_link"/><child link="{child}"/><axis xyz="{axis} 0 0"/>
<limit lower="0" upper="0.04" effort="50" velocity="0.5"/>{mimic}</joint>"""
GRIPPER = "\n".join(
    [
        '<robot name="gripper">',
        _LINK.format(name="base_link", mass=0.5),
        _LINK.format(name="Left_Finger", mass=0.1),
        _LINK.format(name="right_finger", mass=0.2),
        _FINGER.format(name="finger1", x=0.03, child="Left_Finger", axis=1, mimic=""),
        _FINGER.format(
            name="Finger2",
            x=-0.03,
            child="right_finger",
            axis=-1,
            mimic='<mimic joint="finger1" multiplier="0.5" offset="0.01"/>',
        ),
        "</robot>",
    ]
)


@pytest.fixture
def gripper(tmp_path):
    path = tmp_path / "gripper.urdf"
    path.write_text(GRIPPER, encoding="utf-8")
    return str(path)


def components(gripper):
    return [
        {"component_type": "hand", "urdf_path": gripper, "transform": TURN},
        {"component_type": "arm", "urdf_path": UR10},
    ]


def robot(gripper, **fields):
    return RobotCfg(
        uid="ur",
        urdf_cfg=URDFCfg(components(gripper)),
        control_parts={"arm": ["JOINT[1-6]"], "hand": ["FINGER[12]"]},
        drive_pros=JointDrivePropertiesCfg(stiffness={"arm": 1e4, "hand": 2e3}),
        init_qpos=[*HOME, 0.02, 0.02],
        **fields,
    )


def matrices(handle, link):
    return handle.get_link_pose(link, to_matrix=True)[0].double().numpy()


def carrier(model, link):
    return model.body(int(model.body(link).parentid[0])).name


@pytest.fixture
def arm(gripper):
    sim = SimulationManager(SimulationManagerCfg(headless=True, physics_dt=0.002))
    yield sim.add_robot(robot(gripper))
    sim.destroy()


def test_names_are_those_of_the_assembly(arm):
    assert arm.joint_names == [f"JOINT{i}" for i in range(1, 7)] + ["FINGER1", "FINGER2"]
    hand = ["hand_base_link", "left_finger", "right_finger"]
    assert arm.link_names == ["base_link", "arm_base_link", *ARM[1:], *hand]
    assert arm.active_joint_names == arm.joint_names[:7]
    assert arm.control_parts == {"arm": arm.joint_names[:6], "hand": arm.joint_names[6:]}


def test_an_assembly_is_built_up_by_calls(arm, gripper):
    """EmbodiChain's tasks call `add_component` and `set_urdf`."""
    built = URDFCfg().add_component("arm", gripper).add_component("hand", gripper, TURN)
    built.add_component("arm", UR10)  # replaces the first
    assert [part.component_type for part in built.parts()] == ["hand", "arm"]
    parsed = parse_articulation("ur", RobotCfg(urdf_cfg=built))
    assert list(parsed.joint_names) == arm.joint_names
    assert list(parsed.link_names) == arm.link_names
    alone = parse_articulation("ur", RobotCfg(urdf_cfg=built.set_urdf(UR10)))
    assert list(alone.joint_names) == [f"Joint{i}" for i in range(1, 7)]


def test_masses_limits_and_drives_are_the_files_and_the_configs(arm):
    alone = parse_articulation("a", RobotCfg(fpath=UR10))
    assert arm.parsed.model.body_mass.sum() == pytest.approx(alone.model.body_mass.sum() + 0.8)
    np.testing.assert_array_equal(arm.parsed.qpos_limits[:6], alone.qpos_limits)
    np.testing.assert_array_equal(arm.parsed.qpos_limits[6:], [[0, 0.04]] * 2)
    np.testing.assert_array_equal(arm.parsed.qvel_limits[6:], 0.5)
    np.testing.assert_array_equal(arm.parsed.stiffness, [1e4] * 6 + [2e3, 0])


def test_the_hand_sits_on_the_arms_last_link(arm):
    np.testing.assert_allclose(
        matrices(arm, "hand_base_link"), matrices(arm, "ee_link") @ np.array(TURN), atol=1e-6
    )
    alone = SimulationManager(SimulationManagerCfg(headless=True))
    plain = alone.add_robot(RobotCfg(uid="ur", fpath=UR10, init_qpos=HOME))
    np.testing.assert_allclose(matrices(arm, "ee_link"), matrices(plain, "ee_link"), atol=1e-6)
    alone.destroy()


def test_a_mimic_finger_follows(arm):
    arm.set_qpos([[0.03]], joint_ids=[6])
    arm.engine.step(600)
    leader, follower = arm.get_qpos()[0, 6:].tolist()
    assert leader == pytest.approx(0.03, abs=1e-3)
    assert follower == pytest.approx(0.5 * leader + 0.01, abs=1e-3)


def test_two_arms_and_a_torso(gripper, tmp_path):
    torso = tmp_path / "torso.urdf"
    torso.write_text(
        f'<robot name="t">{_LINK.format(name="Base", mass=5)}{_LINK.format(name="Top", mass=3)}'
        '<joint name="lift" type="prismatic"><origin xyz="0 0 1"/><parent link="Base"/>'
        '<child link="Top"/><axis xyz="0 0 1"/><limit lower="0" upper="1" effort="9" velocity="1"/>'
        "</joint></robot>",
        encoding="utf-8",
    )
    side = [[1, 0, 0, 0], [0, 1, 0, 0.3], [0, 0, 1, 0], [0, 0, 0, 1]]
    cfg = URDFCfg(
        [
            {"component_type": "left_arm", "urdf_path": UR10, "transform": side},
            {"component_type": "right_arm", "urdf_path": UR10},
            {"component_type": "left_hand", "urdf_path": gripper},
            {"component_type": "torso", "urdf_path": str(torso)},
        ]
    )
    parsed = parse_articulation("t", RobotCfg(urdf_cfg=cfg))
    left, right = ([f"{s}_JOINT{i}" for i in range(1, 7)] for s in ("LEFT", "RIGHT"))
    assert sorted(parsed.joint_names) == sorted(
        ["LIFT", *left, *right, "LEFT_FINGER1", "LEFT_FINGER2"]
    )
    model = parsed.model
    assert carrier(model, "left_base_link") == "top"
    np.testing.assert_array_equal(model.body("left_base_link").pos, [0, 0.3, 0])
    # The prefix would come twice: the finger's name begins with it already.
    assert carrier(model, "left_finger") == "left_base_link_1"
    assert carrier(model, "left_base_link_1") == "left_ee_link"


def test_names_can_be_kept_and_prefixed(gripper):
    cfg = URDFCfg(
        components(gripper),
        base_link_name="root",
        component_prefix={"hand": "g_"},
        name_case={"joint": "original", "link": "none"},
    )
    parsed = parse_articulation("a", RobotCfg(urdf_cfg=cfg))
    assert parsed.joint_names[-2:] == ("g_finger1", "g_Finger2")
    assert parsed.link_names == ("root", *ARM, "g_base_link", "g_Left_Finger", "g_right_finger")


def test_one_component_is_its_file(gripper):
    cfg = URDFCfg([{"component_type": "hand", "urdf_path": gripper}])
    parsed = parse_articulation("a", RobotCfg(urdf_cfg=cfg))
    assert parsed.joint_names == ("finger1", "Finger2") and parsed.root_link_name == "base_link"


def test_the_same_in_python_in_yaml_and_in_a_gym_config(gripper, tmp_path, monkeypatch, capsys):
    fields = {
        "uid": "ur",
        "urdf_cfg": {"components": components(gripper)},
        "control_parts": {"arm": ["JOINT[1-6]"], "hand": ["FINGER[12]"]},
        "drive_pros": {"stiffness": {"arm": 1e4, "hand": 2e3}},
        "init_qpos": [*HOME, 0.02, 0.02],
        "disable_self_collision": True,  # as a gym config has it without a word
    }
    actions = {"arm": {"func": "DeltaQposTerm", "params": {"scale": 0.1, "part_name": "hand"}}}
    own = dataclasses.replace(robot(gripper), disable_self_collision=True)
    python = EmbodiedEnv(EnvCfg(robot=own))
    mapped = EmbodiedEnv(from_dict(EnvCfg, {"robot": fields}))
    gym = EmbodiedEnv(config_to_cfg({"id": "EmbodiedEnv-v1", "robot": fields, "env": {}}))
    models = [env.sim.scene.model for env in (python, mapped, gym)]
    texts = [env.sim.scene.spec.to_xml() for env in (python, mapped, gym)]
    assert texts[0] == texts[1] == texts[2] and models[0].nbody == 13
    for env in (python, mapped, gym):
        env.close()
    monkeypatch.chdir(tmp_path)
    config = {"id": "EmbodiedEnv-v1", "robot": fields, "env": {"actions": actions}}
    (tmp_path / "gym.yaml").write_text(yaml.safe_dump(config), encoding="utf-8")
    assert main(["validate", "gym.yaml"]) == 0
    assert main(["run", "--gym-config", "gym.yaml", "max_steps=3", "--json"]) == 0
    assert main(["replay", "last", "--verify"]) == 0
    capsys.readouterr()


def test_a_preset_with_a_hand_keeps_its_names(gripper):
    urdf = {"components": [{"component_type": "hand", "urdf_path": gripper}]}
    cfg = config_to_cfg(
        {"robot": {"robot_type": "URRobot", "uid": "ur", "urdf_cfg": urdf}, "env": {}}
    )
    parsed = parse_articulation("ur", cfg.robot)
    assert parsed.joint_names == (*(f"Joint{i}" for i in range(1, 7)), "finger1", "Finger2")


def test_every_mistake_has_its_place(gripper, tmp_path):
    ours = tmp_path / "a.xml"
    ours.write_text("<mujoco><worldbody><body/></worldbody></mujoco>", encoding="utf-8")
    parts = [
        {"component_type": "amr", "urdf_path": UR10},
        {"component_type": "hand", "urdf_path": gripper, "transform": [[1, 0], [0, 1]]},
        {"component_type": "hand", "urdf_path": "nowhere/hand.urdf"},
        {"component_type": "torso", "urdf_path": str(ours)},
    ]
    with pytest.raises(ConfigError) as error:
        parse_articulation("ur", RobotCfg(urdf_cfg=URDFCfg(parts, sensors=[{}])))
    found = {p.path.removeprefix("ur.urdf_cfg."): p for p in error.value.problems}
    assert found["components.0.component_type"].hint == "Did you mean 'arm'?"
    assert "expected a 4x4 pose" in found["components.1.transform"].message
    assert "another component" in found["components.2.component_type"].message
    assert "nowhere/hand.urdf" in found["components.2.urdf_path"].message
    assert "is not a URDF" in found["components.3.urdf_path"].message
    assert set(found) >= {"sensors"} and len(found) == 6


def test_a_robot_without_uid_has_its_files_name(gripper):
    sim = SimulationManager(SimulationManagerCfg(headless=True))
    assert sim.add_robot(RobotCfg(urdf_cfg=URDFCfg(components(gripper)))).uid == "gripper_UR10"
    sim.destroy()


def test_attach_hangs_any_model_on_a_link():
    parent, child = mujoco.MjSpec(), mujoco.MjSpec()
    parent.compiler.degree = child.compiler.degree = False
    parent.worldbody.add_body(name="link", pos=[1, 0, 0])
    tool = child.worldbody.add_body(name="tool", pos=[0, 0, 0.5])
    tool.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.1, 0, 0])
    half = math.sqrt(0.5)
    attach(parent, child, "link", np.zeros(3), np.array([half, 0, half, 0]), "t/")
    model = parent.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    np.testing.assert_allclose(data.body("t/tool").xpos, [1.5, 0, 0], atol=1e-12)
    assert child.body("tool") is not None, "a copy is attached"
    with pytest.raises(ValueError, match="no link is called 'lnk'"):
        attach(parent, child, "lnk", np.zeros(3), np.array([1.0, 0, 0, 0]), "u/")
