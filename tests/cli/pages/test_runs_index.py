"""`embodichain report FOLDER`: an index of runs, which a browser sorts, searches and compares."""

import html
import json
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from embodichain.cli import main
from tests.helpers.browser import chromium, needs_chromium
from tests.helpers.run_folders import make_run, progress, summary_of

pytestmark = pytest.mark.slow
HOSTILE = "<img src=x onerror=\"document.title='taken'\"></script><script>document.title='taken'"
"""A name that would do something, were it HTML."""


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    root = tmp_path / "outputs"
    make_run(root, "2026-01-02/a_push", task="push", summary=summary_of("push", 0.5, -3.0))
    trained = summary_of("reach", 0.95, 40.0) | {
        "algo": "ppo",
        "train_seconds": 10.0,
        "env_steps": 4096,
        "mean_return": 40.0,
    }
    for name, gamma, last in (("b_reach", 0.9, 40.0), ("c_reach", 0.99, 9.0)):
        make_run(
            root,
            f"2026-01-03/{name}",
            config={"algo": {"gamma": gamma}, "total_timesteps": 4096},
            summary=trained | {"mean_return": last},
            progress=progress((1024, 1.0), (2048, last / 2), (4096, last)),
            command=f"cd /\nembodichain train task=reach algo.gamma={gamma} --quiet",
        )
    make_run(root, "2026-01-04/d_reach")  # killed
    for index, folder in enumerate(sorted(path.parent for path in root.rglob("config.yaml"))):
        os.utime(folder / "config.yaml", (1000.0 + index, 1000.0 + index))
    return root


def index(root: Path) -> str:
    assert main(["report", str(root), "--quiet"]) == 0
    return (root / "index.html").read_text(encoding="utf-8")


def names(text: str) -> list[str]:
    """The folders of the rows, in order."""
    return [html.unescape(name) for name in re.findall(r'class="folder">(.*?)</span>', text)]


def test_the_index_of_the_working_folder_has_its_name(runs: Path, monkeypatch) -> None:
    monkeypatch.chdir(runs)
    assert main(["report", ".", "--quiet"]) == 0
    text = (runs / "index.html").read_text(encoding="utf-8")
    assert '<p class="soft">outputs</p>' in text
    assert "<title>runs outputs</title>" in text


@contextmanager
def opened(path: Path, width: int = 1400) -> Iterator[Any]:
    """The page in a browser; an error, or something that its policy forbids, is an error here."""
    with chromium() as visit:
        page = visit("about:blank", width, 900)
        errors: list[str] = []
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.on("console", lambda line: errors.append(line.text))
        page.on("dialog", lambda dialog: errors.append(dialog.message))
        page.goto(path.as_uri())
        yield page
        assert errors == []


def shown(page: Any) -> list[str]:
    """The folders of the rows that are seen, in order."""
    rows = page.locator("#runs tbody tr:visible .folder")
    return [text.rpartition("/")[2] for text in rows.all_inner_texts()]


def test_all_runs_are_in_it_the_newest_first(runs: Path) -> None:
    text = index(runs)
    assert [name.partition("/")[2] for name in names(text)] == [
        "d_reach",
        "c_reach",
        "b_reach",
        "a_push",
    ]
    assert "unfinished" in text and "algo.gamma=0.9" in text and "--quiet" not in text
    cells = dict(re.findall(r'data-(success|return)="(-?[\d.]+)"', text.partition("a_push")[2]))
    assert cells == {"success": "0.5", "return": "-3.0"}
    # Wilson's interval of 10 of 20.
    assert "29.9% to 70.1%" in text.partition("a_push")[2]


def test_links_lead_to_reports(runs: Path, tmp_path: Path) -> None:
    odd = make_run(runs, "2026-01-05/javascript:alert(1) #?%41", task="push")
    (odd / "report.html").write_text("here")
    make_run(runs, "sweeps/one/0")
    for name in ("multirun.yaml", "report.html"):
        (runs / "sweeps/one" / name).touch()
    text = index(runs)
    link, sweep = sorted(re.findall(r'<a href="([^"]+)">', text))
    assert sweep == "./sweeps/one/report.html"
    assert link == "./2026-01-05/javascript%3Aalert%281%29%20%23%3F%2541/report.html"
    assert main(["report", str(runs), "-q", "-o", str(tmp_path / "other/page.html")]) == 0
    elsewhere = (tmp_path / "other/page.html").read_text()
    assert '<a href="./../outputs/2026-01-05/' in elsewhere


def test_damage_of_one_run_is_a_row(runs: Path) -> None:
    (runs / "2026-01-02/a_push/summary.json").write_text("{")
    (runs / "2026-01-03/b_reach/overrides.yaml").write_text("[")
    text = index(runs)
    assert len(names(text)) == 4 and text.count(">damaged<") == 2
    assert "summary.json is damaged" in text


@pytest.mark.parametrize(
    "summary",
    [
        {"task": "push", "status": "finished", "return": 3},
        {"task": "push", "status": "finished", "return": {"mean": "x"}, "success_rate": "all"},
        {"task": "push", "status": "another", "algo": [], "eval": {"success": {}}},
        {"task": ["push"], "status": None, "eval": []},
    ],
)
def test_results_of_other_kinds_are_damage(
    runs: Path, summary: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    run = runs / "2026-01-02/a_push"
    (run / "summary.json").write_text(json.dumps(summary))
    assert len(names(index(runs))) == 4
    code = main(["report", str(run)])
    assert code == 0 or (code == 2 and "of another version" in capsys.readouterr().err)


def test_only_runs_are_in_it(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    conf = runs / "conf"
    conf.mkdir()
    (conf / "config.yaml").write_text("defaults: []")
    make_run(runs, ".trash/e_reach")
    make_run(runs, "2026-01-02/a_push/earlier-1")
    (runs / "latest").symlink_to("2026-01-04/d_reach")
    assert len(names(index(runs))) == 4
    assert main(["report", str(conf)]) == 0  # a folder that is named is taken as a run
    capsys.readouterr()
    assert main(["report", str(runs / "2026-01-02/a_push/checkpoints")]) == 2


def test_a_sweep_without_a_finished_training_is_an_index_of_its_jobs(tmp_path: Path) -> None:
    make_run(tmp_path / "sweep", "0", command="cd /\nembodichain train -m task=reach seed=1,2")
    make_run(tmp_path / "sweep", "1", command="cd /\nembodichain train -m task=reach seed=1,2")
    (tmp_path / "sweep/multirun.yaml").touch()
    text = index(tmp_path / "sweep")
    assert "<h1>Sweep</h1>" in text and sorted(names(text)) == ["0", "1"]


@needs_chromium
def test_it_is_sorted_by_columns(runs: Path) -> None:
    index(runs)
    with opened(runs / "index.html") as page:
        assert shown(page) == ["d_reach", "c_reach", "b_reach", "a_push"]
        page.get_by_role("button", name="begun").click()  # it was sorted by this, newest first
        assert shown(page) == ["a_push", "b_reach", "c_reach", "d_reach"]
        page.get_by_role("button", name="return").click()
        # A run without a return is the last, whatever the order is.
        assert shown(page)[-1] == "d_reach" and shown(page)[2] == "a_push"
        page.get_by_role("button", name="return").click()
        assert shown(page)[0] == "a_push" and shown(page)[-1] == "d_reach"
        heads = page.locator("th[aria-sort]")
        assert heads.count() == 1 and heads.get_attribute("aria-sort") == "ascending"
        page.get_by_role("button", name="run").click()
        assert shown(page)[0] == "a_push"


@needs_chromium
def test_it_is_searched_for_words(runs: Path) -> None:
    index(runs)
    with opened(runs / "index.html") as page:
        assert page.inner_text("#count") == "4 runs"
        page.fill("#search", "gamma=0.99 TRAINING")
        assert shown(page) == ["c_reach"] and page.inner_text("#count") == "1 of 4 runs"
        page.fill("#search", "nothing")
        assert shown(page) == []
        page.fill("#search", "")
        assert len(shown(page)) == 4


@needs_chromium
def test_two_that_are_ticked_are_compared(runs: Path) -> None:
    index(runs)
    with opened(runs / "index.html") as page:
        boxes = {name: page.get_by_label(f"{name}") for name in ("b_reach", "c_reach", "a_push")}
        boxes["b_reach"].check()
        assert page.is_hidden("#compared") and page.inner_text("#hint") == "Tick one more."
        boxes["c_reach"].check()
        rows = page.locator("#compared tr").all_inner_texts()
        cells = {row.split("\t")[0]: row.split("\t")[1:] for row in rows}
        assert cells["algo.gamma"] == ["0.9", "0.99"]
        assert "num_envs" not in cells and "total_timesteps" not in cells  # they are the same
        assert cells["status"] == ["finished", "finished"]
        charts = page.locator("#compared figure b").all_inner_texts()
        assert charts == ["success rate", "mean return"]
        assert page.locator("#compared figure").nth(1).locator("path.line").count() == 2
        boxes["a_push"].check()  # the one that was ticked first makes room
        assert not boxes["b_reach"].is_checked() and boxes["c_reach"].is_checked()
        boxes["a_push"].uncheck()
        assert page.is_hidden("#compared")


@needs_chromium
@pytest.mark.parametrize("width", [1400, 400])
def test_nothing_is_cut_off(runs: Path, width: int) -> None:
    make_run(runs, f"2026-01-06/{'x' * 200}", summary=summary_of("y" * 100, 1.0, 1e300))
    index(runs)
    with opened(runs / "index.html", width) as page:
        for box in page.locator("#runs input").all()[:2]:
            box.check()
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        assert page.get_by_role("button", name="success").is_visible()


@needs_chromium
def test_hostile_text_does_nothing(runs: Path) -> None:
    name = HOSTILE.replace("/", "\u2215")
    folder = make_run(
        runs,
        f"2026-01-07/{name}",
        task=HOSTILE,
        config={"task": {"description": HOSTILE, HOSTILE: HOSTILE}},
        summary=summary_of(HOSTILE, 1.0, 1.0) | {"rewards": {HOSTILE: 1.0}},
    )
    (folder / "run.log").write_text(HOSTILE)
    raw = os.fsencode(runs) + b"/2026-01-07/\xff\xfe"  # not UTF-8
    os.rename(make_run(runs, "2026-01-07/raw"), raw)
    assert main(["report", str(folder), "--quiet"]) == 0
    index(runs)
    for path in (runs / "index.html", folder / "report.html"):
        with opened(path) as page:
            title = page.title()
            for box in page.locator("#runs input").all()[:2]:
                box.check()
            page.wait_for_timeout(200)
            assert page.title() == title and title != "taken"
            assert page.locator("img[onerror]").count() == 0
            assert HOSTILE in page.inner_text("body")


@needs_chromium
def test_a_script_that_was_changed_does_not_run(runs: Path) -> None:
    """The policy has the script's hash: a page with another script sorts nothing."""
    text = index(runs)
    (runs / "changed.html").write_text(text.replace('"use strict";', '"use strict"; // x'))
    with chromium() as visit:
        page = visit("about:blank", 700, 900)
        errors: list[str] = []
        page.on("console", lambda line: errors.append(line.text))
        page.goto((runs / "changed.html").as_uri())
        assert page.is_hidden("#tools") and page.locator("th button").count() == 0
        assert any("Content Security Policy" in error for error in errors)
        assert len(shown(page)) == 4  # the table is whole without it


def test_a_picture_of_the_log_is_drawn_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = ["run", "task=cart_pole", "episodes=1", "num_envs=1", "task.max_episode_steps=8"]
    assert main([*run, "scene_png=false", f"output_dir={tmp_path}", "--quiet"]) == 0
    capsys.readouterr()
    assert main(["report", str(tmp_path)]) == 0
    assert "they stay in their folders, as thumbnail.jpg" in capsys.readouterr().err
    assert main(["report", str(tmp_path)]) == 0
    assert capsys.readouterr().err == ""
    text = index(tmp_path)
    (drawn,) = tmp_path.glob("*/*/thumbnail.jpg")
    assert text.count('<img src="data:image/jpeg;base64,') == 1
    before = drawn.stat().st_mtime_ns
    assert index(tmp_path) == text and drawn.stat().st_mtime_ns == before
    os.utime(drawn, (0, 0))  # older than the log, as after a resumption
    index(tmp_path)
    assert drawn.stat().st_mtime_ns > before


def test_without_a_renderer_it_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = ["run", "task=cart_pole", "episodes=1", "num_envs=1", "task.max_episode_steps=8"]
    assert main([*run, "scene_png=false", f"output_dir={tmp_path}", "--quiet"]) == 0
    monkeypatch.setenv("EMBODICHAIN_RENDERER", "rays")
    text = index(tmp_path)
    assert "<img" not in text and "no picture of " in text and "colours need OpenGL" in text
