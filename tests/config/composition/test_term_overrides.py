"""Every manager's terms can be changed, added and deleted from the command line, and it shows."""

from typing import Any

import pytest

import embodichain
from embodichain.config import compose, validate
from tests.config.conftest import WriteTask

TASK = """\
description: A term in every section.
max_episode_steps: 10
extensions: {reach: 0.1}
robot: {uid: arm, fpath: UniversalRobots/UR10/UR10.urdf, init_qpos: [0, -1, 1, 0, 0, 0]}
objects:
  ball: {shape: {shape_type: Sphere, radius: 0.05}, body_type: kinematic}
actions:
  arm: {func: joint_position, params: {entity_cfg: {uid: arm}}}
events:
  move:
    func: randomize_rigid_object_pose
    params:
      entity_cfg: {uid: ball}
      position_range: [[0, 0, 0], ["${task.extensions.reach}", 0, 0]]
commands:
  goal:
    func: uniform_joint_position
    params: {entity_cfg: {uid: arm}, position_range: [0, "${task.extensions.reach}"]}
observations:
  ball:
    func: get_object_pose
    noise: {std: "${task.extensions.reach}"}
    params: {entity_cfg: {uid: ball}}
rewards:
  near: &near
    func: within_distance
    params:
      source_entity_cfg: {uid: arm, link_names: [ee_link]}
      target_entity_cfg: {uid: ball}
      threshold: ${task.extensions.reach}
terminations:
  near: {<<: *near, kind: success}
metrics:
  near: *near
curriculum:
  near:
    func: modify_reward_weight
    params: {term_name: near, weight: "${task.extensions.reach}", num_steps: 0}
"""

ARM = "{uid: arm}"
PAIR = "{source_entity_cfg: {uid: arm}, target_entity_cfg: {uid: ball}, threshold: 1}"
CHANGES = {
    "actions": ("arm.params.entity_cfg.joint_names", "[Joint1]", ["Joint1"]),
    "events": ("move.mode", "startup", "startup"),
    "commands": ("goal.resampling_time_s", "[1, 2]", [1, 2]),
    "observations": ("ball.noise.std", "0.5", 0.5),
    "rewards": ("near.weight", "2", 2),
    "terminations": ("near.kind", "fail", "fail"),
    "metrics": ("near.reduce", "max", "max"),
    "curriculum": ("near.params.num_steps", "7", 7),
}
ADDITIONS = {
    "actions": f"{{func: joint_position, params: {{entity_cfg: {ARM}}}}}",
    "events": "{func: randomize_rigid_object_pose, mode: startup, params: {entity_cfg: "
    "{uid: ball}, rotation_range: [[0, 0, 0], [0, 0, 90]]}}",
    "commands": f"{{func: uniform_joint_position, params: {{entity_cfg: {ARM}}}}}",
    "observations": "{func: last_action, history_length: 2, noise: {std: 0.1}}",
    "rewards": f"{{func: within_distance, weight: 3, params: {PAIR}}}",
    "terminations": f"{{func: within_distance, params: {PAIR}}}",
    "metrics": f"{{func: within_distance, reduce: any, params: {PAIR}}}",
    "curriculum": "{func: modify_term_param, params: {section: rewards, term_name: near, "
    "param: threshold, value: 1, num_steps: 5}}",
}
DERIVED = {
    "events": ("move", "params.position_range.1.0"),
    "commands": ("goal", "params.position_range.1"),
    "observations": ("ball", "noise.std"),
    "rewards": ("near", "params.threshold"),
    "terminations": ("near", "params.threshold"),
    "metrics": ("near", "params.threshold"),
    "curriculum": ("near", "params.weight"),
}
FIRST = {section: path.partition(".")[0] for section, (path, _, _) in CHANGES.items()}


def at(tree: Any, path: str) -> Any:
    for part in path.split("."):
        tree = tree[int(part)] if isinstance(tree, list) else tree[part]
    return tree


def tree_of(*overrides: str) -> dict[str, Any]:
    """The task as composed; it must be valid."""
    composed = compose(["task=mine", *overrides])
    assert validate(composed) == []
    task: dict[str, Any] = composed.tree["task"]
    return task


@pytest.fixture(autouse=True)
def _task(write_task: WriteTask) -> None:
    write_task(text=TASK)


@pytest.mark.parametrize("section", CHANGES)
def test_a_term_is_changed_and_one_is_added_at_the_end(section: str) -> None:
    path, text, value = CHANGES[section]
    plus = "" if section != "actions" else "++"  # the list of joints is not in the file
    change = f"{plus}task.{section}.{path}={text}"
    terms = tree_of(change, f"+task.{section}.more={ADDITIONS[section]}")[section]
    assert at(terms, path) == value
    assert list(terms) == [FIRST[section], "more"]


@pytest.mark.parametrize("section", ADDITIONS)
def test_a_term_is_deleted(section: str) -> None:
    # The curriculum points at a reward; what points at nothing is a mistake.
    lines = ["~task.curriculum.near"] if section == "rewards" else []
    assert tree_of(f"~task.{section}.{FIRST[section]}", *lines)[section] == {}


@pytest.mark.parametrize("section", ADDITIONS)
def test_a_misspelled_term_is_not_added(section: str) -> None:
    name = FIRST[section]
    (problem,) = validate(compose(["task=mine", f"task.{section}.{name}x.func=f"]))
    assert problem.path == f"task.{section}.{name}x"
    assert f"Did you mean '{name}'?" in str(problem)


def test_values_that_derive_from_an_overridden_one_follow_it() -> None:
    before, after = tree_of(), tree_of("task.extensions.reach=0.7")
    for section, (name, path) in DERIVED.items():
        assert at(before[section][name], path) == 0.1, section
        assert at(after[section][name], path) == 0.7, section


def test_the_environment_is_built_of_it() -> None:
    overrides = [f"+task.{section}.more={ADDITIONS[section]}" for section in ADDITIONS]
    overrides += ["task.extensions.reach=0.3", "~task.terminations.near", "seed=1"]
    overrides.remove(f"+task.actions.more={ADDITIONS['actions']}")
    env = embodichain.make("mine", num_envs=2, overrides=overrides)
    try:
        obs, _ = env.reset()
        assert env.reach == 0.3
        assert {name: list(manager.terms) for name, manager in env.managers.items()} == {
            "actions": ["arm"],
            "events": ["move", "more"],
            "commands": ["goal", "more"],
            "observations": ["ball", "more"],
            "rewards": ["near", "more"],
            "terminations": ["more"],
            "metrics": ["near", "more"],
            "curriculum": ["near", "more"],
        }
        assert env.observation_manager.columns() == {"ball": 16, "more": 12}
        goal = env.command_manager.values("goal") - [0, -1, 1, 0, 0, 0]
        assert 0.1 < goal.max() < 0.3
        info = env.step(env.rand("a", (6,), -1, 1))[4]
        assert info["curriculum"] == {"near": pytest.approx(0.3), "more": 0.3}
    finally:
        env.close()
