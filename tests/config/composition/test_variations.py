"""Variations: bundles of events, noise and delays with a strength, merged into any task."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import embodichain
from embodichain.cli import main
from embodichain.config.composition.composed import compose, compose_variations, list_options
from embodichain.config.composition.variations import merge_variations
from embodichain.config.resolved import resolve
from embodichain.utils.errors import ConfigError

VARIATIONS = list_options("variation")
STEPS = 12
_MOVABLE = ["cube", "stand", "bowl", "mug", "bottle", "clutter_can", "clutter_mug", "clutter_ball"]


def _problems(*overrides: str, folder: Path | None = None) -> list[str]:
    with pytest.raises(ConfigError) as error:
        resolve([*overrides], config_dir=folder)
    return [str(problem) for problem in error.value.problems]


def _write(folder: Path, name: str, entries: Any, package: str | None = None) -> Path:
    """Write an option of the group `variation` into a user's folder."""
    file = folder / "variation" / f"{name}.yaml"
    file.parent.mkdir(parents=True, exist_ok=True)
    header = f"# @package {package or f'task.variations.{name}'}\n"
    file.write_text(header + yaml.safe_dump(entries))
    return folder


def _states(task: str, *overrides: str, num_envs: int = 3) -> np.ndarray:
    """(STEPS, N, nq + nv) states under random actions."""
    env = embodichain.make(task, num_envs=num_envs, overrides=list(overrides), seed=5)
    states = []
    try:
        env.reset(seed=5)
        env.action_space.seed(1)
        for _ in range(STEPS):
            env.step(env.action_space.sample())
            engine = env.sim.engine
            states.append(np.concatenate([engine.state("qpos"), engine.state("qvel")], axis=1))
    finally:
        env.close()
    return np.array(states)


def _model_field(name: str, *overrides: str, num_envs: int = 4) -> np.ndarray:
    """(N, ...) a model field of `push_cube` after a reset."""
    env = embodichain.make("push_cube", num_envs=num_envs, overrides=list(overrides), seed=5)
    try:
        env.reset(seed=5)
        return np.array(env.sim.engine.model_field(name))
    finally:
        env.close()


@pytest.fixture(scope="module")
def plain_states() -> np.ndarray:
    """The states of `push_cube` without variations."""
    return _states("push_cube")


@pytest.mark.parametrize("variation", VARIATIONS)
def test_strength_0_changes_no_bit_of_the_physics(variation: str, plain_states: np.ndarray) -> None:
    weak = f"task.variations.{variation}.strength=0"
    varied = _states("push_cube", f"variation=[{variation}]", weak)
    np.testing.assert_array_equal(varied, plain_states)


def test_variations_of_a_walking_robot_change_nothing_at_strength_0() -> None:
    chosen = ["friction", "mass", "pushes", "delay"]
    weak = [f"task.variations.{name}.strength=0" for name in chosen]
    varied = _states("quadruped_velocity", f"variation=[{','.join(chosen)}]", *weak)
    np.testing.assert_array_equal(varied, _states("quadruped_velocity"))


@pytest.mark.parametrize("variation", ["friction", "mass", "delay", "noise"])
def test_a_variation_changes_the_physics(variation: str, plain_states: np.ndarray) -> None:
    assert (_states("push_cube", f"variation=[{variation}]") != plain_states).any()


@pytest.mark.parametrize("name", ["geom_friction", "body_mass"])
def test_strength_acts_on_factors_geometrically(name: str) -> None:
    variation = {"geom_friction": "friction", "body_mass": "mass"}[name]
    chosen = f"variation=[{variation}]"
    default = _model_field(name)
    drawn = _model_field(name, chosen)
    half = _model_field(name, chosen, f"task.variations.{variation}.strength=0.5")
    changed = drawn != default
    assert changed.any()
    expected = default[changed] * np.sqrt(drawn[changed] / default[changed])
    np.testing.assert_allclose(half[changed], expected, rtol=1e-12)
    np.testing.assert_array_equal(half[~changed], default[~changed])


def test_strength_acts_on_offsets_and_values_linearly(tmp_path: Path) -> None:
    event = {"func": "randomize", "params": {"of": {"uid": "cube"}, "mass": [1.0, 3.0]}}
    folder = _write(tmp_path, "heavy", {"events": {"mass": event}})
    masses = []
    for strength in (0.0, 0.5, 1.0):
        overrides = ["variation=[heavy]", f"task.variations.heavy.strength={strength}"]
        env = embodichain.make(
            "push_cube", num_envs=4, overrides=overrides, seed=5, config_dir=folder
        )
        env.reset(seed=5)
        masses.append(np.array(env.sim.engine.model_field("body_mass")))
        env.close()
    default, half, drawn = masses
    assert (drawn != default).any()
    np.testing.assert_allclose(half, default + 0.5 * (drawn - default), rtol=1e-12)


def test_environment_i_is_varied_alike_in_any_batch() -> None:
    chosen = "variation=[friction,mass]"
    many = _model_field("body_mass", chosen, num_envs=4)
    few = _model_field("body_mass", chosen, num_envs=2)
    np.testing.assert_array_equal(many[:2], few)


def test_variations_become_parts_of_the_task() -> None:
    chosen = ["friction", "noise", "delay"]
    composed = compose(["task=push_cube", f"variation=[{','.join(chosen)}]"])
    task = composed.tree["task"]
    assert "variations" not in task
    assert task["events"]["friction_cube"]["params"]["of"] == {"uid": "cube"}
    assert all(term["noise"] == {"std": 0.01} for term in task["observations"].values())
    assert all(term["delay"] == [0, 2] for term in task["actions"].values())
    source = composed.source("task.events.friction_cube.params.friction")
    assert "variation/friction.yaml" in source


def test_noise_and_delay_are_weakened() -> None:
    overrides = ["variation=[noise,delay]", "task.variations.noise.strength=0.5"]
    tree = compose(["task=push_cube", *overrides, "task.variations.delay.strength=0.5"]).tree
    arm = next(iter(tree["task"]["actions"].values()))
    assert arm["delay"] == [0, 1]
    assert arm["noise"] == {"std": 0.01}


def test_a_task_may_have_variations_of_its_own(tmp_path: Path) -> None:
    folder = tmp_path / "task"
    folder.mkdir()
    (folder / "slippery.yaml").write_text(
        "defaults:\n  - push_cube\n  - /variation@variations.friction: friction\n  - _self_\n"
        "variations: {friction: {strength: 0.5}}\n"
    )
    tree = compose(["task=slippery"], config_dir=tmp_path).tree
    assert tree["task"]["events"]["friction_cube"]["strength"] == 0.5
    removed = compose(["task=slippery", "~task.variations.friction"], config_dir=tmp_path).tree
    assert "friction_cube" not in removed["task"].get("events", {})


@pytest.mark.parametrize(
    ("entries", "expected"),
    [
        (
            {"strength": 2, "events": {}},
            "task.variations.mine.strength: must be within [0, 1], got 2",
        ),
        (
            {"strength": "full", "events": {}},
            "task.variations.mine.strength: expected a number, got 'full'",
        ),
        (
            {"strenght": 1},
            "unknown key; allowed: description, strength, needs, objects, events",
        ),
        ({"events": []}, "task.variations.mine.events: expected a map, got []"),
        (
            {"events": {"a": {"func": "randomize", "for_each": "object"}}},
            "for_each: expected one of objects,",
        ),
        ({"observations": {"qpoz": {"noise": {"std": 1}}}}, "the task has no such term"),
        ({"actions": {"each": {"clip": [0, 1]}}}, "unknown key; allowed: noise, delay"),
        (
            {"strength": 0.5, "events": {"a": {"func": "reset_joints_by_offset", "params": {}}}},
            "reset_joints_by_offset draws nothing that has a default",
        ),
        (
            {"strength": 0.5, "actions": {"each": {"noise": {"std": 1, "operation": "abs"}}}},
            "operation: abs replaces the value",
        ),
    ],
)
def test_a_mistake_in_a_variation_is_reported_once_with_its_place(
    tmp_path: Path, entries: Any, expected: str
) -> None:
    folder = _write(tmp_path, "mine", entries)
    problems = _problems("task=push_cube", "variation=[mine]", folder=folder)
    matching = [problem for problem in problems if expected in problem]
    assert len(matching) == 1, problems
    assert "mine.yaml:" in matching[0]


@pytest.mark.parametrize(("strength", "count"), [(1, 4), (0.5, 2), (0, 0)])
def test_clutter_adds_as_many_things_as_its_strength_says(strength: float, count: int) -> None:
    overrides = ["variation=[clutter]", f"task.variations.clutter.strength={strength}"]
    task = compose(["task=pick_place", *overrides]).tree["task"]
    things = [name for name in task["objects"] if name.startswith("clutter_")]
    assert len(things) == count
    event = task["events"].get("clutter", {"params": {"objects": {}}})
    assert list(event["params"]["objects"]) == things


def test_clutter_is_placed_beside_the_things_of_the_task() -> None:
    env = embodichain.make("clutter_pick", num_envs=4, overrides=["variation=[clutter]"], seed=2)
    try:
        env.reset(seed=2)
        places = [env.sim.get_rigid_object(uid).get_local_pose()[:, :2] for uid in _MOVABLE]
    finally:
        env.close()
    for i, place in enumerate(places):
        for other in places[i + 1 :]:
            assert ((place - other).norm(dim=1) > 0.03).all()


def test_clutter_without_a_table_is_noted() -> None:
    (note,) = compose(["task=reach", "variation=[clutter]"]).notes
    assert "changes nothing: this task has no table" in note.message


def test_an_unknown_variation_is_named_with_the_closest_one() -> None:
    (problem,) = _problems("task=push_cube", "variation=[frictoin]")
    assert "frictoin" in problem
    assert "Did you mean 'friction'?" in problem


@pytest.mark.parametrize("strength", [0, 0.5, 1])
def test_a_strength_of_a_variation_that_is_not_chosen_is_a_mistake(strength: float) -> None:
    overrides = ["variation=[friction]", f"task.variations.frction.strength={strength}"]
    (problem,) = _problems("task=push_cube", *overrides)
    assert "no such variation is chosen; chosen: friction. Did you mean 'friction'?" in problem


def test_an_experiment_that_chooses_variations_needs_override(tmp_path: Path) -> None:
    folder = tmp_path / "experiment"
    folder.mkdir()
    header = "# @package _global_\ndefaults:\n  - override /task: push_cube\n"
    (folder / "wrong.yaml").write_text(header + "  - /variation: [friction, lighting]\n")
    (folder / "right.yaml").write_text(header + "  - override /variation: [friction, lighting]\n")
    with pytest.raises(ConfigError, match=r"wrong.yaml:4: .*write `override /variation: "):
        resolve(["task=push_cube", "experiment=wrong"], config_dir=tmp_path)
    tree = compose(["task=push_cube", "experiment=right"], config_dir=tmp_path).tree
    assert "friction_cube" in tree["task"]["events"]


def test_two_variations_that_set_one_field_are_one_mistake(tmp_path: Path) -> None:
    event = {"func": "randomize", "params": {"of": {"uid": "cube"}, "friction": [0.1, 1.0]}}
    folder = _write(tmp_path, "ice", {"events": {"ice": event}})
    (problem,) = _problems("task=push_cube", "variation=[friction,ice]", folder=folder)
    assert "sets friction of cube, as the event 'friction_cube' does" in problem
    assert "variation/friction.yaml:" in problem
    assert "ice.yaml:" in problem


def test_another_name_of_a_term_is_the_same_field(tmp_path: Path) -> None:
    params = {"entity_cfg": {"uid": "cube"}, "mass_range": [0.1, 1.0]}
    event = {"func": "randomize_rigid_object_mass", "params": params}
    folder = _write(tmp_path, "light", {"events": {"light": event}})
    (problem,) = _problems("task=push_cube", "variation=[mass,light]", folder=folder)
    assert "sets mass of cube, as the event 'mass_cube' does" in problem


def test_a_variation_and_the_task_that_set_one_field_are_a_mistake(tmp_path: Path) -> None:
    event = "{func: randomize, params: {of: {uid: cube}, friction: [1, 2]}}"
    overrides = ["task=push_cube", "variation=[friction]", f"+task.events.grip={event}"]
    (problem,) = _problems(*overrides)
    assert "as the event 'grip' does (command line)" in problem
    assert "~task.events.grip" in problem


def test_two_variations_that_give_noise_to_one_term_are_a_mistake(tmp_path: Path) -> None:
    folder = _write(tmp_path, "shaky", {"actions": {"each": {"noise": {"std": 0.1}}}})
    (problem,) = _problems("task=push_cube", "variation=[noise,shaky]", folder=folder)
    assert "is set already" in problem
    assert "variation/noise.yaml:" in problem


def test_noise_of_the_task_stays_and_is_noted() -> None:
    notes = compose(["task=quadruped_velocity", "variation=[noise]"]).notes
    assert ["gravity" in note.message for note in notes] == [True]


def test_a_variation_without_effect_is_noted() -> None:
    notes = compose(["task=cart_pole", "variation=[camera_pose]"]).notes
    assert [note.path for note in notes] == ["task.variations.camera_pose"]


@pytest.fixture(scope="module")
def entries() -> dict[str, Any]:
    """Every variation, as it is at its place in a task."""
    return compose_variations([f"variation=[{','.join(VARIATIONS)}]"]).entries


@pytest.mark.parametrize("task", list_options("task"))
def test_every_variation_can_be_merged_into_every_task(task: str, entries: dict[str, Any]) -> None:
    composed = compose([f"task={task}"])
    for variation in VARIATIONS:
        chosen = {"variations": {variation: entries[variation]}}
        tree = {**composed.tree, "task": {**composed.tree["task"], **chosen}}
        merged = merge_variations(tree, composed.source)
        assert [p for p in merged.problems if "set" not in p.message] == [], variation


def test_a_varied_run_replays_and_repeats(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    words = ["task=push_cube", "variation=[friction,mass,delay]", "num_envs=2", "max_steps=20"]
    assert main(["run", *words, "seed=3", "scene_png=false", "quiet=true"]) == 0
    assert main(["replay", "last", "--verify"]) == 0
    (config,) = tmp_path.glob("outputs/*/*/config.yaml")
    task = yaml.safe_load(config.read_text())["task"]
    assert "variations" not in task
    assert task["events"]["mass_cube"]["params"]["mass"] == [0.5, 2.0]


@pytest.mark.parametrize(
    ("text", "path", "hint"),
    [
        ("description: Mine.\n", "variation", ""),
        ("", "variation", ""),
        ("# @package task.variation.mine\ndescription: Mine.\n", "task.variation.mine", "Did"),
        ("# @package task.variations\ndescription: Mine.\n", "task.variations", ""),
        ("# @package _global_\ndescription: Mine.\n", "variation", ""),
    ],
)
def test_a_file_without_the_place_of_a_variation(
    empty_cwd: Path, text: str, path: str, hint: str
) -> None:
    file = Path("conf/variation/mine.yaml")
    file.parent.mkdir(parents=True)
    file.write_text(text)
    told = _problems("task=reach", "variation=mine")[0]
    line = "its first line must be `# @package task.variations.mine`"
    assert told.startswith(f"conf/variation/mine.yaml: {path}: {line}")
    assert ("Did you mean 'task.variations'?" in told) == bool(hint)
