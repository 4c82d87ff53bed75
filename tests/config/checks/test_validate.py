"""Everything shipped is right, files are checked where they lie, and checking stays light."""

import cProfile
import pstats
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from embodichain.config import claim, compose, list_options, resolve, validate, validate_file
from embodichain.config.composition.hydra_loader import CONFIG_MODULE
from embodichain.config.keys.check_types import check_types
from embodichain.config.resolved import write_record
from tests.config.conftest import GOOD, WriteTask

pytestmark = pytest.mark.slow

CONF = Path(sys.modules["embodichain"].__file__ or "").parent / CONFIG_MODULE.rpartition(".")[2]


@pytest.mark.parametrize("task", list_options("task"))
def test_every_task_is_right_in_a_training(task: str) -> None:
    """In a run: `test_every_file_is_right_where_it_lies`."""
    lines = [f"task={task}", "total_timesteps=100"]
    assert validate(compose(lines, "train"), "train") == []


@pytest.mark.parametrize("group", ["sim", "record", "viewer"])
def test_every_option_is_right(group: str) -> None:
    for option in list_options(group):
        assert validate(compose(["task=reach", f"{group}={option}"])) == [], option


@pytest.mark.parametrize("experiment", list_options("experiment"))
def test_every_experiment_is_right(experiment: str) -> None:
    assert validate(compose([f"experiment={experiment}"], "train"), "train") == []


@pytest.mark.parametrize(
    "file", sorted(CONF.glob("*/*.yaml")), ids=lambda f: f"{f.parent.name}/{f.stem}"
)
def test_every_file_is_right_where_it_lies(file: Path) -> None:
    found = [p for p in validate_file(file) if p.path != "total_timesteps"]
    assert found == []


def test_the_tutorial_fits_on_a_page() -> None:
    """In block style, one setting a line."""
    assert len((CONF / "task" / "random_reach.yaml").read_text().splitlines()) <= 60


def test_a_task_file_anywhere(empty_cwd: Path) -> None:
    Path("draft.yaml").write_text(GOOD)
    assert validate_file("draft.yaml") == []
    Path("draft.yaml").write_text(GOOD.replace("weight: 0.5", "weight: heavy"))
    assert [str(p) for p in validate_file("draft.yaml")] == [
        "draft.yaml:26: task.rewards.near.weight: expected a number, got 'heavy'"
    ]


def test_a_run_folders_config(write_task: WriteTask) -> None:
    write_task()
    folder = claim("outputs", "mine")
    write_record(folder, resolve(["task=mine", "seed=1"]))
    config = folder / "config.yaml"
    assert validate_file(config) == []
    tree = yaml.safe_load(config.read_text())
    tree["num_envs"] = 0
    config.write_text(yaml.safe_dump(tree))
    (problem,) = validate_file(config)
    assert problem.path == "num_envs"
    assert problem.message == "must be at least 1, got 0"
    assert problem.source.startswith(str(config))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (None, "no such file: it.yaml"),
        ("a: [1\n", "it.yaml:2: malformed YAML: did not find expected ',' or ']'"),
        ("- 1\n", "it.yaml:1: task: expected a map, got [1]"),
    ],
)
def test_files_that_are_no_config(text: str | None, says: str, empty_cwd: Path) -> None:
    if text is not None:
        Path("it.yaml").write_text(text)
    (problem,) = validate_file("it.yaml")
    assert str(problem).startswith(says)


@pytest.mark.unmeasured
def test_checking_needs_no_torch() -> None:
    code = (
        "import sys\n"
        "from embodichain.config import compose, validate\n"
        "assert validate(compose(['task=push_cube'])) == []\n"
        "print([m for m in ('torch._C', 'tensordict', 'stable_baselines3') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout == "[]\n", done.stderr


def calls_for(count: int) -> int:
    """Calls of Python until the report of so many unknown keys of a task."""
    tree = compose(["task=cart_pole"]).tree
    tree = {**tree, "task": {**tree["task"], **{f"unknown_{i}": i for i in range(count)}}}
    profile = cProfile.Profile()
    checked = profile.runcall(check_types, tree)
    assert len(checked.problems) == count
    calls: int = pstats.Stats(profile).total_calls  # type: ignore[attr-defined]
    return calls


def test_the_report_of_unknown_keys_costs_the_same_for_each() -> None:
    """20,000 of them took minutes: each was compared with each."""
    calls_for(10)
    assert calls_for(2000) < 2.2 * calls_for(1000)
