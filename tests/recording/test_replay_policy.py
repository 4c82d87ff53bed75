"""`replay --policy`: the recorded episodes once more, with another policy."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml

import embodichain
import embodichain.recording as recording
from embodichain.cli.app import call
from embodichain.cli.jobs.job import policy_of
from embodichain.config import make_env, resolve
from embodichain.config.resolved import dump_yaml
from embodichain.recording import McapRecorder, verify
from embodichain.utils.errors import ConfigError
from tests.recording.rewrite import rewrite

CONF = Path(embodichain.__file__).parent / "conf"
STEPS = 25


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    """A log of random actions in a task whose YAML was deleted since."""
    folder = tmp_path_factory.mktemp("conf") / "task"
    folder.mkdir()
    own = folder / "own_swing.yaml"
    shutil.copy(CONF / "task" / "cart_pole_swing_up.yaml", own)
    lines = ["task=own_swing", "num_envs=3", "seed=4", "task.max_episode_steps=10"]
    resolved = resolve([*lines, "policy=random"], config_dir=folder.parent)
    path = tmp_path_factory.mktemp("log") / "log.mcap"
    env = make_env(resolved)
    env.add_observer(McapRecorder(path, env, dump_yaml(resolved.tree), lines, task="own_swing"))
    policy = policy_of(resolved.root, env)
    obs, _ = env.reset()
    for _ in range(STEPS):
        obs, *_ = env.step(policy(obs, env))
    env.close()
    own.unlink()  # what is done with the log does not need it
    return path


def compared(path, capsys, *options):
    assert call(["replay", str(path), "--policy", *options, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_the_same_policy_gets_the_same_returns(path, capsys):
    found = compared(path, capsys, "random")
    with recording.open(path) as log:
        there = log.episodes
    assert found["same_start"]
    assert [(p["env"], p["episode"]) for p in found["pairs"]] == [(e.env, e.episode) for e in there]
    assert [p["cut"] for p in found["pairs"]] == [e.steps < 10 for e in there]
    assert all(p["difference"] == 0.0 and p["steps"] == p["recorded_steps"] for p in found["pairs"])
    assert found["mean_return"] == np.mean([e.total_reward for e in there])


def test_another_policy_begins_alike_and_ends_elsewhere(path, capsys):
    found = compared(path, capsys, "zero", "--env", "1", "--episode", "1")
    assert found["same_start"]
    (pair,) = found["pairs"]
    assert (pair["env"], pair["episode"]) == (1, 1)
    assert pair["difference"] == pair["total_return"] - pair["recorded_return"] != 0.0


def test_a_table_for_people(path, capsys):
    assert call(["replay", str(path), "--policy", "random", "--env", "0"]) == 0
    out = capsys.readouterr().out
    assert "recorded_return" in out and "mean return" in out


def test_nothing_that_a_log_names_is_imported(path, tmp_path, capsys):
    (tmp_path / "evil_module_of_a_log.py").write_text("raise SystemExit('it was imported')")

    def attachment(name, data):
        if name != "config.yaml":
            return data
        tree = yaml.safe_load(data)
        first = next(iter(tree["task"]["rewards"].values()))
        first["func"] = "evil_module_of_a_log:reward"
        return yaml.safe_dump(tree).encode()

    evil = rewrite(path, tmp_path / "evil.mcap", attachment=attachment)
    with pytest.raises(ConfigError, match="evil_module_of_a_log"):
        call(["replay", str(evil), "--policy", "zero"])


def test_what_cannot_be_compared(path, record):
    with pytest.raises(ConfigError, match="nothing to compare"):
        call(["replay", str(path), "--policy", "zero", "--episode", "7"])
    with pytest.raises(ConfigError, match="contains no config"):
        call(["replay", str(record()), "--policy", "zero"])


def test_one_environment_alone_verifies_with_any_number_of_threads(path):
    assert verify(path, num_threads=1).ok
    assert verify(path, num_threads=2).ok
    alone = verify(path, env=2)
    assert (alone.ok, alone.envs, alone.steps) == (True, 1, STEPS)
