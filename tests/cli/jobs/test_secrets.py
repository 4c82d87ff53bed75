"""A planted secret of the environment is in no byte of what commands leave, and in no message."""

import json
import shutil
from pathlib import Path

import pytest

import embodichain
from embodichain.cli import main
from embodichain.recording import open as open_log
from tests.helpers.inside import places_of

pytestmark = pytest.mark.slow

SECRET, ITEM, ROBOTS = "hunter2-PLANTED", "hunter3-PLANTED", "PLANTED-robots"
WORD = "PLANTED"
REACH = ("task=reach", "num_envs=2", "seed=1", "task.max_episode_steps=8", "sim.num_threads=1")
TEXT = ("task.description=for ${oc.env:MY_SECRET}", "policy=${oc.env:MY_POLICY}:zeros")
TRAINED = (*REACH, "algo.n_steps=8", "algo.batch_size=16", "eval.episodes=2", TEXT[0])
TAGS = 'wandb.tags="${oc.decode:${oc.env:MY_LIST}}"'


@pytest.fixture
def secrets(monkeypatch, tmp_path):
    """Plants secrets in the environment, with a policy and a robot that they name."""
    monkeypatch.setenv("MY_SECRET", SECRET)
    monkeypatch.setenv("MY_LIST", f"[{ITEM}, b]")
    monkeypatch.setenv("MY_POLICY", "a_policy_PLANTED")
    monkeypatch.setenv("MY_OUTPUT", "outputs_PLANTED")
    Path("a_policy_PLANTED.py").write_text(
        "def zeros(obs, env):\n    return env.action_space.sample() * 0\n"
    )
    monkeypatch.syspath_prepend(".")


def said(capsys, *arguments, code=0):
    """What a command printed, without a secret."""
    assert main([*arguments]) == code, capsys.readouterr().err
    streams = capsys.readouterr()
    text = streams.out + streams.err
    assert WORD not in text.replace("outputs_PLANTED", "")
    return text


def test_a_run_and_what_is_made_of_it(secrets, capsys, monkeypatch, tmp_path):
    run = tmp_path / "run"
    line = [*REACH, *TEXT, "max_steps=10", "scene_png=false", f"hydra.run.dir={run}"]
    said(capsys, "run", *line, "+hydra.job.env_set.OTHER=${oc.env:MY_SECRET}")
    assert "description: for ${oc.env:MY_SECRET}" in (run / "config.yaml").read_text()
    assert "${oc.env:MY_POLICY}:zeros" in (run / "summary.json").read_text()
    assert "${oc.env:MY_SECRET}" in (run / "overrides.yaml").read_text()
    for name in ("MY_SECRET", "MY_POLICY"):  # who reads needs no variable
        monkeypatch.delenv(name)
    with open_log(run / "rollout.mcap") as log:
        assert log.config["task"]["description"] == "for <env MY_SECRET>"
    for form in ("csv", "npz", "parquet", "hdf5", "lerobot", "rrd", "ros2"):
        said(capsys, "export", str(run), "--format", form, "-o", str(run / f"x.{form}"))
    said(capsys, "report", str(run))
    assert "&lt;env MY_SECRET&gt;" in (run / "report.html").read_text()
    assert "identical to the bit" in said(capsys, "replay", str(run), "--verify")
    said(capsys, "diff", str(run / "rollout.mcap"), str(run / "rollout.mcap"))
    assert places_of(WORD, run) == []


def test_a_training_and_what_follows(secrets, capsys, monkeypatch, tmp_path):
    run, later, judged = tmp_path / "run", tmp_path / "later", tmp_path / "judged"
    said(capsys, "train", *TRAINED, TAGS, "total_timesteps=32", f"hydra.run.dir={run}")
    more = (f"resume={run}", "total_timesteps=64", f"output_dir={later}")
    today = "MY_SECRET is taken from today's environment"
    assert said(capsys, "train", *more).count(today) == 1
    assert said(capsys, "eval", str(run), "episodes=2", f"output_dir={judged}").count(today) == 1
    said(capsys, "export", "policy", str(run))
    said(capsys, "report", str(run))
    table = said(capsys, "compare", str(run))
    assert "<envMY_SECRET>" in "".join(table.split())  # the column is folded
    assert places_of(WORD, tmp_path / "cwd") == ["the name a_policy_PLANTED.py"]
    for folder in (run, later, judged):
        assert places_of(WORD, folder) == []
    monkeypatch.delenv("MY_SECRET")
    for line in (["train", *more], ["eval", str(run), "episodes=2"]):
        unset = "task.description: MY_SECRET is not set in the environment"
        assert unset in said(capsys, *line, code=2)
    said(capsys, "export", "policy", str(run), "-o", str(tmp_path / "again.onnx"))


def test_a_sweep_goes_on_with_another_value(secrets, capsys, monkeypatch, tmp_path):
    """What a folder has is an interpolation, so another value makes no other job."""
    line = ["train", "-m", *TRAINED[:-1], "total_timesteps=16", f"hydra.sweep.dir={tmp_path}/all"]
    line += ["task.description='${oc.env:MY_SECRET}','${oc.env:MY_POLICY}'", "-q"]
    line.append("hydra/launcher=basic")
    said(capsys, *line)
    assert places_of(WORD, tmp_path / "all") == []
    monkeypatch.setenv("MY_SECRET", "another-PLANTED")
    before = (tmp_path / "all/0/summary.json").read_bytes()
    said(capsys, *line)
    assert (tmp_path / "all/0/summary.json").read_bytes() == before
    monkeypatch.setenv("MY_STEPS", "9")
    other = [*line, 'task.max_episode_steps="${oc.decode:${oc.env:MY_STEPS}}"']
    assert "task.max_episode_steps is 8 there, 9 here" in said(capsys, *other, code=2)


def test_what_is_in_the_model_is_listed(secrets, capsys, monkeypatch, tmp_path):
    robots = Path(embodichain.__file__).parent / "data/assets/UniversalRobots/UR10"
    shutil.copytree(robots, tmp_path / ROBOTS)
    monkeypatch.setenv("MY_ROBOTS", str(tmp_path / ROBOTS))
    monkeypatch.setenv("MY_NAME", "goal-PLANTED")
    keys = ("task.robot.fpath=${oc.env:MY_ROBOTS}/UR10.urdf", "max_steps=1", "scene_png=false")
    run = tmp_path / "run"
    text = said(capsys, "run", *REACH, *keys, f"hydra.run.dir={run}")
    kept = "task.robot.fpath holds the value of MY_ROBOTS: it is in the model and so in the log"
    assert text.count(kept) == 1
    assert kept in (run / "run.log").read_text()
    assert places_of(WORD, run) == ["rollout.mcap: model.mjb.zst unpacked"]


def test_an_output_folder_of_the_environment(secrets, capsys):
    """Its files lie there; what they hold does not say where."""
    keys = ("output_dir=${oc.env:MY_OUTPUT}/here", "max_steps=2", "scene_png=false")
    said(capsys, "run", *REACH, *keys)
    run = next(Path("outputs_PLANTED/here").glob("*/*/config.yaml")).parent
    summary = json.loads((run / "summary.json").read_text())
    assert summary["folder"].startswith("${oc.env:MY_OUTPUT}/here/")
    assert places_of(WORD, run) == []


def test_a_failure_hides_values(secrets, capsys, monkeypatch, tmp_path):
    monkeypatch.setenv("MY_POLICY", "no_policy_PLANTED")
    Path("no_policy_PLANTED.py").write_text(
        "import os\ndef zeros(obs, env):\n    raise OSError('no ' + os.environ['MY_SECRET'])\n"
    )
    run = tmp_path / "run"
    line = ["run", *REACH, *TEXT, "scene_png=false", f"hydra.run.dir={run}", "--traceback"]
    assert "OSError: no <env MY_SECRET>" in said(capsys, *line, code=1)
    assert "no <env MY_SECRET>" in json.loads((run / "summary.json").read_text())["error"]
    assert places_of(WORD, run) == []
    wrong = said(capsys, "run", *REACH, "max_steps=${oc.env:MY_SECRET}", code=2)
    assert "got '<env MY_SECRET>'" in wrong
    shown = said(capsys, "show", *REACH, *TEXT)
    assert "description: for ${oc.env:MY_SECRET}" in shown
