"""The policy `expert` in the verbs, and the section in what is recorded and compared."""

import json

import pytest
import yaml

from embodichain.cli import main
from embodichain.config.environments.factory import make_env
from embodichain.config.resolved import resolve
from embodichain.learning.checkpoints.task_digest import TaskDigest
from embodichain.utils.errors import ConfigError

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]

SHORT = ("num_envs=4", "episodes=1", "seed=3", "record=none")


def test_a_run_counts_the_successes_of_the_expert(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    words = [
        "task=press_button",
        "policy=expert",
        "task.max_episode_steps=75",
        *SHORT,
        "episodes=1",
    ]
    assert main(["run", *words, "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["policy"] == "expert"
    assert (summary["episodes"], summary["success_rate"]) == (4, 1.0)
    config = yaml.safe_load((tmp_path / "outputs" / "latest" / "config.yaml").read_text())
    assert config["task"]["expert"][0] == "close"
    assert config["task"]["expert"][1]["press"]["of"] == "button/cap"
    assert main(["eval", str(tmp_path / "outputs" / "latest"), "--json"]) != 0  # no checkpoint


def test_a_run_says_why_episodes_failed(tmp_path, monkeypatch, capsys):
    """In the terminal, in `summary.json` and in `run.log`."""
    monkeypatch.chdir(tmp_path)
    steps = "task.expert=[{grasp: {of: cube, offset: [0, 0, 0.09]}}, {lift: 0.1}]"
    words = ["task=pick_place", "policy=expert", "task.max_episode_steps=90", steps, *SHORT]
    step, why = "step 1, grasp cube", "the fingers closed on nothing"
    assert main(["run", *words]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert f"failed in: {step} 4" in printed and f"for instance {why}" in printed
    folder = tmp_path / "outputs" / "latest"
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["failed_in"] == {step: 4}
    assert summary["failed_for"] == {step: f"{step}: {why}"}
    log = (folder / "run.log").read_text()
    for env in range(4):
        assert f"episode 0 of environment {env} failed: {step}: {why}" in log
    done = ["task=pick_place", "policy=expert", "task.max_episode_steps=90"]
    assert main(["run", *done, "task.expert=[{lift: 0.1}]", *SHORT, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["failed_in"] == {"done, but no success": 4}
    short = [*done[:2], "task.max_episode_steps=20"]
    assert main(["run", *short, *SHORT, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["failed_in"] == {"ran out of time": 4}
    assert main(["run", *short[:1], *short[2:], "policy=zero", *SHORT, "--json"]) == 0
    assert "failed_in" not in json.loads(capsys.readouterr().out)  # it plans nothing


def test_episodes_of_a_run_begin_with_the_first_step(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    words = ["task=press_button", "policy=expert", "task.max_episode_steps=75", "episodes=3"]
    assert main(["run", *words, "num_envs=2", "seed=3", "record=none", "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert (summary["episodes"], summary["success_rate"]) == (6, 1.0)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["task=cart_pole"], "policy: the task has no section `expert`"),
        (["task=pick_place", "task.expert=[{grasp: cub}]"], "Did you mean 'cube'?"),
        (["task=pick_place", "task.expert=[{grab: cube}]"], "task.expert.0.grab: unknown step"),
        (["task=pick_place", "task.expert=3"], "task.expert: expected"),
    ],
)
def test_mistakes_end_with_code_2(words, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["validate", *words, "policy=expert"]) == 2
    printed = capsys.readouterr()
    assert said in printed.out + printed.err
    assert not (tmp_path / "outputs").exists()


def test_the_policy_takes_no_steps_from_yaml():
    with pytest.raises(ConfigError, match="steps"):
        resolve(["task=push_cube", "policy={func: expert, params: {step: 3}}"], "run")


def test_other_steps_are_the_same_task_to_a_trained_policy():
    digests = []
    for steps in ("[close]", "[{lift: 0.1}]", "null"):
        env = make_env(resolve(["task=press_button", f"task.expert={steps}", "num_envs=1"], "run"))
        digests.append(TaskDigest.of(env))
        env.close()
    assert digests[0].changes(digests[1]) == digests[0].changes(digests[2]) == []


def test_show_task_lists_the_steps(capsys):
    assert main(["show", "task=press_button", "--json"]) == 0
    tables = json.loads(capsys.readouterr().out)
    assert [row["step"] for row in tables["expert"]] == ["close", "press"]
    assert tables["expert"][1]["path"] == "expert.1.press"
