"""A sweep that is started again: what is finished is skipped, what was interrupted continues."""

import fcntl
import json
import os
import platform
import shutil
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from embodichain.cli import main
from tests.helpers.commands import Commands
from tests.helpers.sweeps import TINY, learned, results, summary

pytestmark = pytest.mark.slow

STEPS = ("total_timesteps=160", "checkpoint.every_steps=32")


def sweep(folder: Path, *more: str) -> int:
    launcher = [] if any("launcher" in word for word in more) else ["hydra/launcher=basic"]
    where = [f"output_dir={folder}", f"hydra.sweep.dir={folder}/s"]
    return main(["train", "-m", *TINY, *STEPS, *launcher, *where, *more])


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sweep over two seeds that nothing interrupted."""
    folder = tmp_path_factory.mktemp("reference")
    assert sweep(folder, "seed=0,1", "--quiet") == 0
    return folder / "s"


@pytest.fixture
def copied(reference: Path, tmp_path: Path) -> Iterator[Path]:
    shutil.copytree(reference, tmp_path / "s")
    yield tmp_path
    assert results(tmp_path / "s/1") == results(reference / "1")


def killed_after(job: Path, steps: int) -> None:
    """Leave what a training has in its folder if it is killed later than at `steps`."""
    (job / "summary.json").unlink()
    for name in ("eval.json", "curves.png"):
        (job / name).unlink(missing_ok=True)
    for path in (job / "checkpoints").iterdir():
        number = path.name.partition(".")[0].removeprefix("step_")
        if not number.isdigit() or int(number) > steps:
            path.unlink()


def test_finished_jobs_are_skipped(copied: Path, capsys: pytest.CaptureFixture) -> None:
    before = {path: path.read_bytes() for path in copied.glob("s/*/checkpoints/*")}
    assert sweep(copied, "seed=0,1", "--json") == 0
    assert sweep(copied, "seed=0,1") == 0
    said = capsys.readouterr()
    assert [f"finished already: {copied}/s/{n}" in said.err for n in (0, 1)] == [True, True]
    assert {path: path.read_bytes() for path in copied.glob("s/*/checkpoints/*")} == before
    # The comparison at the end: two seeds are one line, with the number of each.
    (line,) = [line for line in said.out.splitlines() if line.lstrip().startswith("cart_pole")]
    assert line.count("(") >= 4 and f"{copied}/s/report.html" in said.err


def test_a_killed_job_goes_on_in_its_folder_to_the_bit(copied: Path, reference: Path) -> None:
    job = copied / "s/0"
    killed_after(job, 64)
    with (job / "progress.csv").open("a") as stream:
        stream.write("0.5,0.2")  # cut off by the kill
    assert sweep(copied, "seed=0,1", "--quiet") == 0
    assert summary(job)["resumed_from"] == str(job / "checkpoints/step_000000000064.zip")
    assert np.array_equal(learned(job), learned(reference / "0"))
    assert results(job) == results(reference / "0")
    steps = [
        _column(path / "progress.csv", "time/total_timesteps") for path in (job, reference / "0")
    ]
    assert steps[0] == steps[1] and steps[0][-1] == "160"
    assert not list(copied.glob("s/*earlier*"))


def test_a_job_killed_before_its_first_checkpoint_begins_again(
    copied: Path, reference: Path
) -> None:
    job = copied / "s/0"
    killed_after(job, 0)
    assert sweep(copied, "seed=0,1", "--quiet") == 0
    assert results(job) == results(reference / "0")
    assert (copied / "s/0.earlier-1/progress.csv").is_file()


def test_a_job_killed_in_its_evaluation_is_evaluated_again(copied: Path, reference: Path) -> None:
    job = copied / "s/0"
    before = (job / "checkpoints/final.zip").read_bytes()
    (job / "summary.json").write_text(json.dumps({**summary(job), "eval": None, "objective": None}))
    (job / "rollout.mcap").write_bytes(b"cut off")
    assert sweep(copied, "seed=0,1", "--quiet") == 0
    assert results(job) == results(reference / "0")
    assert (job / "checkpoints/final.zip").read_bytes() == before
    assert (job / "earlier-1/rollout.mcap").read_bytes() == b"cut off"


def test_another_job_in_a_folder_is_refused(copied: Path, capsys: pytest.CaptureFixture) -> None:
    assert sweep(copied, "seed=0,1", "algo.gamma=0.9") == 2
    said = capsys.readouterr().err
    assert "algo.gamma is" in said and "0.9 here. Give another hydra.sweep.dir" in said


def test_a_job_runs_only_once_at_a_time(copied: Path, capsys: pytest.CaptureFixture) -> None:
    with (copied / "s/.0.lock").open("a") as stream:
        fcntl.flock(stream, fcntl.LOCK_EX)
        assert sweep(copied, "seed=0,1") == 1
    whose = f"process {os.getpid()} on {platform.node()}"
    assert f"{copied}/s/0: another process runs this job now ({whose})" in capsys.readouterr().err


def test_a_failed_job_is_shown_and_the_others_are_named(
    copied: Path, reference: Path, capsys: pytest.CaptureFixture
) -> None:
    job = copied / "s/0"
    killed_after(job, 64)
    shutil.move(job / "progress.csv", job / "kept.csv")
    (job / "progress.csv").mkdir()  # the logger cannot write
    assert sweep(copied, "seed=0,1") == 1
    said = capsys.readouterr().err
    assert f"job 0 failed, the end of {copied}/s/0/run.log:" in said
    assert "Is a directory" in said
    again = f"the same command with hydra.sweep.dir={copied}/s does the rest"
    assert f"1 of 2 jobs are done: 1; not done: 0; {again}" in said
    (job / "progress.csv").rmdir()
    assert sweep(copied, "seed=0,1", "--quiet") == 0
    assert np.array_equal(learned(job), learned(reference / "0"))


@pytest.mark.unmeasured
def test_a_drawn_seed_is_kept(tmp_path: Path) -> None:
    search = ("algo.gamma=0.9,0.95", "total_timesteps=32", "eval.episodes=0", "--quiet")
    assert sweep(tmp_path, *search) == 0
    seeds = [summary(tmp_path / "s" / name)["seed"] for name in "01"]
    killed_after(tmp_path / "s/1", 0)
    assert sweep(tmp_path, *search) == 0
    assert [summary(tmp_path / "s" / name)["seed"] for name in "01"] == seeds
    assert (tmp_path / "s/1.earlier-1").is_dir()


def test_runs_are_skipped_or_begin_again(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    keys = ["task=cart_pole", "num_envs=1", "max_steps=5", "record=none", "scene_png=false"]
    where = [f"output_dir={tmp_path}", f"hydra.sweep.dir={tmp_path}/s", "hydra/launcher=basic"]
    assert main(["run", "-m", "seed=0,1", *keys, *where, "--quiet"]) == 0
    stopped = {**summary(tmp_path / "s/1"), "status": "interrupted"}
    (tmp_path / "s/1/summary.json").write_text(json.dumps(stopped))
    assert main(["run", "-m", "seed=0,1", *keys, *where]) == 0
    assert capsys.readouterr().err.count("finished already") == 1
    assert summary(tmp_path / "s/1")["status"] == "max_steps"
    assert summary(tmp_path / "s/1.earlier-1")["status"] == "interrupted"


@pytest.mark.unmeasured
def test_a_signal_to_a_sweep_saves_the_jobs_in_its_workers(
    commands: Commands, tmp_path: Path
) -> None:
    workers = ("hydra/launcher=joblib", "hydra.launcher.n_jobs=2", "hydra.launcher.pre_dispatch=2")
    keys = [*TINY, "seed=0,1,2", "total_timesteps=200_000", f"hydra.sweep.dir={tmp_path}/s"]
    process = commands.start("train", "-m", *workers, *keys)
    try:
        end = time.monotonic() + 200
        while len(list(tmp_path.glob("s/*/progress.csv"))) < 2:
            assert time.monotonic() < end and process.poll() is None, process.communicate()
            time.sleep(0.1)
        process.send_signal(signal.SIGTERM)  # this process alone
        _, said = process.communicate(timeout=100)
    finally:
        process.kill()
    assert process.returncode == 130, said
    assert "interrupted (SIGTERM); 0 of 3 jobs are done; not done: 0, 1; the same command" in said
    assert [summary(tmp_path / "s" / name)["status"] for name in "01"] == ["interrupted"] * 2
    assert not (tmp_path / "s/2/config.yaml").exists()


def _column(path: Path, name: str) -> list[str]:
    lines = [line.split(",") for line in path.read_text().splitlines()]
    return [row[lines[0].index(name)] for row in lines[1:]]
