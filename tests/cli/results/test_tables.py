"""Tables in pipes and files: 100 columns, nothing that is looked for is cut, readable numbers."""

import pytest

from embodichain.cli import main
from embodichain.cli.results.summaries import evaluation_rows, run_rows, training_rows
from embodichain.cli.terminal.output import number, print_facts, print_table, result_number

PATH = "outputs/2026-01-01/" + "a-long-name/" * 10 + "rollout.mcap"
TEXT = "words " * 60


@pytest.fixture(autouse=True)
def no_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("COLUMNS", raising=False)


def test_text_is_folded_and_names_are_whole(capsys: pytest.CaptureFixture[str]) -> None:
    print_table("table", [{"name": "a" * 40, "what": TEXT, "number": 1.5}])
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 101
    assert any("a" * 40 in line for line in lines)
    assert " ".join(lines).count("words") == 60


def test_a_path_is_never_cut(capsys: pytest.CaptureFixture[str]) -> None:
    print_facts("facts", [("text", TEXT), ("folder", PATH)])
    print_table("table", [{"folder": PATH, "what": TEXT}])
    out = capsys.readouterr().out
    assert out.count(PATH) == 2


def test_every_list_fits(capsys: pytest.CaptureFixture[str]) -> None:
    for what in ("tasks", "robots", "terms"):
        assert main(["list", what]) == 0
        assert max(map(len, capsys.readouterr().out.splitlines())) <= 101


def test_an_unknown_term_is_answered_in_one_readable_line(
    capsys: pytest.CaptureFixture[str],
) -> None:
    keys = ["task=reach", "task.rewards.near.func=distance_tahn"]
    assert main(["validate", *keys]) == 2
    line = next(x for x in capsys.readouterr().err.splitlines() if "distance_tahn" in x)
    assert "unknown reward term 'distance_tahn'; allowed: distance_tanh, " in line
    assert "in all: `embodichain list terms`)" in line
    assert line.count(",") < 10


@pytest.mark.parametrize("columns", ["44", "62", "66", "100", ""])
def test_words_are_cut_only_where_they_have_no_room(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, columns: str
) -> None:
    monkeypatch.setenv("COLUMNS", columns)
    label = "reach ppo algo.batch_size=512 algo.n_steps=64"
    interval = "13.2 [12.92, 13.55]"
    print_table("t", [{"runs": label, "success": "0.0% [0.0%, 19.4%]", "return": interval}])
    text = capsys.readouterr().out
    assert max(map(len, text.splitlines())) <= int(columns or 100)
    words = text.split()
    for word in ("algo.batch_size=512", "algo.n_steps=64", "19.4%]", "13.55]"):
        assert word in words
    if columns not in ("44", "62"):
        assert f" {interval}" in text  # short cells are not folded where there is room


def test_columns_share_the_width_of_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    print_table("t", [{"what": "a b " * 60, "longest": "x" * 43, "why": "c d " * 60}])
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 100
    assert " ".join(lines).split().count("d") == 60  # the last column is not cropped


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (2.982e-24, "0"),
        (-1.83e-24, "0"),
        (0.0, "0"),
        (3e-7, "0"),
        (-3.2e-5, "-0.000032"),
        (0.000123456, "0.000123"),
        (0.0012345, "0.001234"),
        (46.29876, "46.3"),
        (4655.4, "4,655"),
        (-123456.7, "-123,457"),
        (float("nan"), "nan"),
        (float("-inf"), "-inf"),
    ],
)
def test_a_result_has_no_exponent(value: float, text: str) -> None:
    assert result_number(value) == text


def test_a_value_of_a_config_keeps_its_digits() -> None:
    assert number(1e-10) == "1e-10"
    assert number([0.5, 6.123e-17, -1.0]) == "0.5, 0, -1"  # what rounding leaves of cos(pi/2)
    assert number({"below": 0.05, "range": [0.0, 1.0]}) == "{below: 0.05, range: [0, 1]}"


_SPREAD = {"mean": 4655.25, "std": 0.0, "min": 4655.25, "max": 4655.25}
_RUN = {
    "status": "finished",
    "signal": None,
    "num_envs": 1,
    "control_steps": 250,
    "seconds": 2.5,
    "fps": 100.0,
    "episodes": 1,
    "episodes_wanted": 1,
    "return": _SPREAD,
    "length": {"mean": 250.0, "std": 0.0, "min": 250.0, "max": 250.0},
    "success_rate": 1.0,
    "diverged": 0,
    "metrics": {"success": 1.0, "tool/position_error": 2.982e-24, "never": None},
    "rewards": {"reach": 4655.25, "nothing": None},
    "seed": 1,
}


def test_one_episode_has_no_spread() -> None:
    rows = dict(run_rows(_RUN))
    assert rows["episodes"] == "1 of 1 (1 environment)"
    assert (rows["return"], rows["length"]) == ("4,655", "250")
    assert (rows["success"], rows["metric tool/position_error"]) == ("100.0%", "0")
    assert not {"metric success", "metric never", "reward nothing"} & set(rows)
    two = {**_RUN, "episodes": 2, "return": {"mean": 1.5, "std": 0.5, "min": 1.0, "max": 2.0}}
    assert dict(run_rows(two))["return"] == "1.5 ± 0.5 (1 to 2)"
    none = {**_RUN, "episodes": 0, "return": None, "length": None, "success_rate": None}
    assert not {"return", "length", "success"} & set(dict(run_rows(none)))


def test_an_evaluation_of_equal_episodes_has_one_number() -> None:
    one = {"mean": -20.49, "iqm": -20.49, "median": -20.49, "min": -20.49, "max": -20.49}
    several = {
        "mean": 98.5,
        "mean_interval": [97.0, 100.0],
        "iqm": 99.0,
        "iqm_interval": [98.0, 100.0],
        "median": 99.0,
        "min": 96.0,
        "max": 100.0,
    }
    result = {
        "policy": "zero",
        "deterministic": True,
        "episodes": 1,
        "num_envs": 1,
        "success": {"rate": 1.0, "interval": [0.207, 1.0], "count": 1, "trials": 1},
        "returns": {**one, "mean_interval": None, "iqm_interval": None},
        "length": several,
        "rewards": {},
        "metrics": {"success": 1.0, "error": 4e-9},
        "terminated": 1,
        "diverged": 0,
    }
    rows = dict(evaluation_rows(result))
    assert (rows["episodes"], rows["terminated"]) == ("1 of 1 environment", "1 episode")
    assert rows["return"] == "-20.49"
    assert not any(name.startswith("return ") for name in rows)
    assert rows["length mean"] == "98.5  [97, 100]"
    assert rows["length median"] == "99  (96 to 100)"
    assert rows["metric error"] == "0"
    assert "metric success" not in rows


def test_a_training_shows_shares_and_no_empty_rows() -> None:
    summary = {
        "task": "reach",
        "algo": "ppo",
        "env_steps": 131072,
        "time_fractions": {"physics": 0.25, "update": 0.75},
        "success_rate": 1.0,
        "mean_return": 3e-9,
        "demonstrations": None,
        "resumed_from": None,
        "objective": 0.5,
        "eval": None,
    }
    rows = dict(training_rows(summary))
    assert rows == {
        "algo": "ppo",
        "env steps": "131,072",
        "time fractions": "physics 25%, update 75%",
        "success rate": "100.0%",
        "mean return": "0",
        "objective": "50.0%",
    }
    without_success = {**summary, "success_rate": None, "objective": -1234.5}
    assert dict(training_rows(without_success))["objective"] == "-1,234"
