"""The page of a sweep of trainings: the best point, curves over seeds, pictures."""

import re
import sys
from pathlib import Path
from typing import Any

import pytest

from embodichain.cli import main
from tests.helpers.run_folders import make_run, progress, summary_of


def job(sweep: Path, number: int, gamma: float, seed: int, rate: float) -> None:
    summary: dict[str, Any] = summary_of("reach", rate, 100 * rate) | {
        "algo": "ppo",
        "seed": seed,
        "train_seconds": 10.0,
        "env_steps": 4096,
        "mean_return": 100 * rate,
        "objective": rate,
        "episodes": 100,
    }
    folder = make_run(
        sweep,
        str(number),
        config={"algo": {"gamma": gamma}},
        summary=summary,
        progress=progress((1024, 0.0), (2048, 50 * rate), (3072, 80 * rate), (4096, 100 * rate)),
    )
    (folder / "overrides.yaml").write_text(f"[task=reach, ++seed={seed}, ++algo.gamma={gamma}]\n")


def page_of(sweep: Path) -> str:
    (sweep / "multirun.yaml").touch()
    assert main(["report", str(sweep), "--quiet"]) == 0
    return (sweep / "report.html").read_text(encoding="utf-8")


def test_five_seeds_have_an_interval(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    for number, rate in enumerate((0.80, 0.82, 0.84, 0.86, 0.88)):
        job(tmp_path, number, 0.9, number, rate)
        job(tmp_path, number + 5, 0.99, number, rate - 0.4)
    text = page_of(tmp_path)
    best = text.partition('<div class="what">best objective</div>')[2].partition('class="tile"')[0]
    # Student: 0.84 ± 2.776 x 0.03162 / sqrt(5), wider than Wilson of 420 in 500.
    assert "84.0%" in best and "95 % interval 80.1% to 87.9%" in best and "algo.gamma=0.9" in best
    assert "5 seeds" in best and '<svg class="interval"' in best
    figures = re.findall(r"<figcaption><b>(.*?)</b>", text)
    assert figures == ["success rate", "mean return"]
    assert text.count('class="band c0"') == 2 and text.count('class="band c1"') == 2
    assert "no pictures: the run has no log" in text


def test_two_seeds_have_a_line_each(tmp_path: Path) -> None:
    for seed in (1, 2):
        job(tmp_path, seed, 0.9, seed, seed / 4)
    text = page_of(tmp_path)
    assert "37.5%" in text and "25.0, 50.0" in text and "95 % interval" not in text.split("<h2")[0]
    assert "no interval from 2 seeds" in text and "band c0" not in text
    assert text.count('class="line c0 faint"') == 4 and text.count('class="line c0"') == 2
