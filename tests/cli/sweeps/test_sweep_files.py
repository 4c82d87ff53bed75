"""Sweeps whose folders and parameters come from Hydra's own keys, and odd folders of runs."""

import json
from pathlib import Path

import pytest

from embodichain.cli import main

pytestmark = pytest.mark.slow

TINY = (
    *("task=cart_pole", "num_envs=2", "total_timesteps=32", "algo.n_steps=8", "algo.batch_size=16"),
    *("sim.num_threads=1", "eval.episodes=1", "record=none", "hydra/launcher=basic", "quiet=true"),
)
SHORT = ("task=cart_pole", "episodes=1", "max_steps=2", "record=none", "scene_png=false", "-q")


def test_job_folders_named_by_overrides(empty_cwd: Path) -> None:
    names = ("hydra.sweep.dir=größe", "hydra.sweep.subdir=${hydra.job.override_dirname}")
    assert main(["train", "-m", *TINY, "seed=0,1", "eval.episodes=0", *names]) == 0
    found = sorted(Path("größe").glob("*/summary.json"))
    assert [json.loads(path.read_text())["seed"] for path in found] == [0, 1]
    for seed, path in enumerate(found):
        assert f"seed={seed}" in path.parent.name and "algo.n_steps=8" in path.parent.name


def test_parameters_of_the_sweeper_in_a_file(
    empty_cwd: Path, capsys: pytest.CaptureFixture
) -> None:
    Path("conf/experiment").mkdir(parents=True)
    file = Path("conf/experiment/gammas.yaml")
    text = '# @package _global_\nhydra: {sweeper: {params: {algo.gamma: "0.5,0.25", seed: 3}}}\n'
    file.write_text(text)
    words = ("experiment=gammas", "hydra.sweep.dir=s", "eval.episodes=0")
    assert main(["train", "-m", *TINY, *words, "algo.gae_lambda=0.5"]) == 0
    configs = sorted(Path("s").glob("*/config.yaml"))
    assert [path.parent.name for path in configs] == ["0", "1"]
    assert ["gamma: 0.5" in path.read_text() for path in configs] == [True, False]
    assert all("seed: 3" in path.read_text() for path in configs)
    file.write_text(text.replace("0.25", "7"))  # checked before the first job
    assert main(["train", "-m", *TINY, *words, "hydra.sweep.dir=t"]) == 2
    assert "algo.gamma: must be at most 1.0, got 7" in capsys.readouterr().err
    assert not Path("t").exists()


def test_a_search_without_an_objective(empty_cwd: Path, capsys: pytest.CaptureFixture) -> None:
    pytest.importorskip("optuna")
    search = ("hydra/sweeper=optuna", "hydra.sweeper.n_trials=1", "seed=choice(1,2)")
    words = ("eval.episodes=0", "total_timesteps=16", "hydra.sweep.dir=s")
    assert main(["train", "-m", *TINY, *search, *words]) == 2
    assert (
        "eval.episodes: a search compares the objectives of its jobs, and this job has none: "
        "eval.episodes=0, and the training finished no episode; set eval.episodes"
    ) in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (
            ["hydra.sweep.dir=s", "hydra.sweep.subdir=a"],
            "hydra.sweep.subdir: jobs 0 and 1 have the same folder, 'a'. ${hydra.job.num} and "
            "${hydra.job.override_dirname} differ in each job.",
        ),
        (
            ["hydra.sweep.dir=s", "hydra.sweep.subdir=a_${task}"],
            "hydra.sweep.subdir: ${task} is a map, and a folder's name is text. The option's name "
            "is ${hydra.runtime.choices.task}.",
        ),
        (
            ["hydra.sweep.dir=s", "hydra.sweep.subdir=${sed}"],
            "hydra.sweep.subdir: Interpolation key 'sed' not found",
        ),
        (["hydra.sweep.dir=${sed}"], "hydra.sweep.dir: Interpolation key 'sed' not found"),
        (
            ["hydra.sweep.dir=s/${task.actions}"],
            "hydra.sweep.dir: ${task.actions} is a map, and a folder's name is text",
        ),
    ],
)
def test_folders_that_refer_to_what_has_no_name(
    words: list[str], says: str, empty_cwd: Path, capsys: pytest.CaptureFixture
) -> None:
    assert main(["train", "-m", *TINY, "seed=0,1", *words]) == 2
    assert capsys.readouterr().err == f"error: command line: {says}\n"
    assert list(Path().iterdir()) == []


def test_a_file_gives_all_jobs_one_folder(empty_cwd: Path, capsys: pytest.CaptureFixture) -> None:
    Path("conf/experiment").mkdir(parents=True)
    text = "# @package _global_\nhydra: {sweep: {subdir: a}}\n"
    Path("conf/experiment/one.yaml").write_text(text)
    assert main(["train", "-m", *TINY, "experiment=one", "seed=0,1", "hydra.sweep.dir=s"]) == 2
    assert "jobs 0 and 1 have the same folder, 'a'" in capsys.readouterr().err
    assert not Path("s").exists()


def test_a_run_folder_that_refers_to_a_map(empty_cwd: Path, capsys: pytest.CaptureFixture) -> None:
    assert main(["run", *SHORT, "hydra.run.dir=r/${task}"]) == 2
    assert "hydra.run.dir: ${task} is a map, and a folder's name" in capsys.readouterr().err
    assert list(Path().iterdir()) == []


def test_odd_folders_of_a_run(empty_cwd: Path, capsys: pytest.CaptureFixture) -> None:
    Path("file").touch()
    Path("used").mkdir()
    Path("used/config.yaml").touch()
    for value, words in {
        ".": "'.' is the working directory, and a run has a folder of its own",
        "./": "'./' is the working directory",
        "file": "cannot make the run folder file: ",
        "file/in/it": "cannot make the run folder file/in/it: ",
        "/proc/x": "cannot make the run folder /proc/x: ",
        "used": "used contains a run already",
    }.items():
        assert main(["run", *SHORT, f"hydra.run.dir={value}"]) == 2
        said = capsys.readouterr().err
        assert said.startswith(f"error: hydra.run.dir: {words}")
    assert sorted(path.name for path in Path().iterdir()) == ["file", "used"]
    assert main(["run", *SHORT, "hydra.run.dir=${now:%Y}/5=ö"]) == 0
    (summary,) = Path().glob("*/5=ö/summary.json")
    assert summary.is_file()


def test_a_search_path_of_jobs(empty_cwd: Path) -> None:
    Path("shared/task").mkdir(parents=True)
    Path("shared/task/theirs.yaml").write_text("defaults: [cart_pole, _self_]\n")
    words = (f"hydra.searchpath=[file://{Path('shared').resolve()}]",)
    assert main(["run", "task=theirs", *SHORT[1:], *words]) == 0
    sweep = ("-m", "seed=0,1", "hydra.sweep.dir=s", "hydra/launcher=basic")
    assert main(["run", "task=theirs", *SHORT[1:], *words, *sweep]) == 0
    assert sorted(path.parent.name for path in Path("s").glob("*/summary.json")) == ["0", "1"]


@pytest.mark.parametrize("words", [("train",), ("collect",)])
def test_other_letters_in_a_run_that_goes_on(
    empty_cwd: Path, capsys: pytest.CaptureFixture, words: tuple[str, ...]
) -> None:
    assert main([*words, "resume=/data/jörg/run=1"]) == 2
    said = capsys.readouterr().err
    assert "/data/jörg/run=1" in said and "Lexer" not in said and "malformed" not in said
