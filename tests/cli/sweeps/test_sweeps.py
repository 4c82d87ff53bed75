"""Sweeps: workers, searches, and what is said without the packages they need."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from omegaconf import OmegaConf

from embodichain.cli import main
from embodichain.cli.sweeps.sweeping import points, towards_scores
from tests.helpers.commands import Commands

pytestmark = pytest.mark.slow

TINY = (
    *("task=cart_pole", "num_envs=4", "total_timesteps=64", "algo.n_steps=8", "algo.batch_size=16"),
    *("sim.num_threads=1", "eval.episodes=2", "record=none"),
)
WITHOUT_PLUGINS = """
import json, sys, types
plugins = types.ModuleType("hydra_plugins")
plugins.__path__ = []
sys.modules[plugins.__name__] = plugins
from embodichain.cli import main
for arguments in json.loads(sys.argv[1]):
    print(main(["train", "-m", *arguments]))
"""


def jobs(root: Path) -> dict[str, dict[str, object]]:
    """The summary of each job of the one sweep below `root`."""
    return {
        p.parent.name: json.loads(p.read_text()) for p in root.glob("sweeps/*/*/*/summary.json")
    }


def test_a_search_finds_the_best_of_its_trials(
    tmp_path: Path, capfd: pytest.CaptureFixture
) -> None:
    search = ("hydra/sweeper=optuna", "hydra.sweeper.n_trials=3", "hydra.sweeper.sampler.seed=1")
    space = ("algo.learning_rate=tag(log,interval(1e-4,1e-1))", "~task.metrics.success")
    arguments = (*TINY, "seed=3", *space, "hydra/launcher=basic", f"output_dir={tmp_path}")
    assert main(["train", "-m", *search, *arguments]) == 0
    found = jobs(tmp_path)
    assert sorted(found) == ["0", "1", "2"]
    best = max(summary["objective"] for summary in found.values())
    assert min(summary["objective"] for summary in found.values()) < best
    (path,) = tmp_path.glob("sweeps/*/*/optimization_results.yaml")
    results = OmegaConf.load(path)
    assert results.best_value == best
    said = capfd.readouterr().err
    assert f"best objective {best:.4g}: algo.learning_rate=" in said and str(path) in said


def test_jobs_in_workers_are_those_of_one_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture
) -> None:
    arguments = (*TINY, "seed=0,1", "--json")
    workers = ("hydra/launcher=joblib", "hydra.launcher.n_jobs=2")
    assert main(["train", "-m", *workers, *arguments, f"output_dir={tmp_path / 'many'}"]) == 0
    told = [json.loads(line)["seed"] for line in capfd.readouterr().out.splitlines()]
    assert sorted(told) == [0, 1]
    one_by_one = ("hydra/launcher=basic", *arguments)
    assert main(["train", "-m", *one_by_one, f"output_dir={tmp_path / 'one'}"]) == 0
    kept = ("seed", "env_steps", "mean_return", "objective")
    many, one = (
        {n: [s[k] for k in kept] for n, s in jobs(tmp_path / d).items()} for d in ("many", "one")
    )
    assert many == one and [s[0] for _, s in sorted(many.items())] == [0, 1]

    # Joblib keeps workers for later calls: those of the first sweep would search its ./conf.
    (tmp_path / "second/conf/task").mkdir(parents=True)
    (tmp_path / "second/conf/task/second.yaml").write_text("defaults:\n  - cart_pole\n")
    monkeypatch.chdir(tmp_path / "second")
    short = ("seed=0,1", "max_steps=2", "num_envs=1", "record=none", "quiet=true")
    assert main(["run", "-m", *workers, "task=second", *short]) == 0


@pytest.mark.unmeasured
def test_lines_of_parallel_jobs_begin_with_their_job(commands: Commands, tmp_path: Path) -> None:
    """Of a task that only `--config-dir` has: workers search there too."""
    (tmp_path / "mine/task").mkdir(parents=True)
    (tmp_path / "mine/task/mine.yaml").write_text("defaults:\n  - cart_pole\n")
    workers = ("hydra/launcher=joblib", "hydra.launcher.n_jobs=2")
    arguments = ("run", f"--config-dir={tmp_path / 'mine'}", "-m", *workers, "task=mine")
    arguments += ("seed=3,4", "max_steps=20", "num_envs=1")
    arguments += ("record=none",)
    done = commands.run(*arguments, f"output_dir={tmp_path}")
    assert done.returncode == 0, done.stderr
    for job, seed in enumerate((3, 4)):
        label = f"[{job} seed={seed}] "
        assert f"{label}mine: {tmp_path}" in done.stderr
        assert re.search(rf"^{re.escape(label)} +seed +{seed}$", done.stdout, re.MULTILINE)
    lines = [line for line in done.stdout.splitlines() if line]
    assert all(line.startswith(("[0 seed=3] ", "[1 seed=4] ")) for line in lines)


def test_a_missing_package_is_named() -> None:
    sweeps = [
        ["hydra/sweeper=optuna", "task=cart_pole", "seed=interval(1,9)"],
        ["hydra/launcher=joblib", "task=cart_pole", "seed=0,1"],
        ["experiment=optuna_cart_pole"],
    ]
    command = [sys.executable, "-c", WITHOUT_PLUGINS, json.dumps(sweeps)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.stdout.split() == ["2", "2", "2"]
    lines = done.stderr.splitlines()
    assert len(lines) == 3
    assert all("pip install 'embodichain[sweep]'" in line for line in lines)
    assert list(Path.cwd().iterdir()) == []


def test_mistakes_come_before_the_first_trial(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    search = ("hydra/sweeper=optuna", "algo.learning_rte=interval(0.1,0.2)")
    assert main(["train", "-m", *search, *TINY, f"output_dir={tmp_path}"]) == 2
    assert "algo.learning_rte" in capsys.readouterr().err
    assert list(Path.cwd().iterdir()) == []


def test_points() -> None:
    assert list(points(["a=1,2", "b=x"], 64)) == [["a=1", "b=x"], ["a=2", "b=x"]]
    assert list(points(["a=1,2", "b=3,4"], 3)) == [["a=1", "b=3"], ["a=1", "b=4"], ["a=2", "b=3"]]
    search = ["hydra/sweeper=optuna", "a=choice(u,v)", "b=tag(log,interval(0.1,9))", "c=range(2,8)"]
    assert list(points(search, 64)) == [["hydra/sweeper=optuna", "a=u", "b=0.1", "c=2"]]
    whole = ["a=interval(1,2)", "b=int(interval(3,4))"]
    assert list(points(whole, 64)) == [["a=1.0", "b=3"]]


def test_a_search_maximizes_unless_told_otherwise() -> None:
    optuna, minimize = "hydra/sweeper=optuna", "hydra.sweeper.direction=minimize"
    assert towards_scores([optuna]) == [optuna, "hydra.sweeper.direction=maximize"]
    assert towards_scores([optuna, minimize]) == [optuna, minimize]
    assert towards_scores(["seed=0,1"]) == ["seed=0,1"]


def running_children(pid: int) -> list[int]:
    """Processes that a process has started and that have not ended (proc(5))."""
    found = [p.read_text().split() for p in Path(f"/proc/{pid}/task").glob("*/children")]
    return [int(child) for line in found for child in line if is_running(int(child))]


def is_running(pid: int) -> bool:
    """Whether a process has not ended; it may not have been waited for."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except (FileNotFoundError, ProcessLookupError):
        return False


@pytest.mark.unmeasured
def test_workers_of_a_killed_sweep_end_with_it(commands: Commands, tmp_path: Path) -> None:
    """Three workers: one has no job, and waits for one in a pipe."""
    words = ("task=cart_pole", "seed=0,1", "num_envs=1", "record=none", "episodes=1000000")
    workers = ("hydra/launcher=joblib", "hydra.launcher.n_jobs=3", f"hydra.sweep.dir={tmp_path}/s")
    sweep = commands.start("run", "-m", *workers, *words)
    try:
        end = time.monotonic() + 120.0
        while len([*tmp_path.glob("s/[01]/run.log")]) < 2 and time.monotonic() < end:
            time.sleep(0.1)
        children = running_children(sweep.pid)
        assert len(children) >= 3
    finally:
        sweep.kill()
    end = time.monotonic() + 30.0
    while any(map(is_running, children)) and time.monotonic() < end:
        time.sleep(0.05)
    left = [pid for pid in children if is_running(pid)]
    for pid in left:
        os.kill(pid, signal.SIGKILL)
    assert not left


@pytest.mark.unmeasured
def test_a_worker_that_is_killed_is_said_in_one_line(commands: Commands, tmp_path: Path) -> None:
    words = ("task=cart_pole", "seed=0,1", "num_envs=1", "record=none", "episodes=1000000")
    workers = ("hydra/launcher=joblib", "hydra.launcher.n_jobs=2", f"hydra.sweep.dir={tmp_path}/s")
    sweep = commands.start("run", "-m", *workers, *words, "-q")
    try:
        end = time.monotonic() + 120.0
        while len([*tmp_path.glob("s/[01]/run.log")]) < 2 and time.monotonic() < end:
            time.sleep(0.1)
        named = [Path(f"/proc/{pid}/cmdline").read_text() for pid in running_children(sweep.pid)]
        worker = named.index(next(name for name in named if "LokyProcess" in name))
        os.kill(running_children(sweep.pid)[worker], signal.SIGKILL)
        said = sweep.communicate(timeout=60.0)[1].splitlines()
    finally:
        sweep.kill()
    assert sweep.returncode == 1
    assert [line for line in said if "was killed" in line] == [
        "a worker was killed (SIGKILL(-9)), perhaps because there was no memory left; "
        "joblib has ended the other workers with it"
    ]
    assert not [line for line in said if "failed" in line]
    assert any("0 of 2 jobs are done; not done: 0, 1" in line for line in said)
