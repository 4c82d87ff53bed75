"""What becomes of each section of EmbodiChain's own form; values, names, paths and reasons."""

import copy
import re
from pathlib import Path
from typing import Any

import pytest

from embodichain.compat.gym_config.conversion import Conversion, convert
from embodichain.compat.gym_config.file import is_gym_config, read_gym_config
from embodichain.utils.errors import ConfigError

CONFIGS = Path(__file__).parents[2] / "helpers" / "gym_configs"


def read(name: str) -> dict[str, Any]:
    return read_gym_config(CONFIGS / name)


def notes(conversion: Conversion) -> dict[str, str]:
    return {note.path: note.message for note in conversion.notes}


def only_problem(config: dict[str, Any]) -> str:
    (problem,) = convert(config).problems
    return str(problem)


def test_lists_become_maps_keyed_by_uid() -> None:
    task = convert(read("push.yaml")).task
    assert task["objects"]["table"]["body_type"] == "static"  # the default of a background
    assert task["objects"]["cube"] == {
        "shape": {
            "shape_type": "Cube",
            "size": [0.1, 0.1, 0.1],
            "visual_material": {"base_color": [1, 0, 0, 1]},
        },
        "init_pos": [0.8, 0.1, 0.15],
        "attrs": {
            "mass": 2.0,
            "dynamic_friction": 0.8,
            "linear_damping": 0.7,  # EmbodiChain's default; here it is 0
            "angular_damping": 0.7,
        },
    }
    assert "attrs" not in task["objects"]["table"]  # it does not move
    assert task["robot"] == {
        "uid": "arm",
        "fpath": "UniversalRobots/UR10/UR10.urdf",
        "init_rot": [0, 0, 90],
        "init_qpos": [0, -1.57, 1.57, -1.57, -1.57, 0],
        "control_parts": {"whole": ["Joint[1-6]"]},
        "drive_pros": {
            "drive_type": "force",
            "stiffness": 1e4,  # a number, though YAML 1.1 reads text
            "damping": {"Joint[1-3]": 1000.0, "Joint[4-6]": 500},
        },
        "disable_self_collision": True,  # EmbodiChain's default
    }


def test_values_of_a_run_are_suggestions() -> None:
    task = convert(read("push.yaml")).task
    assert task["suggested"] == {
        "run": {"num_envs": 4, "seed": 3, "episodes": 2},
        "train": {"num_envs": 4, "seed": 3},
    }
    assert "suggested" not in convert({"seed": -1, "env": {}}).task


def test_terms_keep_names_parameters_and_defaults_of_there() -> None:
    task = convert(read("push.yaml")).task
    assert task["observations"]["qpos"]["mode"] == "modify"  # the default there; ours is add
    assert task["observations"]["qpos"]["name"] == "robot/qpos"
    assert task["observations"]["cube"]["func"] == "get_rigid_object_pose"
    assert task["rewards"]["near"] == {
        "func": "distance_to_target",
        "mode": "add",
        "weight": 0.8,
        "params": {
            "source_entity_cfg": {"uid": "cube"},
            "target_pose_key": "goal_pose",
            "exponential": True,
            "sigma": 0.12,
            "use_xy_only": True,
        },
    }
    assert task["rewards"]["still"]["params"] == {"robot_uid": "arm", "part_name": "whole"}
    assert task["actions"] == {
        "arm": {
            "func": "relative_joint_position",
            "params": {"entity_cfg": {"uid": "arm"}, "scale": 0.1, "clip": [-1.0, 1.0]},
        }
    }


def test_an_entity_that_a_term_needs_is_not_guessed() -> None:
    config = read("push.yaml")
    config["env"]["observations"] = {"pose": {"func": "get_object_pose", "mode": "add"}}
    assert convert(config).task["observations"]["pose"] == {
        "func": "get_object_pose",
        "mode": "add",
    }


def test_spellings_of_release_0_3() -> None:
    conversion = convert(read("cart_pole.json"))
    task = conversion.task
    assert conversion.problems == ()
    assert task["physics"] == {"gravity": [0, 0, -9.81], "physics_dt": 0.005}
    assert task["sim_steps_per_control"] == 4  # 50 Hz of steps of 5 ms
    assert task["robot"]["fix_base"] is True
    assert task["robot"]["drive_pros"]["damping"] == {"slider_to_cart": 0.1, "cart_to_pole": 0.0}
    assert task["objects"]["ball"]["attrs"] == {
        "mass": 0.2,
        "linear_damping": 0.1,
        "dynamic_friction": 0.4,
        "angular_damping": 0.7,  # EmbodiChain's default; here it is 0
    }
    assert task["events"]["joints"]["func"] == "randomize_robot_qpos"  # a module's name is dropped
    effort = task["actions"]["cart"]
    assert effort["func"] == "joint_effort"
    assert effort["params"]["entity_cfg"] == {"uid": "cart", "joint_names": ["slider_to_cart"]}
    assert notes(conversion)["rigid_object.0.attrs.material_props.restitution"]
    assert conversion.origin(("objects", "ball", "attrs", "mass")) == (
        *("rigid_object", "0", "attrs", "mass_props"),
        "mass",
    )


@pytest.mark.parametrize(
    ("func", "term"),
    [
        ("DeltaQposTerm", "relative_joint_position"),
        ("RelativeJointPositionAction", "relative_joint_position"),
        ("joint_position.relative@1", "relative_joint_position"),
        ("QposTerm", "joint_position"),
        ("joint_position.absolute@1", "joint_position"),
        ("QposDenormalizedTerm", "joint_position_to_limits"),
        ("JointPositionToLimitsAction", "joint_position_to_limits"),
        ("DefaultJointPositionAction", "default_offset_joint_position"),
        ("QvelTerm", "joint_velocity"),
        ("QfTerm", "joint_effort"),
        ("ParallelGripperAction", "parallel_gripper"),
        ("EefPoseTerm", "absolute_eef_pose"),
        ("eef_pose.relative@1", "relative_eef_pose"),
    ],
)
def test_actions_of_both_releases(func: str, term: str) -> None:
    config = read("push.yaml")
    config["env"]["actions"] = {"arm": {"func": func, "params": {"part_name": "whole"}}}
    conversion = convert(config)
    action = conversion.task["actions"]["arm"]
    assert conversion.problems == ()
    assert action["func"] == term
    assert action["params"]["entity_cfg"] == {"uid": "arm", "control_parts": "whole"}


def test_no_actions_with_active_parts_are_joint_targets_of_them() -> None:
    config = read("push.yaml")
    del config["env"]["actions"]
    config["env"]["active_joint_ids"] = [0, 1]
    assert convert(config).task["actions"] == {
        "qpos": {
            "func": "joint_position",
            "params": {"entity_cfg": {"uid": "arm", "joint_ids": [0, 1]}},
        }
    }


def test_functors_of_the_users_are_import_paths() -> None:
    events = {
        "dotted": {"func": "my.package.nudge"},
        "path": {"func": "my.package:nudge"},
        "name": {"func": "my_own"},
    }
    task = convert({"env": {"events": events}}).task
    assert [event["func"] for event in task["events"].values()] == [
        "my.package:nudge",
        "my.package:nudge",
        "my_own",  # whether it is registered is checked with the task
    ]


def test_events_of_cameras() -> None:
    camera = {"entity_cfg": {"uid": "cam"}}
    events = {
        "sway": {
            "func": "randomize_camera_extrinsics",
            "params": {**camera, "pos_range": [[0, 0, 0], [0.1, 0, 0]], "euler_range": None},
        },
        "lens": {
            "func": "randomize_camera_intrinsics",
            "params": {**camera, "focal_x_range": [-5, 5]},
        },
        "around": {
            "func": "randomize_camera_extrinsics",
            "params": {**camera, "eye_range": [[0, 0, 0], [0.1, 0, 0]]},
        },
    }
    sensor = [{"sensor_type": "Camera", "uid": "cam"}]
    conversion = convert({"sensor": sensor, "env": {"events": events}})
    assert conversion.task["events"] == {
        "sway": {
            "func": "randomize_camera_pose",
            "params": {
                **{"camera": "cam", "position_range": [[0, 0, 0], [0.1, 0, 0]]},
                "rotation_range": None,
            },
        },
        "lens": {
            "func": "randomize_camera_intrinsics",
            "params": {"sensor": "cam", "focal_x_range": [-5, 5]},
        },
    }
    found = notes(conversion)
    assert "move the camera in its own axes" in found["env.events.around.params.eye_range"]
    assert "nothing is left" in found["env.events.around"]


def test_every_section_is_converted_or_listed() -> None:
    config = read("everything.yaml")
    before = copy.deepcopy(config)
    conversion = convert(config)
    assert config == before
    assert conversion.problems == ()
    assert conversion.name == "PushCubeRL"
    found = notes(conversion)
    for path, words in {
        "id": "Python class of EmbodiChain's",
        "device": "device=cuda:1",
        "gpu_id": "device=cuda:N",
        "physics_config.bounce_threshold": "PhysX",
        "robot.solver_cfg.class_type": "the solver follows from the arm",
        "sensor.1": "sensors: {NAME: {sensor_type: contact",
        "light.direct.1": "rect",
        "light.indirect": "one background light",
        "rigid_object.0.max_convex_hull_num": "collides as its convex hull",
        "rigid_object_group": "one by one",
        "articulation.0.build_pk_chain": "kinematics",
        "env.control_parts": "actions have only these",
        "env.dataset": "the log contains every step",
        "env.events.colour": "ray tracer",
        "env.observations.mask": "camera_mask",
        "env.observations.cube.extra": "it has no effect in EmbodiChain",
        "env.actions.arm.mode": "before physics",
    }.items():
        assert words in found[path], path
    task = conversion.task
    assert set(task["events"]) == {"mass"}
    assert set(task["objects"]) == {"wall", "cube"}
    assert set(task["articulations"]) == {"cart"}
    assert set(task["lights"]) == {"lamp"}
    assert task["sensors"] == {
        "cam": {
            **{"width": 320, "height": 240, "sensor_type": "camera", "observe": True},
            **{"intrinsics": [600, 600, 320.0, 240.0], "convention": "ros"},
        }
    }
    assert task["robot"]["init_qpos"] == [0, -1.57, 1.57, -1.57, -1.57, 0, 0.04, 0.04]
    assert task["robot"]["urdf_cfg"] == {
        "components": [
            {"component_type": "hand", "urdf_path": "a_hand.urdf"},
            {"component_type": "arm", "urdf_path": "UniversalRobots/UR10/UR10.urdf"},
        ],
        "name_case": {"joint": "none", "link": "none"},
    }
    every = {*found, *conversion.origins.values()}
    tops = {path.partition(".")[0] if isinstance(path, str) else path[0] for path in every}
    assert set(config) <= tops  # no section is passed over in silence


@pytest.mark.parametrize(
    ("config", "message"),
    [
        (
            {"rigid_objects": []},
            r"rigid_objects: unknown key; known: id, .* Did you mean 'rigid_object'\?",
        ),
        ({"env": {"event": {}}}, r"env\.event: unknown key; .* Did you mean 'events'\?"),
        (
            {"rigid_object": [{"uid": "a", "atrs": {}}]},
            r"rigid_object\.0\.atrs: unknown key; .* Did you mean 'attrs'\?",
        ),
        (
            {"rigid_object": [{"uid": "a", "shape": {"shape_type": "Cub"}}]},
            r"rigid_object\.0\.shape\.shape_type: unknown .* Did you mean 'Cube'\?",
        ),
        ({"rigid_object": {"a": {}}}, r"rigid_object: expected a list"),
        ({"rigid_object": [{}]}, r"rigid_object\.0\.uid: missing value"),
        (
            {"background": [{"uid": "a"}], "rigid_object": [{"uid": "a"}]},
            r"rigid_object\.0\.uid: another entity is called 'a' already",
        ),
        (
            {"background": [{"uid": "a", "body_type": "dynamic"}]},
            r"background\.0\.body_type: a background object is static or kinematic",
        ),
        (
            {"sensor": [{"sensor_type": "Camra"}]},
            r"sensor\.0\.sensor_type: unknown sensor 'Camra'; .* Did you mean 'Camera'\?",
        ),
        (
            {"robot": {"robot_type": "URRobt"}},
            r"robot\.robot_type: the class 'URRobt' is not here; .* Did you mean 'URRobot'\?",
        ),
        (
            {"robot": {"uid": "r", "urdf_cfg": {"component": [{}, {}]}}},
            r"robot\.urdf_cfg\.component: unknown key; .* Did you mean 'components'\?",
        ),
        ({"env": {"actions": {"arm": {}}}}, r"env\.actions\.arm\.func: missing value"),
        (
            {"env": {"target_control_frequency": 30}},
            r"env\.target_control_frequency: 30 Hz is not a whole number of physics steps",
        ),
        ({"env": {"events": []}}, r"env\.events: expected a map"),
        ({"id": 3}, r"id: expected text, got 3"),
    ],
)
def test_mistakes_name_the_path_in_the_gym_config(config: dict[str, Any], message: str) -> None:
    assert re.search(f"^{message}", only_problem(config))


def test_components_of_a_robot_are_kept() -> None:
    urdf = {
        "components": {"arm": {"urdf_path": "a/b.urdf", "wheel_type": "x"}},
        "fname": "ab",
        "base_link_name": "root",
    }
    conversion = convert({"robot": {"uid": "r", "urdf_cfg": urdf}})
    components = [{"component_type": "arm", "urdf_path": "a/b.urdf"}]
    assert conversion.problems == ()
    assert conversion.task["robot"]["urdf_cfg"] == {
        "base_link_name": "root",
        "components": components,
    }
    found = notes(conversion)
    assert found["robot.urdf_cfg.components.0.wheel_type"] == "it has no effect"
    assert "nothing is written" in found["robot.urdf_cfg.fname"]
    beside = convert({"robot": {"fpath": "c.urdf", "urdf_cfg": urdf}})
    assert beside.task["robot"] == {"fpath": "c.urdf", "disable_self_collision": True}
    assert notes(beside) == {"robot.urdf_cfg": "fpath names the robot's file"}


COMPOSED = {
    "id": "StackBlocksTwo-v1",
    "physics": "default",
    "environment": {"component": "environment.yaml"},
    "embodiment": {"component": "robot.yaml"},
    "scene": {"component": "scene.yaml"},
}


def test_components_of_a_robot_are_noted_in_the_order_of_the_file() -> None:
    keys = ["wheel_type", "mass", "default_xpos", "colour", "axle", "brand"]
    component = {"component_type": "arm", "urdf_path": "a.urdf", **dict.fromkeys(keys, 1)}
    urdf = {"components": [component]}
    conversion = convert({"robot": {"uid": "r", "urdf_cfg": urdf}})
    paths = [note.path.rpartition(".")[2] for note in conversion.notes]
    assert [path for path in paths if path in keys] == keys


def test_compositions_of_release_0_3_are_refused() -> None:
    found = {p.path: p.message for p in convert(COMPOSED).problems}
    assert set(found) == {"environment", "embodiment", "scene"}
    assert all("not read: write their sections into this file" in text for text in found.values())


def test_what_would_leave_nothing_to_simulate_is_refused() -> None:
    config = {"id": "PushCubeRL", "light": {"direct": [{"uid": "lamp"}]}, "env": {}}
    assert "nothing is left to simulate" in only_problem(config)
    group = {"rigid_object_group": [{"uid": "heap"}], "env": {}}
    assert "nothing is left to simulate" in only_problem(group)
    for config in (
        {"id": "Mine-v0", "env": {}},  # its class may build the scene
        {"robot": {"fpath": "a.urdf"}},
        {"background": [{"uid": "a", "shape": {"shape_type": "Cube"}}]},
        {"articulation": [{"uid": "a", "fpath": "a.urdf"}]},
    ):
        assert convert(config).problems == ()


def test_a_reward_that_waits_for_a_lost_success_is_noted() -> None:
    rewards = {"bonus": {"func": "success_reward", "weight": 10.0}}
    config = {"id": "PushCubeRL", "robot": {"fpath": "a.urdf"}, "env": {"rewards": rewards}}
    message = notes(convert(config))["env.rewards.bonus"]
    assert message.startswith("it stays 0: success was computed by the Python class of PushCubeRL")
    registered = convert(config, ("PushCubeRL",))
    assert registered.task["id"] == "PushCubeRL" and registered.notes == ()
    assert notes(convert({**config, "id": "EmbodiedEnv-v1"})) == {}


def test_presets_bring_their_control_parts() -> None:
    def parts(**robot: Any) -> Any:
        return convert({"robot": {"robot_type": "URRobot", **robot}}).task["robot"]["control_parts"]

    assert parts() == {"arm": ["Joint[1-6]"]}
    assert parts(control_parts={"wrist": ["Joint6"]}) == {"wrist": ["Joint6"]}


def test_an_articulation_without_uid_is_called_like_its_file() -> None:
    drawer = {"fpath": "Drawer/sliding_drawer.urdf", "init_pos": [1, 0, 0]}
    assert set(convert({"articulation": [drawer]}).task["articulations"]) == {"sliding_drawer"}
    assert "uid: missing value" in only_problem({"articulation": [{"init_pos": [1, 0, 0]}]})


@pytest.mark.parametrize(
    ("given", "disabled"),
    [
        ({}, True),
        ({"disable_self_collision": False}, False),
        ({"disable_self_collision": True}, True),
        ({"root_props": {"self_collision_enabled": True}}, False),
        ({"root_props": {"fixed_base": True}}, True),
    ],
)
def test_the_default_of_self_collision_is_written_out(given: Any, disabled: bool) -> None:
    for section in ("robot", "articulation"):
        thing = {"uid": "a", "fpath": "a.urdf", **given}
        task = convert({section: [thing] if section == "articulation" else thing}).task
        made = task["robot"] if section == "robot" else task["articulations"]["a"]
        assert made["disable_self_collision"] is disabled


def test_what_nothing_reads_there_is_a_note() -> None:
    root = {"self_collision_enabled": True, "min_position_iters": 8, "min_velocity_iters": 2}
    robot = {"fpath": "a.urdf", "asset_physics_mode": "override", "root_props": root}
    conversion = convert({"robot": robot, "env": {"success_params": {"strict": False}}})
    assert conversion.problems == ()
    assert conversion.task["robot"] == {"fpath": "a.urdf", "disable_self_collision": False}
    assert set(notes(conversion)) == {
        "robot.asset_physics_mode",
        "robot.root_props.min_position_iters",
        "robot.root_props.min_velocity_iters",
        "env.success_params",
    }


def test_the_order_of_joints_of_an_action_is_kept() -> None:
    params = {"joint_names": ["Joint2", "Joint1"], "preserve_order": True}
    config = read("push.yaml")
    config["env"]["actions"] = {"arm": {"func": "JointPositionAction", "params": params}}
    found = convert(config).task["actions"]["arm"]["params"]["entity_cfg"]
    assert found == {"uid": "arm", **params}


def test_empty_sections_are_no_news() -> None:
    config = {"robot": {"fpath": "a.urdf"}, "rigid_object_group": [], "light": {"indirect": {}}}
    assert convert(config).notes == ()


def test_visual_events_are_left_out_where_that_is_asked_for() -> None:
    events = {"lamp": {"func": "embodichain.lab.gym.envs.managers.events.randomize_light"}}
    assert convert({"env": {"events": events}}).task["events"]["lamp"]["func"] == "randomize_light"
    conversion = convert({"env": {"events": events, "filter_visual_rand": True}})
    assert "events" not in conversion.task
    assert "leaves it out" in notes(conversion)["env.events.lamp"]


def test_textures_are_left_out_and_what_needs_them() -> None:
    texture = {"entity_cfg": {"uid": "cube"}, "texture_path": "pictures", "random_texture_prob": 1}
    events = {
        "only": {"func": "randomize_visual_material", "params": texture},
        "both": {
            "func": "randomize_visual_material",
            "params": {**texture, "base_color_range": [[0, 0, 0], [1, 1, 1]]},
        },
    }
    conversion = convert({"env": {"events": events}})
    assert set(conversion.task["events"]) == {"both"}
    assert set(conversion.task["events"]["both"]["params"]) == {"entity_cfg", "base_color_range"}
    found = notes(conversion)
    assert found["env.events.only"].endswith("nothing is left that it would change")
    assert "use randomize_texture" in found["env.events.both.params.texture_path"]


def test_a_class_of_ones_own_stays() -> None:
    assert convert({"id": "Mine-v0", "env": {}}).task["id"] == "Mine-v0"


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    for name, text, words in (
        ("a.yaml", "a: [", "a.yaml:1: malformed YAML"),
        ("b.json", '{\n"a": }', "b.json:2: malformed JSON"),
        ("c.yaml", "- 1", "a map is expected"),
        ("d.yaml", "a: !!python/object:os.system x", "malformed YAML"),
    ):
        (tmp_path / name).write_text(text)
        with pytest.raises(ConfigError, match=words):
            read_gym_config(tmp_path / name)
    with pytest.raises(ConfigError, match="no such file"):
        read_gym_config(tmp_path / "none.yaml")


def test_what_a_gym_config_is() -> None:
    assert is_gym_config({"env": {}})
    assert is_gym_config(COMPOSED)
    assert not is_gym_config({"task": {}, "env": {}})
    assert not is_gym_config({"robot": {}})


def test_a_texture_of_a_surface_is_a_file() -> None:
    material = {"base_color": [1, 1, 1, 1], "base_color_texture": "wood.png"}
    shape = {"shape_type": "Cube", "size": [0.1, 0.1, 0.1], "visual_material": material}
    conversion = convert({"rigid_object": [{"uid": "cube", "shape": shape}]})
    textures = conversion.task["objects"]["cube"]["shape"]["visual_material"]["textures"]
    assert textures == ["wood.png"]
    assert not [path for path in notes(conversion) if "texture" in path]
