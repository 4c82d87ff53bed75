"""A gym config takes the place of a task: composed with overrides, mistakes at its own lines."""

from pathlib import Path

import pytest

from embodichain.config import compose, dump_yaml, resolve, thaw, validate_file
from embodichain.config.composition.gym_config import load_gym_config, override_of
from embodichain.config.file_validation import notes_on_file
from embodichain.utils.errors import ConfigError

CONFIGS = Path(__file__).parents[2] / "helpers" / "gym_configs"
SMALL = """\
id: EmbodiedEnv-v1
num_envs: 3
robot:
  uid: cart
  fpath: CartPole/cart_pole.urdf
rigid_object:
  - uid: cube
    attrs: {mass: 1.0}
env:
  rewards:
    done: {func: success_reward, weight: 2.0}
"""


def small(folder: Path, text: str = SMALL, name: str = "gym.yaml") -> str:
    (folder / name).write_text(text)
    return override_of(str(folder / name))


def test_overrides_change_what_was_converted(tmp_path: Path) -> None:
    lines = [small(tmp_path), "task.rewards.done.weight=5", "~task.objects.cube", "num_envs=2"]
    resolved = resolve(lines)
    assert resolved.task_name == "gym"
    assert resolved.tree["task"]["rewards"]["done"]["weight"] == 5
    assert resolved.tree["task"]["objects"] == {}
    assert resolved.tree["num_envs"] == 2
    assert resolve([small(tmp_path)]).tree["num_envs"] == 3  # the file suggests


def test_an_experiment_goes_over_the_file(tmp_path: Path) -> None:
    (tmp_path / "experiment").mkdir()
    text = "# @package _global_\ntask: {max_episode_steps: 9}\n"
    (tmp_path / "experiment" / "short.yaml").write_text(text)
    resolved = resolve([small(tmp_path), "experiment=short"], config_dir=tmp_path)
    assert resolved.tree["task"]["max_episode_steps"] == 9
    assert resolved.tree["task"]["robot"]["uid"] == "cart"


@pytest.mark.parametrize(
    ("old", "new", "line", "words"),
    [
        ("mass: 1.0", "mass: heavy", 8, "task.objects.cube.attrs.mass: expected a number"),
        ("cart_pole.urdf", "none.urdf", 5, "task.robot.fpath"),
        ("success_reward", "succes_reward", 11, "Did you mean 'success_reward'?"),
        ("weight: 2.0", "weigth: 2.0", 11, "env.rewards.done.weigth: unknown key"),
        ("num_envs: 3", "num_env: 3", 2, "Did you mean 'num_envs'?"),
        ("num_envs: 3", "num_envs: 0", 2, "task.suggested.run.num_envs: must be at least 1"),
    ],
)
def test_mistakes_have_the_line_of_the_gym_config(
    old: str, new: str, line: int, words: str, tmp_path: Path
) -> None:
    small(tmp_path, SMALL.replace(old, new))
    found = [str(p) for p in validate_file(tmp_path / "gym.yaml")]
    assert found
    assert all(f"gym.yaml:{line}: " in text for text in found)
    assert any(words in text for text in found)


def test_json_with_tabs_has_lines_too(tmp_path: Path) -> None:
    text = (
        '{\n\t"env": {},\n\t"rigid_object": [\n\t\t{"uid": "a",\n\t\t "attrs": {"mass": "x"}}]\n}'
    )
    small(tmp_path, text, "gym.json")
    (problem,) = validate_file(tmp_path / "gym.json")
    assert problem.source.endswith("gym.json:5")


def test_task_and_gym_config_exclude_each_other(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="either a gym config or a task: task=reach"):
        resolve([small(tmp_path), "task=reach"])


def test_file_that_is_not_there_is_one_mistake() -> None:
    with pytest.raises(ConfigError) as caught:
        resolve(["gym_config=none.yaml"])
    assert [str(p) for p in caught.value.problems] == ["no such file: none.yaml"]


def test_path_with_every_kind_of_sign(tmp_path: Path) -> None:
    folder = tmp_path / "a, (b)='c' {d}"
    folder.mkdir()
    assert resolve([small(folder)]).tree["task"]["robot"]["uid"] == "cart"


def test_notes_are_kept_in_the_order_of_the_file() -> None:
    notes = load_gym_config(CONFIGS / "everything.yaml").notes
    lines = [int(note.source.rpartition(":")[2]) for note in notes]
    assert lines == sorted(lines)
    assert len(lines) > 20
    assert notes_on_file(CONFIGS / "everything.yaml") == notes
    assert compose([override_of(str(CONFIGS / "everything.yaml"))]).notes == notes


def test_written_task_is_the_same_task(tmp_path: Path) -> None:
    gym = load_gym_config(CONFIGS / "cart_pole.json")
    (tmp_path / "task").mkdir()
    (tmp_path / "task" / "mine.yaml").write_text(dump_yaml(gym.task))
    direct = thaw(resolve([override_of(str(CONFIGS / "cart_pole.json")), "seed=1"]).tree)
    written = thaw(resolve(["task=mine", "seed=1"], config_dir=tmp_path).tree)
    assert direct["task"] == written["task"]
    assert direct | {"gym_config": None} == written
