"""Mistakes in `expert` are reported before anything runs, with key path, file and line."""

import re
from pathlib import Path

import pytest
import yaml

import embodichain
from embodichain.config import validate
from embodichain.config.composition.composed import compose
from embodichain.lab.gym.expert.policy import Expert
from embodichain.utils.errors import ConfigError

STEPS = "allowed: move_to, grasp, release, close, lift, place, push, open, press, hand_over, wait"
BAD = {
    "unknown step": (["grip: cube"], "0.grip: unknown step 'grip'; " + STEPS),
    "two keys": (["{grasp: cube, lift: 0.1}"], "0: a step is a map with one key, its name, got"),
    "no map": (["3"], "0: expected text or a map, got 3"),
    "no steps": ([], ": needs at least one step"),
    "unknown key": (
        ["grasp: {of: cube, from: 3}"],
        "0.grasp.from: unknown parameter of step 'grasp'; it takes of",
    ),
    "wrong type": (["lift: up"], "0.lift.by: expected"),
    "out of range": (["grasp: {of: cube, speed: 2}"], "0.grasp.speed: must be at most 1.0, got 2"),
    "short offset": (["place: {to: stand, offset: [0, 0]}"], "0.place.offset.2: missing value"),
    "no target": (["grasp"], "0.grasp.of: missing; step 'grasp' needs it"),
    "no value wanted": (["close: 3"], "0.close: takes no plain value, got 3"),
    "two ways to turn": (
        ["move_to: {to: cube, align: cube, rpy: [0, 0, 1]}"],
        "0.move_to.align: has no effect: rpy is the whole orientation; leave one of them out",
    ),
    "symmetry of an orientation": (
        ["grasp: {of: cube, rpy: [0, 0, 1], symmetry: 2}"],
        "0.grasp.symmetry: has no effect: rpy is the whole orientation; leave one of them out",
    ),
    "symmetry of nothing": (
        ["place: {to: stand, symmetry: 2}"],
        "0.place.symmetry: has no effect: nothing to align with is given",
    ),
    "unknown entity": (["grasp: cub"], "0.grasp.of: no entity is called 'cub'; there are: robot"),
    "unknown link": (["grasp: robot/hand"], "0.grasp.of: no link of 'robot' matches 'hand'"),
    "unknown arm": (["grasp: {of: cube, arm: left}"], "0.grasp.arm: there is no arm 'left'; there"),
    "in a repetition": (
        ["repeat: {times: 2, steps: [{lift: 0.1}, {grasp: cub}]}"],
        "0.repeat.steps.1.grasp.of: no entity is called 'cub'",
    ),
    "in a lane": (["together: {robot: [{grab: cube}]}"], "0.together.robot.0.grab: unknown step"),
    "no such lane": (
        ["together: {left: [{lift: 0.1}]}"],
        "0.together.left: there is no arm 'left'",
    ),
    "other arm in a lane": (
        ["together: {robot: [{lift: {arm: tool}}]}"],
        "0.together.robot.0.lift.arm: contradicts 'robot', whose steps these are",
    ),
    "two arms in a lane": (
        ["together: {robot: [{hand_over: {of: cube, to: tool}}]}"],
        "0.together.robot.0.hand_over.to: contradicts 'robot'",
    ),
}


def problems_of(steps, *overrides, task="pick_place"):
    """The mistakes of a task with these steps, as `validate` reports them."""
    composed = compose([f"task={task}", *overrides])
    composed.tree["task"]["expert"] = steps
    return [str(problem) for problem in validate(composed)]


@pytest.mark.parametrize("name", BAD)
def test_every_mistake_has_its_key_path(name):
    steps, message = BAD[name]
    found = problems_of([yaml.safe_load(step) for step in steps])
    assert len(found) == 1
    where = f"task.expert.{message}" if message[0].isdigit() else f"task.expert{message}"
    assert where in found[0]


def test_a_mistake_has_file_and_line(tmp_path):
    shipped = Path(embodichain.__file__).parent / "conf" / "task" / "pick_place.yaml"
    text = shipped.read_text().replace("place: {to: stand,", "place: {to: stant,")
    line = text[: text.index("stant")].count("\n") + 1
    (tmp_path / "task").mkdir()
    (tmp_path / "task" / "mine.yaml").write_text(text)
    found = validate(compose(["task=mine"], config_dir=tmp_path))
    assert len(found) == 1
    assert re.search(rf"mine\.yaml:{line}: task\.expert\.2\.place\.to: ", str(found[0]))
    assert "Did you mean 'stand'?" in str(found[0])


def test_all_mistakes_are_found_at_once():
    found = problems_of([{"grip": "cube"}, {"grasp": "cub"}, {"lift": -1}, "release"])
    assert len(found) == 3


def test_an_arm_must_be_named_where_there_are_two():
    found = problems_of([{"lift": 0.1}], task="hand_over")
    assert len(found) == 1
    assert (
        "task.expert.0.lift.arm: missing value: which arm; there are: left, left_tool" in found[0]
    )


def test_a_step_that_grips_needs_a_gripper():
    found = problems_of([{"grasp": "cube"}], task="push_cube")
    assert len(found) == 1
    assert "0.grasp: arm 'arm' has no gripper: no parallel_gripper moves 'robot'" in found[0]


def test_an_action_that_no_arm_motion_can_be_expressed_by():
    found = problems_of([{"lift": 0.1}], "task.actions.arm.params.control=effort", task="reach")
    found = [line for line in found if "task.expert" in line]
    assert len(found) == 1
    assert "no action moves a tool along a path; these can: eef_delta_pose, eef_pose" in found[0]


def test_a_function_that_does_not_exist():
    composed = compose(["task=pick_place"])
    composed.tree["task"]["expert"] = {"func": "tests.nowhere:steps", "params": {}}
    found = [str(problem) for problem in validate(composed)]
    assert len(found) == 1
    assert "task.expert.func: cannot import 'tests.nowhere'" in found[0]


def test_the_policy_needs_the_section():
    found = validate(compose(["task=cart_pole", "policy=expert"]))
    assert [problem.path for problem in found] == ["policy"]
    assert "the task has no section `expert`" in str(found[0])


def test_what_validate_cannot_see_is_a_config_error_of_the_first_action():
    env = embodichain.make("press_button", num_envs=1)
    try:
        obs, _ = env.reset()
        with pytest.raises(ConfigError, match="does not choose the tool's orientation"):
            Expert([{"move_to": {"to": "button", "rpy": [3.14, 0.0, 0.0]}}])(obs, env)
        with pytest.raises(ConfigError, match=r"expert\.0\.grasp\.of: no entity is called 'cube'"):
            Expert([{"grasp": "cube"}])(obs, env)
    finally:
        env.close()
