"""The policies that ship: whole, of their tasks as they are now, and as good as they say."""

import hashlib
import json
import re
import zipfile
from contextlib import closing

import pytest

from embodichain.cli import main
from embodichain.config import make_env, resolve
from embodichain.data.pretrained import pretrained, pretrained_tasks
from embodichain.learning.policies.policy import load_policy
from embodichain.utils.errors import ConfigError
from scripts.make_policies import RECIPES

TASKS = pretrained_tasks()
AGAIN = "python scripts/make_policies.py"


def test_there_are_policies_and_both_files_of_each():
    assert set(TASKS) == set(RECIPES)
    folder = pretrained("reach").file.parent
    assert {p.name for p in folder.iterdir()} == {f"{t}.{s}" for t in TASKS for s in ("pt", "json")}


@pytest.mark.parametrize("task", TASKS)
def test_it_is_small_and_whole_and_says_how_it_was_made(task):
    about = pretrained(task)
    data = about.file.read_bytes()
    assert hashlib.sha256(data).hexdigest() == about.sha256
    assert len(data) < 200_000
    assert re.fullmatch(rf"embodichain train task={task} seed=\d+", about.command)
    assert re.fullmatch(r"[0-9a-f]{40}", about.commit)
    low, high = about.interval
    assert 0.85 < low <= about.success <= high and about.episodes >= 500
    with zipfile.ZipFile(about.file) as archive:  # no path of the machine that made it
        names = archive.namelist()
        assert not any(b"site-packages" in archive.read(name) for name in names)
        assert not [name for name in names if "serialization_id" in name]  # made again, the same
    assert json.loads(about.to_json())["interval"] == [low, high]


@pytest.mark.parametrize("task", TASKS)
def test_it_is_of_the_task_as_it_is_now(task):
    """A policy is refused in a task that has changed: make it again then, with the script."""
    resolved = resolve([f"task={task}", "num_envs=1", "policy=pretrained", "record=none"])
    assert resolved.tree["policy"] == str(pretrained(task).file)
    with closing(make_env(resolved)) as env:
        policy = load_policy(pretrained(task).file, env)
        assert policy.task == task, AGAIN
        assert [change for change in policy.changed if change.part != "mujoco"] == [], AGAIN


@pytest.mark.unmeasured
def test_it_succeeds(tmp_path, capsys):
    lines = ["task=reach", "episodes=32", "num_envs=32", "record=none", "seed=77", "--json"]
    assert main(["eval", "pretrained", *lines, f"output_dir={tmp_path}"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["success"]["rate"] >= 0.95 and found["policy"].endswith("reach.pt")


def test_a_task_without_one_is_the_users_mistake(capsys):
    with pytest.raises(ConfigError, match="no trained policy ships for task rech.*reach"):
        pretrained("rech")
    for words in (["policy=pretrained"], ["policy={func: pretrained}"]):
        assert main(["validate", "task=hold_still", *words]) == 2
        said = capsys.readouterr().err
        assert "policy: no trained policy ships for task hold_still; tasks with one: cart" in said
    assert main(["run", "task=reach", "policy=pretraind"]) == 2
    assert "Did you mean pretrained?" in capsys.readouterr().err.replace("'", "")
