import subprocess
import sys

import pytest

from embodichain.lab.gym.envs.cfg import (
    ActionTermCfg,
    EnvCfg,
    EventCfg,
    ObservationCfg,
    PhysicsTaskCfg,
    RewardCfg,
    SceneEntityCfg,
)
from embodichain.lab.gym.envs.scene_setup.declared_scene import describe
from embodichain.lab.sim.cfg import (
    ArticulationCfg,
    JointDrivePropertiesCfg,
    LightCfg,
    RigidObjectCfg,
    RobotCfg,
    SolverCfg,
)
from embodichain.lab.sim.configs.config_types import config_types
from embodichain.lab.sim.shapes import CubeCfg, MeshCfg, PlaneCfg, SphereCfg
from tests.lab.sim.compiler.helpers import HOME, UR10

JOINTS = "Joint1, Joint2, Joint3, Joint4, Joint5, Joint6"
LINKS = (
    "base_link, shoulder_link, upper_arm_link, forearm_link, wrist_1_link, wrist_2_link, "
    "wrist_3_link, ee_link"
)


def reach(**changes):
    """A task like `reach`: an arm, a goal, a light, and terms that point at them."""
    cfg = EnvCfg(
        robot=RobotCfg(
            uid="ur10",
            fpath=UR10,
            init_pos=(0, 0, 1),
            init_qpos=HOME,
            control_parts={"arm": ["Joint[1-6]"]},
            drive_pros=JointDrivePropertiesCfg(stiffness=500, damping=50, max_effort="file"),
        ),
        objects={"goal": RigidObjectCfg(shape=SphereCfg(radius=0.02), body_type="kinematic")},
        lights={"sun": LightCfg(light_type="sun")},
        physics=PhysicsTaskCfg(physics_dt=0.005, gravity=[0, 0, -3.7]),
        actions={"arm": ActionTermCfg(func="f", params={"entity_cfg": {"uid": "ur10"}})},
        rewards={
            "near": RewardCfg(
                func="f",
                params={
                    "source_entity_cfg": {"uid": "ur10", "link_names": ["ee_link"]},
                    "target_entity_cfg": SceneEntityCfg(uid="goal"),
                    "threshold": 0.05,
                },
            )
        },
    )
    return cfg.replace(**changes)


def lines(cfg):
    return [str(problem) for problem in describe(cfg).all_problems()]


def test_a_good_task_has_no_problems():
    assert lines(reach()) == []
    assert lines(EnvCfg()) == []


def pointing(**fields):
    """A task with one event that points at something."""
    event = EventCfg(func="f", params={"entity_cfg": fields})
    return reach(events={"place_goal": event})


ENTITY = "events.place_goal.params.entity_cfg"


@pytest.mark.parametrize(
    ("cfg", "expected"),
    [
        (
            pointing(uid="gaol"),
            f"{ENTITY}.uid: no entity is called 'gaol'; there are: ur10, goal Did you mean 'goal'?",
        ),
        (pointing(link_names="x"), f"{ENTITY}.uid: name an entity; there are: ur10, goal"),
        (
            pointing(uid="ur10", joint_names=["Joint1", "joint2"]),
            f"{ENTITY}.joint_names: no joint of 'ur10' matches 'joint2'; there are: {JOINTS} "
            "Did you mean 'Joint2'?",
        ),
        (
            pointing(uid="ur10", link_names="ee_lnk"),
            f"{ENTITY}.link_names: no link of 'ur10' matches 'ee_lnk'; there are: {LINKS} "
            "Did you mean 'ee_link'?",
        ),
        (
            pointing(uid="ur10", body_names="wrist"),
            f"{ENTITY}.body_names: no link of 'ur10' matches 'wrist'; there are: {LINKS}",
        ),
        (
            pointing(uid="ur10", control_parts="hand"),
            f"{ENTITY}.control_parts: no control part of 'ur10' matches 'hand'; there are: arm",
        ),
        (
            pointing(uid="ur10", joint_ids=[0, 6]),
            f"{ENTITY}.joint_ids: 'ur10' has 6 joints, numbered from 0; got [6]",
        ),
        (
            pointing(uid="ur10", joint_names="Joint(1"),
            f"{ENTITY}.joint_names: malformed regex 'Joint(1': missing ), unterminated subpattern "
            "at position 5",
        ),
        (
            pointing(uid="goal", body_ids=[1]),
            f"{ENTITY}.body_ids: 'goal' has 1 links, numbered from 0; got [1]",
        ),
        (
            pointing(uid="goal", joint_names="Joint1"),
            f"{ENTITY}.joint_names: 'goal' is a rigid object without joints",
        ),
        (
            pointing(uid="goal", link_names="top"),
            f"{ENTITY}.link_names: no link of 'goal' matches 'top'; there are: goal",
        ),
        (
            pointing(uid="sun"),
            f"{ENTITY}.uid: 'sun' is a light: terms act on robots and objects",
        ),
        (
            reach(
                observations={
                    "x": ObservationCfg(params={"frames": [{"uid": "goal"}, {"uid": "ur11"}]})
                }
            ),
            "observations.x.params.frames.1.uid: no entity is called 'ur11'; there are: ur10, goal "
            "Did you mean 'ur10'?",
        ),
        (
            reach(events={"e": EventCfg(params={"relative_to": SceneEntityCfg(uid="goal_")})}),
            "events.e.params.relative_to.uid: no entity is called 'goal_'; there are: ur10, goal "
            "Did you mean 'goal'?",
        ),
    ],
)
def test_a_reference_to_nothing_is_named_with_what_there_is(cfg, expected):
    assert lines(cfg) == [expected]


def test_a_map_that_only_has_a_uid_among_others_is_no_reference():
    params = {"material": {"uid": "red", "base_color": [1, 0, 0, 1]}}
    assert lines(reach(events={"e": EventCfg(params=params)})) == []


def test_entities_may_come_from_a_registered_class():
    assert lines(pointing(uid="made_in_python").replace(id="Mine-v0")) == []


def test_nothing_is_said_of_the_joints_of_a_robot_whose_file_is_missing():
    cfg = pointing(uid="ur10", joint_names="Joint9")
    cfg.robot.fpath = "UniversalRobots/UR10/UR11.urdf"
    problems = describe(cfg).problems
    assert [p.path for p in problems] == ["robot.fpath"]
    assert "Searched, in this order" in problems[0].message
    assert "Did you mean 'UniversalRobots/UR10/UR10.urdf'" in problems[0].message


@pytest.mark.parametrize(
    ("cfg", "expected"),
    [
        (
            reach(robots={"ur10": RobotCfg(fpath=UR10)}),
            "robots.ur10: uid 'ur10' is taken by robot; every entity needs its own",
        ),
        (
            reach(articulations={"goal": ArticulationCfg(fpath=UR10)}),
            "objects.goal: uid 'goal' is taken by articulations.goal; every entity needs its own",
        ),
        (
            reach(lights={"default_plane": LightCfg()}),
            "lights.default_plane: uid 'default_plane' is taken by the ground plane; every entity "
            "needs its own",
        ),
        (
            reach(robots={"a/b": RobotCfg(fpath=UR10)}),
            "robots.a/b: uid 'a/b' must not contain '/', which separates it from its parts",
        ),
        (
            reach(robots={"left": RobotCfg(fpath=UR10, uid="right")}),
            "robots.left.uid: the key 'left' is its uid; it cannot be 'right': leave uid out",
        ),
    ],
)
def test_a_name_that_cannot_be_used_is_named(cfg, expected):
    assert lines(cfg) == [expected]


@pytest.mark.parametrize(
    ("entity", "expected"),
    [
        (
            {"solver_cfg": {"default": SolverCfg(end_link_name="ee_lnk")}},
            f"robot.solver_cfg.default.end_link_name: no link is called 'ee_lnk'; there are: "
            f"{LINKS} Did you mean 'ee_link'?",
        ),
        (
            {"body_scale": (2, 2, 2)},
            "robot.body_scale: articulations cannot be scaled yet, got [2.0, 2.0, 2.0]",
        ),
        (
            {"control_parts": {"arm": ["joint.*"]}},
            f"robot.control_parts.arm: no joint matches 'joint.*'; there are: {JOINTS} "
            "Did you mean 'Joint1'?",
        ),
        (
            {"init_qpos": [0.0] * 7},
            f"robot.init_qpos: must be 6 values, one for each joint ({JOINTS}), got 7",
        ),
        (
            {"drive_pros": JointDrivePropertiesCfg(stiffness={"elbow": 1.0})},
            f"robot.drive_pros.stiffness.elbow: no joint matches 'elbow'; there are: {JOINTS}; "
            "control parts: arm",
        ),
        ({"fpath": None}, "robot.fpath: no file: set fpath to a .urdf or .xml file"),
    ],
)
def test_a_robot_that_cannot_be_built_is_named(entity, expected):
    cfg = reach()
    cfg.robot = cfg.robot.replace(**entity)
    assert lines(cfg) == [expected]


def test_objects_and_lights_are_checked_too():
    cfg = reach(
        objects={
            "goal": RigidObjectCfg(shape=CubeCfg(size=[1, 1, -1])),
            "floor": RigidObjectCfg(shape=PlaneCfg(), body_type="kinematic"),
            "mesh": RigidObjectCfg(shape=MeshCfg(fpath="nowhere.obj")),
        },
        lights={"sun": LightCfg(direction=(0, 0, 0), color=(2, 0, 0))},
    )
    of_types = {p.path for p in config_types(EnvCfg).check_instance(cfg)}
    assert of_types == {"objects.goal.shape.size", "lights.sun.color", "lights.sun.direction"}
    assert [p.path for p in describe(cfg).problems] == [
        "objects.floor.body_type",
        "objects.mesh.shape.fpath",
    ]


def test_what_mujoco_refuses_in_the_end_is_a_problem_too():
    tiny = RigidObjectCfg(shape=SphereCfg(radius=1e-6))  # lighter than mjMINVAL
    (problem,) = describe(reach(objects={"goal": tiny})).all_problems()
    assert problem.message.startswith("MuJoCo cannot compile the scene: ")


@pytest.mark.unmeasured
def test_checking_a_scene_imports_no_torch():
    code = (
        "import sys\n"
        "from embodichain.lab.gym.envs.cfg import EnvCfg\n"
        "from embodichain.lab.sim.cfg import RobotCfg\n"
        "from embodichain.lab.gym.envs.scene_setup.declared_scene import describe\n"
        f"cfg = EnvCfg(robot=RobotCfg(fpath={UR10!r}))\n"
        "assert describe(cfg).compile().model.nu == 6\n"
        "assert 'torch' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_checking_changes_nothing_of_the_config():
    cfg = reach()
    before = cfg.to_dict()
    describe(cfg).compile()
    assert cfg.to_dict() == before
