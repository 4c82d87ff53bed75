"""What people mistype on a command line: one sentence each, with what to write."""

from pathlib import Path

import pytest

from embodichain.cli import main

_EXPECTED = "; expected key=value, +key=value or ~key"


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["run", "task", "=", "reach"], "write task=reach, without blanks around ="),
        (["run", "task", "reach"], "write task=reach, without a blank after the key"),
        (["run", "task:", "reach"], "write task=reach, without a blank after the key"),
        (["run", "task=", "reach"], "write task=reach, without a blank after the key"),
        (["run", "task", "=reach"], "write task=reach, without a blank after the key"),
        (["run", "num_envs", "4", "reach"], "write num_envs=4, without a blank after the key"),
        (
            ["run", "reach", "task.rewards=", "{a:", "1}"],
            "write 'task.rewards={a: 1}', without a blank after the key",
        ),
        (
            ["run", "-n", "4"],
            "No such option '-n'.\nTry 'embodichain run --help'. Values are given as key=value, "
            "without dashes.",
        ),
        (
            ["run", "--headless"],
            "there is no option --headless: leave it out, only viewer=native opens a window",
        ),
        (
            ["train", "--n-envs", "4"],
            "there is no option --n-envs: write num_envs=4, without dashes",
        ),
        (
            ["train", "--max_iterations=9"],
            "there is no option --max_iterations: write "
            "total_timesteps=N, the steps of all environments together",
        ),
        (
            ["run", "reach", "+task.rewards.new=func:distance", "+task.rewards.new=weight:2"],
            "your shell has split the braces: put quotes around it, "
            "'+task.rewards.new={func: distance, weight: 2}'",
        ),
        (
            ["run", "reach", "task.actions={all:func:x}", "task.actions={all:of:robot}"],
            "your shell has split the braces: put quotes around it, 'task.actions={...}'",
        ),
        (
            ["--task", "reach"],
            "a verb comes first: embodichain run task=reach, without dashes",
        ),
        (
            ["--num-envs=4", "task=reach"],
            "a verb comes first: embodichain run num_envs=4, without dashes",
        ),
        (["compare", "lst"], "there is no run 'lst'. Did you mean 'last'?"),
        (["compare", "num_envs=2"], "num_envs=2: `compare` reads no KEY=VALUE"),
        *(
            ([*verb.split(), "lst", *more], "lst does not exist. Did you mean 'last'?")
            for verb, more in {
                "replay": [],
                "view": [],
                "export --format=hdf5 -o a.hdf5": [],
                "recover": ["a.mcap"],
                "diff": ["lst"],
            }.items()
        ),
        (["augment", "lst"], "there is no 'lst'. Did you mean 'last'?"),
        (["play", "lst"], "there is no run or policy 'lst'. Did you mean 'last'?"),
        (
            ["train", "resume=lst"],
            "resume: 'lst' is not a training's folder: it has no config.yaml. Did you mean 'last'?",
        ),
        (
            ["report", "last", "episodes=2"],
            "Got unexpected extra argument (episodes=2): `report` reads no KEY=VALUE\n"
            "Try 'embodichain report --help'.",
        ),
        (
            ["run", "task=reach,", "episodes=1"],
            f"command line: malformed override 'task=reach,': it ends with a comma{_EXPECTED}",
        ),
        (
            ["run", "task=reach", "seed=1,", "-m"],
            f"command line: malformed override 'seed=1,': it ends with a comma{_EXPECTED}",
        ),
        (
            ["run", "task=reach", "episodes='2"],
            'command line: malformed override "episodes=\'2": it has a quote without its other '
            f"one{_EXPECTED}",
        ),
        (
            ["run", "task=reach", "policy=''"],
            "command line: policy: is empty: leave it out, or name a policy",
        ),
        (
            ["run", "task=reach", "task.sensors.wrst.width=3"],
            "command line: task.sensors.wrst: there is no 'wrst' in task.sensors; there are: none. "
            "Add one with +task.sensors.wrst={...}",
        ),
        (["eval", "lst"], "there is no run or policy 'lst'. Did you mean 'last'?"),
        (["eval", "zero"], "zero is not in the folder of a run: give the task, task=NAME"),
        (["report", "lst"], "there is no run 'lst'. Did you mean 'last'?"),
        (
            ["train", "task=reach", "algo.lr=0.1"],
            "command line: algo.lr: not a key of an algorithm; it is called learning_rate",
        ),
    ],
)
def test_one_sentence(
    words: list[str], says: str, empty_cwd: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words) == 2
    assert capsys.readouterr().err == f"error: {says}\n"
    assert list(Path().iterdir()) == []


def test_a_task_in_place_of_a_verb(empty_cwd: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["reach"]) == 2
    said = "error: no such verb: 'reach'. To run the task: embodichain run task=reach. There are: "
    assert capsys.readouterr().err.startswith(said)


@pytest.mark.parametrize("words", [["run", "last"], ["show", "runs"], ["validate", "last"]])
def test_a_run_in_place_of_a_task(
    words: list[str], empty_cwd: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("runs").mkdir()
    assert main(words) == 2
    said = capsys.readouterr().err
    assert f"task: unknown option {words[1]!r}" in said
    assert said.endswith("A run is taken by eval, play, replay, report, export and compare.\n")


def test_every_name_that_nothing_has_is_reported(
    empty_cwd: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["compare", "last", "lst"]) == 2
    assert capsys.readouterr().err == (
        "2 mistakes:\n"
        "  no training in outputs yet: embodichain train task=NAME\n"
        "  there is no run 'lst'. Did you mean 'last'?\n"
    )


def test_a_policy_of_a_training_that_did_not_finish(
    empty_cwd: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("stopped/checkpoints").mkdir(parents=True)
    without = (
        "error: command line: policy: stopped has no checkpoints/final.zip: it is not the folder "
        "of a finished training; "
    )
    for verb in ("run", "validate"):
        assert main([verb, "task=cart_pole", "policy=stopped"]) == 2
        assert capsys.readouterr().err == f"{without}it has none\n"
    for name in ("best", "step_000000002048"):
        Path(f"stopped/checkpoints/{name}.zip").touch()
    for verb in ("run", "validate"):
        assert main([verb, "task=cart_pole", "policy=stopped"]) == 2
        assert capsys.readouterr().err == (
            f"{without}there are: stopped/checkpoints/best.zip, "
            "stopped/checkpoints/step_000000002048.zip\n"
        )
