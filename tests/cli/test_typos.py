"""What people mistype on a command line: one sentence each, with what to write."""

from pathlib import Path

import pytest

from embodichain.cli import main

_EXPECTED = "; expected key=value, +key=value or ~key"


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["run", "task", "=", "reach"], "write task=reach, without blanks around ="),
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
