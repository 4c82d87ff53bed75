"""Before a sweep: the launcher, and how many cores each job gets."""

import os
from pathlib import Path

import pytest

from embodichain.cli.sweeps.sweep_plan import Plan, plan_sweep
from embodichain.config import resolve
from embodichain.utils.errors import ConfigError

JOB = ("task=cart_pole", "seed=0", "total_timesteps=64")


def plan(*overrides: str, first: tuple[str, ...] = ()) -> Plan:
    return plan_sweep("train", ["task=cart_pole", *overrides], resolve([*JOB, *first], "train"))


@pytest.fixture(autouse=True)
def eight_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    # A plan depends on the cores of the machine.
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: set(range(8)))


def test_jobs_run_at_once_and_share_the_cores() -> None:
    three = plan("seed=0,1,2")
    assert (three.launcher, three.jobs, three.keys) == ("joblib", 3, ("seed",))
    assert "hydra/launcher=joblib" in three.overrides
    assert "sim.num_threads=2" in three.overrides  # 8 cores // 3 jobs
    assert three.note.startswith("3 jobs, 3 at once, 2 threads of physics in each")
    grid = plan("seed=0,1,2", "algo.gamma=0.9,0.95", "hydra/launcher=joblib")
    assert grid.jobs == 6 and "sim.num_threads=1" in grid.overrides
    fewer = plan("seed=0,1,2", "hydra/launcher=joblib", "hydra.launcher.n_jobs=2")
    assert "sim.num_threads=4" in fewer.overrides and "2 at once" in fewer.note


def test_what_is_typed_wins() -> None:
    one_by_one = plan("seed=0,1", "hydra/launcher=basic")
    assert (one_by_one.launcher, one_by_one.note) == ("basic", "")
    assert not any("num_threads" in line for line in one_by_one.overrides)
    threads = plan("seed=0,1", "sim.num_threads=3", first=("sim.num_threads=3",))
    assert threads.overrides.count("sim.num_threads=3") == 1
    assert "3 threads of physics" in threads.note


def test_jobs_with_a_viewer_or_one_device_run_one_by_one() -> None:
    assert plan("seed=0,1", first=("viewer=web",)).launcher == "basic"
    assert plan("seed=0").launcher == "basic"


def test_jobs_of_a_cluster_have_its_number_of_cores() -> None:
    found = plan("seed=0,1", "hydra/launcher=slurm", "hydra.launcher.cpus=3")
    assert "sim.num_threads=3" in found.overrides and found.is_parallel
    assert "2 jobs, 3 threads" in found.note


def test_a_search_runs_as_many_trials_at_once_as_its_sweeper_says() -> None:
    search = ("hydra/sweeper=optuna", "hydra.sweeper.n_trials=7", "hydra.sweeper.n_jobs=4")
    found = plan(*search, "algo.gamma=interval(0.9,0.99)")
    assert found.jobs == 7 and "7 jobs, 4 at once, 2 threads" in found.note


def test_the_folder_is_the_same_for_every_process(tmp_path: Path) -> None:
    odd = tmp_path / "it's a, b"
    typed = str(odd).replace("'", "\\'")
    found = plan("seed=0,1", f"hydra.sweep.dir='{typed}'")
    assert found.folder == odd
    assert [line for line in found.overrides if line.startswith("hydra.sweep.dir=")] == [
        f"hydra.sweep.dir='{typed}'"
    ]
    assert "outputs/sweeps/" in str(plan("seed=0,1").folder)


def test_a_wrong_key_of_a_launcher_is_a_mistake() -> None:
    with pytest.raises(ConfigError, match="partitions"):
        plan("seed=0,1", "hydra/launcher=slurm", "hydra.launcher.partitions=debug")
