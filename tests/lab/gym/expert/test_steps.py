"""What each step is made of: `phases` of `read_steps`, without an environment."""

import dataclasses

import pytest
import yaml

from embodichain.lab.gym.expert import reading
from embodichain.lab.gym.expert.arms import DeclaredArm, find_arm
from embodichain.lab.gym.expert.instructions import Beyond, Facing, Goal, Grip, Move, Oriented, Wait
from embodichain.lab.gym.expert.program import Program, check_steps, targets_in
from embodichain.lab.gym.expert.reading import read_steps
from embodichain.lab.gym.expert.step_register import Aim, Made, Maker, Symmetry, Turns
from embodichain.lab.gym.expert.steps import STEPS
from embodichain.utils.errors import ConfigError

RIGHT = DeclaredArm("right_tool", "right", "right_gripper")
LEFT = DeclaredArm("left_tool", "left", "left_gripper")
BARE = DeclaredArm("tool", "ur10", None)


def phases(text):
    """The phases of one step, without the names of steps in messages."""
    steps, problems = read_steps([yaml.safe_load(text)])
    assert problems == []
    return [
        {
            arm: [dataclasses.replace(one, step="", arm="") for one in lane]
            for arm, lane in phase.items()
        }
        for phase in steps[0].phases
    ]


def moves(goal, speed=1.0, tolerance=0.03):
    return Move("", "", goal, speed, tolerance)


OPEN, SHUT = Grip("", "", True, None), Grip("", "", False, None)

MADE_OF = {
    "move_to": [
        moves(Goal(), tolerance=0.01),
    ],
    "move_to: cube": [
        moves(Goal("cube"), tolerance=0.01),
    ],
    "move_to: {to: cube, offset: [0, 0, 0.1], speed: 0.5, tolerance: null}": [
        moves(Goal("cube", (0.0, 0.0, 0.1)), 0.5, None),
    ],
    "move_to: {to: hole, align: hole, held: true, axes: target, tolerance: 0.001}": [
        moves(
            Goal("hole", axes="target", turn=Facing("hole", level=True), held=True), tolerance=0.001
        ),
    ],
    "move_to: {rpy: [0, 1, 2], axes: tool}": [
        moves(Goal(axes="tool", turn=Oriented((0.0, 1.0, 2.0))), tolerance=0.01),
    ],
    "grasp: cube": [
        moves(Goal("cube", turn=Facing("cube"), back=0.1)),
        moves(Goal("cube", turn=Facing("cube")), tolerance=0.004),
        Grip("", "", False, "cube"),
    ],
    "grasp: {of: bar, offset: [0, 0.1, 0], axes: target, symmetry: 2, approach: 0}": [
        moves(Goal("bar", (0.0, 0.1, 0.0), axes="target", turn=Facing("bar", 2)), tolerance=0.004),
        Grip("", "", False, "bar"),
    ],
    "grasp: {of: bar, align: false, speed: 0.5}": [
        moves(Goal("bar", back=0.1), 0.5),
        moves(Goal("bar"), 0.5, 0.004),
        Grip("", "", False, "bar"),
    ],
    "grasp: {of: bar, rpy: [3, 0, 0]}": [
        moves(Goal("bar", turn=Oriented((3.0, 0.0, 0.0)), back=0.1)),
        moves(Goal("bar", turn=Oriented((3.0, 0.0, 0.0))), tolerance=0.004),
        Grip("", "", False, "bar"),
    ],
    "release": [
        OPEN,
    ],
    "release: 0.05": [
        OPEN,
        moves(Goal(back=0.05)),
    ],
    "close": [
        SHUT,
    ],
    "lift": [
        moves(Goal(above=0.1)),
    ],
    "lift: 0.2": [
        moves(Goal(above=0.2)),
    ],
    "place: stand": [
        moves(Goal("stand", above=0.08, held=True)),
        moves(Goal("stand", held=True), 0.5, 0.004),
        OPEN,
        moves(Goal(back=0.08)),
    ],
    "place: {to: stand, offset: [0, 0, 0.05], above: 0, retreat: 0, lowering: 1, align: stand}": [
        moves(
            Goal("stand", (0.0, 0.0, 0.05), turn=Facing("stand", level=True), held=True), 1.0, 0.004
        ),
        OPEN,
    ],
    "push: {of: cube, to: goal, behind: 0.05, height: 0.02}": [
        moves(Goal("cube", (0.0, 0.0, 0.02), above=0.1, beyond=Beyond("goal", 0.1))),
        moves(Goal("cube", (0.0, 0.0, 0.02), beyond=Beyond("goal", 0.1))),
        moves(Goal("goal", (0.0, 0.0, 0.02), beyond=Beyond("cube", -0.05))),
        moves(Goal(above=0.1)),
    ],
    "open: {of: cabinet/handle, by: [-0.2, 0, 0], approach: 0.08}": [
        moves(Goal("cabinet/handle", turn=Facing("cabinet/handle"), back=0.08)),
        moves(Goal("cabinet/handle", turn=Facing("cabinet/handle")), tolerance=0.004),
        Grip("", "", False, "cabinet/handle"),
        moves(Goal(offset=(-0.2, 0.0, 0.0)), 0.5),
    ],
    "press: {of: button/cap, depth: 0.02, pressing: 0.5}": [
        moves(Goal("button/cap", back=0.05), tolerance=0.008),
        moves(Goal("button/cap", back=-0.02), 0.5, None),
        Wait("", "", 0.3),
        moves(Goal(back=0.07)),
    ],
    "wait: 0.5": [
        Wait("", "", 0.5),
    ],
}


@pytest.mark.parametrize("text", MADE_OF)
def test_what_a_step_of_one_arm_is_made_of(text):
    found = phases(text if ":" in text else f"'{text}'")
    assert len(found) == 1
    wanted = MADE_OF[text]
    if text == "move_to":
        wanted = [moves(Goal(), tolerance=0.01)]
    assert found[0] == {"": wanted}


def test_every_step_is_tried():
    tried = {text.partition(":")[0] for text in MADE_OF}
    assert set(STEPS) - tried == {"hand_over"}


def test_a_step_names_its_arm():
    assert list(phases("lift: {arm: left}")[0]) == ["left"]


def test_what_hand_over_is_made_of():
    giving, taking, leaving = phases("hand_over: {arm: right, to: left, of: bar, at: [1, 2, 3]}")
    assert giving == {"right": [moves(Goal("world", (1.0, 2.0, 3.0), held=True))]}
    assert taking == {"left": phases("grasp: bar")[0][""]}
    assert leaving == {"right": phases("release: 0.1")[0][""]}


def test_without_a_place_it_is_handed_over_where_it_is():
    found = phases("hand_over: {arm: right, to: left, of: bar, retreat: 0}")
    assert [list(phase) for phase in found] == [["left"], ["right"]]
    assert found[1]["right"] == [OPEN]


def test_what_repeat_is_made_of():
    found = phases("repeat: {times: 3, steps: [{lift: 0.1}, release]}")
    assert found == 3 * [phases("lift: 0.1")[0], {"": [OPEN]}]


def test_repetitions_in_repetitions():
    inner = "{repeat: {times: 2, steps: [close]}}"
    found = phases(f"repeat: {{times: 2, steps: [{inner}, release]}}")
    assert [phase[""][0].opens for phase in found] == [False, False, True] * 2


def test_what_together_is_made_of():
    found = phases("together: {left: [{lift: 0.1}, close], right: [{wait: 1}]}")
    assert len(found) == 1
    assert found[0] == {"left": [*phases("lift: 0.1")[0][""], SHUT], "right": [Wait("", "", 1.0)]}


def test_the_names_of_steps_in_messages():
    values = [{"grasp": "cube"}, {"repeat": {"times": 1, "steps": ["release", {"place": "pad"}]}}]
    steps, _ = read_steps(values)
    found = [one.step for step in steps for phase in step.phases for one in phase[""]]
    assert list(dict.fromkeys(found)) == [
        "step 1, grasp cube",
        "step 2.1, release",
        "step 2.2, place pad",
    ]


def test_what_steps_refer_to():
    values = [
        {"grasp": "cube"},
        {"together": {"ur10": [{"place": {"to": "stand", "align": "cube"}}]}},
        {"hand_over": {"of": "bar", "to": "left"}},
    ]
    steps, _ = read_steps(values)
    assert targets_in(steps) == [
        ("expert.0.grasp.of", "cube"),
        ("expert.1.together.ur10.0.place.to", "stand"),
        ("expert.1.together.ur10.0.place.align", "cube"),
        ("expert.2.hand_over.of", "bar"),
    ]


# -- arms ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "arms", "found"),
    [
        ("", [RIGHT], RIGHT),
        ("right", [RIGHT, LEFT], RIGHT),
        ("left_tool", [RIGHT, LEFT], LEFT),
    ],
)
def test_an_arm_is_found_by_its_action_or_its_robot(name, arms, found):
    assert find_arm(name, arms, "expert.0") is found


@pytest.mark.parametrize(
    ("name", "arms", "message"),
    [
        ("", [], "expert.0: no action moves a tool along a path; these can: eef_delta_pose"),
        ("", [RIGHT, LEFT], "expert.0.arm: missing value: which arm; there are: left, left_tool"),
        ("lefd", [RIGHT, LEFT], "Did you mean 'left'?"),
        ("two", [DeclaredArm(name, "two", None) for name in "ab"], "more than one arm is"),
    ],
)
def test_an_arm_that_is_not_unique(name, arms, message):
    with pytest.raises(ConfigError) as caught:
        find_arm(name, arms, "expert.0")
    assert message in str(caught.value)


@pytest.mark.parametrize("step", ["grasp: cube", "release", "close", "place: cube"])
def test_steps_that_grip_need_a_gripper(step):
    value = yaml.safe_load(step)
    assert check_steps([value], [RIGHT])[1] == []
    problems = check_steps([value], [BARE])[1]
    assert [str(p).endswith("no parallel_gripper moves 'ur10'") for p in problems] == [True]


@pytest.mark.parametrize("step", ["lift: 0.1", "move_to: cube", "press: cube", "wait: 1"])
def test_other_steps_need_none(step):
    assert check_steps([yaml.safe_load(step)], [BARE])[1] == []


def strokes(make: Maker, of: Aim, number: Symmetry = 2, symmetry: Turns = 1) -> Made:
    """Opens and closes; its types have older names too, as the packages outside use them."""
    for _ in range(number * symmetry):
        yield make.grip(True)
        yield make.grip(False, of)


def test_a_step_may_have_some_parameters_of_those_that_turn_the_tool(monkeypatch):
    # The register of steps would keep it for other tests.
    monkeypatch.setattr(reading, "STEPS", {"strokes": strokes})
    steps, problems = read_steps([{"strokes": {"of": "cube", "symmetry": 2}}])
    assert problems == []
    assert len(steps[0].phases[0][""]) == 8
    assert targets_in(steps) == [("expert.0.strokes.of", "cube")]


# -- programs --------------------------------------------------------------------------------------


def program(values, arms):
    steps, problems = check_steps(values, arms)
    assert problems == []
    return Program(steps, arms)


def test_instructions_of_one_arm_follow_each_other():
    found = program([{"grasp": "cube"}, {"lift": 0.1}], [RIGHT])
    assert found.first.tolist() == [[0], [3]]
    assert found.next.tolist() == [1, 2, -1, -1]


def test_arms_that_act_together_begin_in_the_same_phase():
    steps = {"left": [{"lift": 0.1}, "release"], "right": ["close"]}
    found = program([{"together": steps}, {"lift": {"arm": "left"}}], [RIGHT, LEFT])
    assert found.first.tolist() == [[2, 0], [-1, 3]]
    assert found.next.tolist() == [1, -1, -1, -1]


def test_what_is_taken_is_listed_once():
    values = [{"grasp": "cube"}, {"place": "pad"}, {"grasp": "bar"}, "release", {"grasp": "cube"}]
    assert program(values, [RIGHT]).taken() == ["cube", "bar"]


# -- mistakes --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "path", "message"),
    [
        ({"move_to": {"axes": "base"}}, "move_to.axes", "expected one of 'world', 'target'"),
        ({"move_to": {"tolerance": 0}}, "move_to.tolerance", "must be greater than 0"),
        ({"move_to": {"rpy": 3}}, "move_to.rpy", "expected a list"),
        ({"grasp": {"of": "cube", "symmetry": 0}}, "grasp.symmetry", "must be at least 1"),
        ({"grasp": {"of": "cube", "approach": -1}}, "grasp.approach", "must be at least 0"),
        ({"open": "handle"}, "open.by", "missing; step"),
        ({"press": {"of": "cap", "depth": 0}}, "press.depth", "must be greater than 0"),
        ({"hand_over": "bar"}, "hand_over.to", "missing; step"),
        ({"wait": None}, "wait.seconds", "missing; step"),
        ({"wait": "long"}, "wait.seconds", "expected a number"),
        ({"repeat": {"steps": ["close"]}}, "repeat", "needs times and steps"),
        ({"repeat": {"times": 0, "steps": ["close"]}}, "repeat.times", "an integer of at least 1"),
        ({"together": ["close"]}, "together", "needs a map from arms to their steps"),
        ({"together": {"left": "close"}}, "together.left", "needs a list of steps"),
    ],
)
def test_a_wrong_parameter_is_named(value, path, message):
    steps, problems = read_steps([value])
    assert steps == []
    assert [problem.path for problem in problems] == [f"expert.0.{path}"]
    assert message in problems[0].message


@pytest.mark.parametrize(("name", "meant"), [("move", "move_to"), ("realease", "release")])
def test_an_unknown_step_has_a_suggestion(name, meant):
    problems = read_steps([{name: "cube"}])[1]
    assert [problem.hint for problem in problems] == [f"Did you mean {meant!r}?"]


def test_a_wrong_step_does_not_hide_the_others():
    steps, problems = read_steps(["close", {"lift": "high"}, {"grasp": 3}, "release"])
    assert [step.path for step in steps] == ["expert.0.close", "expert.3.release"]
    assert len(problems) == 2
