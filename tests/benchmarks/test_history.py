"""The history of performance: rows from result files, and the page that draws them."""

import json
import subprocess
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from benchmarks import history

pytestmark = pytest.mark.slow

MACHINE = {
    **{"processor": "A", "cores": 2, "memory_gib": 8, "system": "Linux", "python": "3.11.7"},
    **{"packages": {"mujoco": "4.0.0"}, "load_at_start": 0.5, "date": "2026-01-02"},
}


def startup(*seconds: float, machine: dict[str, object] = MACHINE) -> dict[str, object]:
    return {"machine": machine, "rounds": 3, "cpu_seconds": {"embodichain --help": [*seconds]}}


def test_a_row_has_the_medians_and_the_machine() -> None:
    row = history.row_of("abc1234", "startup", startup(0.3, 0.123456, 0.1))
    assert row.figures == {"embodichain --help, CPU s": (0.1235, "CPU s")}
    assert (row.commit, row.date) == ("abc1234", "2026-01-02")
    assert row.machine["processor"] == "A"
    assert "date" not in row.machine


def test_the_cost_of_a_log_is_that_of_pairs() -> None:
    results = [
        # pairs: +10 %, +30 %, +20 %; one process, then two
        {
            "num_envs": 4,
            "physics_steps": 4,
            "seconds": {"plain": [1, 1, 2], "logged": [1.1, 1.3, 2.4]},
        },
        {
            **{"num_envs": 64, "physics_steps": 4, "resets": "staggered"},
            "seconds": {"plain": [[1], [4]], "logged": [[1.5], [4.0]]},
        },
        {"num_envs": 64, "physics_steps": 10, "seconds": {"plain": [1], "logged": [9]}},
    ]
    row = history.row_of("c", "log_cost", {"machine": MACHINE, "results": results})
    assert row.figures == {
        "N=4, lockstep resets": (20.0, "% of a step"),
        "N=64, staggered resets": (25.0, "% of a step"),
    }


def test_an_unknown_benchmark_and_an_empty_file_are_errors() -> None:
    with pytest.raises(ValueError, match="no figures of 'speed'; there are: step_speed"):
        history.row_of("c", "speed", startup(1.0))
    with pytest.raises(ValueError, match="none of the figures that are kept"):
        history.row_of("c", "step_speed", {"machine": MACHINE, "results": []})


def test_rows_are_added_once(tmp_path: Path) -> None:
    path = tmp_path / "rows.jsonl"
    first = history.row_of("a", "startup", startup(1.0))
    assert history.add([first], path) == [first]
    again = history.row_of("a", "startup", startup(2.0))
    second = history.row_of("b", "startup", startup(3.0))
    assert history.add([again, second], path) == [second]
    assert history.read(path) == [first, second]


def test_a_chart_has_a_point_for_each_row_at_its_height() -> None:
    other = {**MACHINE, "processor": "B & C"}
    rows = [
        history.row_of("a", "startup", startup(1.0)),
        history.row_of("b", "startup", startup(4.0)),
        history.row_of("c", "startup", startup(2.0, machine=other)),
    ]
    text = history.page(rows)
    assert "B &amp; C" in text
    assert "://" not in text  # nothing of another host
    drawing = text[text.index("<svg") : text.index("</svg>") + len("</svg>")]
    circles = ET.fromstring(drawing).findall("circle")
    # 110 high with a margin of 8: the top is 4 s, the bottom 0
    assert [(c.get("cx"), c.get("cy")) for c in circles] == [
        *(("8.0", "78.5"), ("150.0", "8.0"), ("292.0", "55.0"))
    ]
    assert len({c.get("fill") for c in circles}) == 2
    assert circles[1].findtext("title") == "4 CPU s: b 2026-01-02, load 0.5"


def test_the_command_writes_rows_and_page(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows, out = tmp_path / "rows.jsonl", tmp_path / "page.html"
    files = ["--rows", str(rows), "--out", str(out)]
    history.main(["--record", "startup", "memory", "--commit", "abc", *files])
    assert [row.benchmark for row in history.read(rows)] == ["startup", "memory"]
    assert "abc" in capsys.readouterr().out
    assert "random_reach, N=1024" in out.read_text()
    with pytest.raises(SystemExit):
        history.main(files)


def test_figures_of_a_changed_package_are_marked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    who = ["-c", "user.name=a", "-c", "user.email=a@b.c"]
    root = tmp_path / "checkout"
    results = root / history.RESULTS
    results.mkdir(parents=True)
    (results / "startup.json").write_text(json.dumps(startup(1.0)))
    (results / "log_fuzz.json").write_text("{}")  # no figures
    for command in (["init", "-q"], ["add", "-A"], [*who, "commit", "-q", "-m", "a"]):
        subprocess.run(["git", "-C", root, *command], check=True)
    (row,) = history.rows_of_git(root)
    assert row.figures == {"embodichain --help, CPU s": (1.0, "CPU s")}

    # A repository of its own: the checkout's history changes.
    monkeypatch.setattr(history, "ROOT", root)
    rows = tmp_path / "rows.jsonl"
    for step in ("clean", "changed"):
        files = ["--rows", str(rows), "--out", str(tmp_path / "page.html")]
        history.main(["--record", "startup", *files])
        (root / "embodichain").mkdir(exist_ok=True)
        (root / "embodichain" / f"{step}.py").touch()
    assert [r.commit for r in history.read(rows)] == [row.commit, f"{row.commit}+"]


def test_every_commits_results_are_kept() -> None:
    """Figures are taken from each benchmark that has a result file, or it is named here."""
    files = {path.stem for path in (history.ROOT / history.RESULTS).glob("*.json")}
    assert files - history.FIGURES.keys() <= {"log_fuzz"}  # counts of outcomes, no performance
    for name in files & history.FIGURES.keys():
        facts = json.loads((history.ROOT / history.RESULTS / f"{name}.json").read_text())
        assert history.row_of("now", name, facts).figures


def test_the_page_is_drawn_from_the_rows() -> None:
    """After adding rows by hand: `python -m benchmarks.history --page`."""
    rows = history.read()
    assert len(rows) > 60
    assert history.PAGE.read_text(encoding="utf-8") == history.page(rows)
