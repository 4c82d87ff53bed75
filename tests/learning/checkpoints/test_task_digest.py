"""What a checkpoint says of its task: it is the config's alone, for every shipped task."""

import json

import pytest

from embodichain.config import list_options, make
from embodichain.config.environments.factory import make_env
from embodichain.config.resolved import compile_scene_of, resolve
from embodichain.lab.gym.envs.base_env import BaseEnv
from embodichain.learning.checkpoints.task_digest import TaskDigest

pytestmark = pytest.mark.slow

LEARNABLE = [task for task in list_options("task") if task != "random_reach"]
"""It declares no observations."""


def digest(task: str, num_envs: int, *overrides: str) -> TaskDigest:
    return digest_of(make(task, num_envs, overrides))


def digest_of(env: BaseEnv, *, play: int = 0) -> TaskDigest:
    """The digest of a task in an environment, after some steps; closes it."""
    try:
        env.reset()
        for _ in range(play):
            env.step(env.rand("test", env.single_action_space.shape, -0.1, 0.1))
        return TaskDigest.of(env)
    finally:
        env.close()


@pytest.mark.parametrize(
    "task",
    [pytest.param(t, marks=[pytest.mark.unmeasured] if t != "reach" else []) for t in LEARNABLE],
)
def test_neither_number_nor_seed_nor_what_was_played_counts(task: str) -> None:
    one = resolve([f"task={task}", "num_envs=1", "seed=0"])
    many = one.changed(num_envs=3, seed=7)
    scene = compile_scene_of(one)
    first = digest_of(make_env(one, compiled_scene=scene))
    second = digest_of(make_env(many, compiled_scene=scene), play=4)
    assert first.changes(second) == []
    read = TaskDigest.from_json(first.to_json())
    assert read is not None
    assert read.changes(first) == []


def test_terms_that_came_or_went_are_one_line_each() -> None:
    before = digest("reach", 1)
    now = digest(
        "reach", 1, "~task.observations.qvel", "+task.observations.more={func: last_action}"
    )
    changes = {str(change) for change in before.changes(now)}
    assert "task.observations.qvel joint_velocity -> none" in changes
    assert "task.observations.more none -> last_action" in changes
    assert sum(line.startswith("task.observations.qvel") for line in changes) == 1
    assert all(change.refused for change in before.changes(now))


def without(digest: TaskDigest, *, whole: bool) -> TaskDigest:
    """The digest of a version whose `joint_action` had no parameter `bounds`.

    Args:
        digest: A digest of this version.
        whole: Whether that version said which parameters there were.
    """
    parts = json.loads(digest.to_json())
    arm = parts["actions"]["arm"]
    del arm["params"]["bounds"], arm["takes"]["bounds"]
    if not whole:
        for section in parts.values():
            for term in section.values() if isinstance(section, dict) else ():
                if isinstance(term, dict):
                    term.pop("takes", None)
    read = TaskDigest.from_json(json.dumps(parts))
    assert read is not None
    return read


def test_digests_of_before_name_references_as_embodichain_does() -> None:
    now = digest("reach", 1)
    words = {"of": "entity_cfg", "from": "source_entity_cfg", "to": "target_entity_cfg"}
    parts = json.loads(now.to_json())
    for section in ("actions", "events", "rewards", "terminations"):
        for term in parts.get(section, {}).values():
            for part in ("params", "takes") if isinstance(term, dict) else ():
                term[part] = {words.get(k, k): v for k, v in term.get(part, {}).items()}
    assert "entity_cfg" in parts["actions"]["arm"]["params"]
    before = TaskDigest.from_json(json.dumps(parts))
    assert before is not None
    assert before.changes(now) == []
    assert now.changes(before) == []


def test_a_parameter_that_a_term_gained() -> None:
    now = digest("reach", 1)
    unbounded = ("~task.actions.arm.params.clip", "+task.actions.arm.params.bounds=null")
    other = digest("reach", 1, *unbounded)
    name = "task.actions.arm.params.bounds"
    assert without(now, whole=True).changes(now) == []
    # Given, or there before: a change of the action.
    assert [str(c) for c in now.changes(other) if c.name == name] == [f"{name} clip -> none"]
    assert all(c.refused for c in other.changes(now))
    assert [str(c) for c in other.changes(now) if c.name == name] == [f"{name} none -> clip"]
    # Older checkpoints do not say whether it was there: a warning.
    (told,) = without(now, whole=False).changes(now)
    assert str(told) == f"{name} none -> clip"
    assert not told.refused


def test_places_and_objects_are_named() -> None:
    before = digest("push_cube", 1)
    heavier = digest("push_cube", 1, "task.objects.cube.attrs.mass=3")
    assert "body cube: mass 2 -> 3" in {str(change) for change in before.changes(heavier)}
    aside = digest("push_cube", 1, "task.objects.cube.init_pos=[0.6,0.2,0.05]")
    assert "initial qpos of cube/free[1] 0.12 -> 0.2" in map(str, before.changes(aside))
    red = digest("push_cube", 1, "task.objects.cube.shape.visual_material.base_color=[1,0,0,1]")
    assert before.changes(red) == []


def test_another_format_is_no_digest() -> None:
    text = digest("reach", 1).to_json()
    assert TaskDigest.from_json(text.replace('"format":1', '"format":2')) is None
    with pytest.raises(ValueError, match="JSON object"):
        TaskDigest.from_json("[]")
