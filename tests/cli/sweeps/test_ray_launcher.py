"""Sweeps on a Ray cluster of two nodes, one of which is killed."""

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from omegaconf import OmegaConf

from tests.helpers.commands import Command, Commands
from tests.helpers.extras import needs
from tests.helpers.inside import places_of
from tests.helpers.ray_cluster import ray_cluster
from tests.helpers.sweeps import TINY, check_study, summary, write_study

pytestmark = [
    needs("ray"),
    pytest.mark.unmeasured,
    pytest.mark.cluster,
    pytest.mark.timeout(600),
]
GUARD = 240.0
"""Seconds after which something hangs."""
SECRET = "hunter2-PLANTED"


Start = Callable[..., Command]


@pytest.fixture(scope="module")
def cluster() -> Iterator[tuple[Any, list[Any]]]:
    """Its nodes have a variable that is a secret."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MY_SECRET", SECRET)
        with ray_cluster(2) as found:
            yield found


@pytest.fixture
def start(commands: Commands, cluster: tuple[Any, list[Any]], tmp_path: Path) -> Start:
    """Starts a sweep on the cluster."""

    def begin(*more: str) -> Command:
        where = [f"output_dir={tmp_path}", f"hydra.sweep.dir={tmp_path}/s"]
        ray = ["hydra/launcher=ray", f"hydra.launcher.address={cluster[0].address}"]
        return commands.start("train", "-m", *where, *ray, *TINY, *more)

    return begin


def test_a_search_keeps_its_trials(start: Start, tmp_path: Path) -> None:
    search = ("hydra/sweeper=optuna", "hydra.sweeper.n_trials=2", "hydra.sweeper.n_jobs=2")
    storage = f"sqlite:///{tmp_path}/trials.db"
    kept = (f"hydra.sweeper.storage={storage}", "hydra.sweeper.study_name=gammas")
    point = ("algo.gamma=interval(0.9,0.99)", "seed=0", "total_timesteps=64")
    process = start(*search, *kept, *point)
    _, said = process.communicate(timeout=GUARD)
    assert process.returncode == 0, said
    best = max(summary(tmp_path / "s" / name)["objective"] for name in "01")
    results: Any = OmegaConf.load(tmp_path / "s/optimization_results.yaml")
    assert results.best_value == best
    import optuna

    study = optuna.load_study(study_name="gammas", storage=storage)
    assert [trial.state.name for trial in study.trials] == ["COMPLETE", "COMPLETE"]


def test_a_study_runs_its_jobs_on_ray(
    commands: Commands, cluster: tuple[Any, list[Any]], tmp_path: Path
) -> None:
    write_study(tmp_path)
    on_ray = ("hydra/launcher=ray", f"hydra.launcher.address={cluster[0].address}")
    process = commands.start("study", "tiny", "--quiet", *on_ray, cwd=tmp_path)
    _, said = process.communicate(timeout=GUARD)
    check_study(tmp_path, process.returncode, said)


def test_a_secret_is_in_no_record_of_a_job(start: Start, tmp_path: Path) -> None:
    """The nodes have the variable; what a job is sent has its name."""
    process = start("task.description=for ${oc.env:MY_SECRET}", "seed=0,1", "total_timesteps=32")
    out, said = process.communicate(timeout=GUARD)
    assert process.returncode == 0, said
    assert "PLANTED" not in out + said
    for name in "01":
        assert summary(tmp_path / "s" / name)["status"] == "finished"
        text = (tmp_path / "s" / name / "config.yaml").read_text()
        assert "description: for ${oc.env:MY_SECRET}" in text
    assert places_of("PLANTED", tmp_path) == []


def test_a_job_whose_node_died_goes_on_on_another(
    cluster: tuple[Any, list[Any]], start: Start, tmp_path: Path
) -> None:
    long = ("seed=0,1", "total_timesteps=1600", "checkpoint.every_steps=32")
    process = start(*long)
    end = time.monotonic() + GUARD
    while len({p.parts[-3] for p in tmp_path.glob("s/*/checkpoints/step_*.zip")}) < 2:
        assert time.monotonic() < end and process.poll() is None, process.communicate()
        time.sleep(0.1)
    cluster[0].remove_node(cluster[1].pop(), allow_graceful=False)
    _, said = process.communicate(timeout=GUARD)
    assert process.returncode == 0, said
    found = [summary(tmp_path / "s" / name) for name in "01"]
    assert [job["status"] for job in found] == ["finished", "finished"]
    assert sorted(job["resumed_from"] is None for job in found) == [False, True]
