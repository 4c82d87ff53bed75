"""What is known of an expert before an environment is built: arms, targets, tables."""

import pytest

from embodichain.lab.gym.envs.cfg import ActionTermCfg, CommandCfg, EnvCfg, SceneEntityCfg, TermCfg
from embodichain.lab.gym.expert.arms import declared_arms
from embodichain.lab.gym.expert.program import check_expert, step_rows

TOOL = {"of": {"uid": "left", "control_parts": "arm"}}
FINGERS = {"of": {"uid": "left"}, "actuator_names": "grip"}
KNOWN = {"left": None, "right": None, "cube": "rigid object", "lamp": "light"}


def cfg(expert=None, **actions):
    terms = {
        name: ActionTermCfg(func=func, params=params) for name, (func, params) in actions.items()
    }
    return EnvCfg(actions=terms, expert=expert)


def arms(**actions):
    return [(arm.name, arm.uid, arm.gripper) for arm in declared_arms(cfg(**actions))]


# -- arms ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "func",
    [
        "eef_pose",
        "eef_delta_pose",
        "operational_space",
        "joint_action",
        "joint_position",
        "default_offset_joint_position",
    ],
)
def test_actions_that_move_a_tool(func):
    """Other names of an action count as well."""
    assert arms(tool=(func, TOOL)) == [("tool", "left", None)]


@pytest.mark.parametrize(
    ("func", "params"),
    [
        ("joint_action", {**TOOL, "control": "effort"}),
        ("joint_action", {**TOOL, "control": "velocity"}),
        ("actuator_ctrl", TOOL),
        ("parallel_gripper", FINGERS),
        ("eef_poze", TOOL),
        ("nowhere:Action", TOOL),
    ],
)
def test_actions_that_do_not(func, params):
    assert arms(tool=(func, params)) == []


def test_a_reference_may_be_a_config():
    params = {"entity_cfg": SceneEntityCfg(uid="left")}
    assert arms(tool=("eef_pose", params)) == [("tool", "left", None)]


def test_a_gripper_belongs_to_the_arm_of_its_robot():
    other = {"of": {"uid": "right"}, "actuator_names": "grip"}
    found = arms(
        left=("eef_pose", TOOL),
        right=("eef_pose", {"of": {"uid": "right"}}),
        right_hand=("parallel_gripper", other),
        left_hand=("parallel_gripper", FINGERS),
    )
    assert found == [("left", "left", "left_hand"), ("right", "right", "right_hand")]


def test_of_several_grippers_of_a_robot_the_name_decides():
    found = arms(
        first_tool=("eef_pose", TOOL),
        second_tool=("eef_delta_pose", TOOL),
        second_hand=("parallel_gripper", FINGERS),
        first_hand=("parallel_gripper", FINGERS),
    )
    assert [gripper for *_, gripper in found] == ["first_hand", "second_hand"]


# -- the section -----------------------------------------------------------------------------------


def mistakes(expert, known=KNOWN, **actions):
    actions = actions or {"tool": ("eef_pose", TOOL), "hand": ("parallel_gripper", FINGERS)}
    task = cfg(expert, **actions)
    task.commands = {"goal": CommandCfg(func="uniform_pose")}
    return [str(problem) for problem in check_expert(task, known)]


@pytest.mark.parametrize(
    "steps",
    [
        [{"grasp": "cube"}, {"lift": 0.1}, "release"],
        [{"move_to": "goal"}, {"move_to": "world"}],
        [{"lift": {"arm": "tool"}}, {"lift": {"arm": "left"}}],
        [{"together": {"left": ["close"]}}],
        [{"repeat": {"times": 2, "steps": [{"move_to": "cube"}]}}],
    ],
)
def test_steps_without_mistakes(steps):
    assert mistakes(steps) == []


def test_a_task_without_the_section_has_no_mistakes():
    assert mistakes(None) == []


@pytest.mark.parametrize(
    ("step", "said"),
    [
        ({"grasp": "ball"}, "expert.0.grasp.of: no entity is called 'ball'; there are: "),
        ({"grasp": "lamp"}, "expert.0.grasp.of: 'lamp' is a light"),
        ({"grasp": "cube/lid"}, "expert.0.grasp.of: no link of 'cube' matches 'lid'"),
        ({"place": {"to": "cube", "align": "gaol"}}, "expert.0.place.align: no entity"),
        ({"lift": {"arm": "lefd"}}, "expert.0.lift.arm: there is no arm 'lefd'"),
        ({"hand_over": {"of": "cube", "to": "up"}}, "expert.0.hand_over.to: there is no arm 'up'"),
        ({"together": {"up": ["close"]}}, "expert.0.together.up: there is no arm 'up'"),
    ],
)
def test_a_mistake_in_a_reference(step, said):
    (found,) = mistakes([step])
    assert found.startswith(said)


def test_without_entities_only_steps_and_arms_are_checked():
    assert mistakes([{"grasp": "ball"}], known=None) == []
    assert len(mistakes([{"grasp": {"of": "ball", "arm": "up"}}], known=None)) == 1


def test_a_task_of_a_python_class_may_have_other_entities_and_arms():
    task = cfg([{"grasp": {"of": "ball", "arm": "third"}}], tool=("eef_pose", TOOL))
    task.id = "Mine-v0"
    assert check_expert(task, KNOWN) == []


def test_two_joint_actions_of_a_robot_are_told_apart_later():
    """One of them may move its fingers only."""
    actions = {"tool": ("joint_action", TOOL), "hand": ("joint_action", TOOL)}
    assert mistakes([{"lift": 0.1}], **actions) == []


@pytest.mark.parametrize(
    ("func", "params", "said"),
    [
        ("tests.nowhere:steps", {}, "expert.func: cannot import 'tests.nowhere'"),
        ("steps", {}, "expert.func: 'steps' is not of the form package.module:function"),
        (f"{__name__}:made", {"hight": 1}, "expert.params.hight: unknown parameter of step 'made'"),
        (f"{__name__}:made", {"height": "up"}, "expert.params.height: expected a number"),
        (f"{__name__}:TOOL", {}, f"expert.func: '{__name__}:TOOL' is not a function"),
    ],
)
def test_a_mistake_in_the_function_that_makes_steps(func, params, said):
    (found,) = mistakes(TermCfg(func=func, params=params))
    assert found.startswith(said)


def made(env, height: float = 0.1):
    return [{"lift": height}]


def test_a_function_is_not_imported_where_that_is_not_allowed():
    task = cfg(TermCfg(func="tests.nowhere:steps"))
    assert check_expert(task, KNOWN, allow_import=False) == []


# -- tables ----------------------------------------------------------------------------------------


def test_the_table_of_steps():
    steps = [
        {"grasp": "cube"},
        {"repeat": {"times": 2, "steps": [{"lift": 0.1}, "release"]}},
        {"wait": 1},
    ]
    assert step_rows(steps) == [
        {"path": "expert.0.grasp", "step": "grasp", "made of": "move, move, close"},
        {"path": "expert.1.repeat", "step": "repeat", "made of": "move, open, move, open"},
        {"path": "expert.1.repeat.steps.0.lift", "step": "lift", "made of": "move"},
        {"path": "expert.1.repeat.steps.1.release", "step": "release", "made of": "open"},
        {"path": "expert.2.wait", "step": "wait", "made of": "wait"},
    ]


@pytest.mark.parametrize("expert", [None, TermCfg(func=f"{__name__}:made")])
def test_what_has_no_list_of_steps_has_an_empty_table(expert):
    assert step_rows(expert) == []
