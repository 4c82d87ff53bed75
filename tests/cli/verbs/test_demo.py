"""`embodichain demo`: a film without a display, a page with a browser, and what is refused."""

import importlib.util
import json
import re
from pathlib import Path

import pytest
from PIL import Image

from embodichain.cli import main
from embodichain.cli.verbs.running import demo
from embodichain.config import resolve
from embodichain.data.pretrained import pretrained_tasks
from tests.helpers.browser import chromium, needs_chromium

pytestmark = pytest.mark.slow

FILM = ["video.size=[48,32]", "video.max_seconds=0.2", "--json"]


def test_without_a_display_it_is_a_film_of_a_success(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    found = importlib.util.find_spec
    encoder = "imageio_ffmpeg"  # as in an installation without extras
    monkeypatch.setattr(importlib.util, "find_spec", lambda n: None if n == encoder else found(n))
    assert main(["demo", *FILM]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["task"], told["policy"], told["success_rate"]) == ("pick_place", "expert", 1.0)
    with Image.open(told["video"]) as film:
        assert (film.format, film.size, film.n_frames) == ("GIF", (48, 32), 5)
    assert Path(told["folder"]).resolve().parents[1] == tmp_path / "outputs"


def test_a_trained_policy_plays_where_one_ships(tmp_path, capsys):
    lines = [
        f"output_dir={tmp_path}",
        "task.max_episode_steps=60",
        "num_envs=2",
        "allow_changed=true",
    ]
    assert main(["demo", "reach", "--film", *lines, *FILM]) == 0
    told = json.loads(capsys.readouterr().out)
    assert Path(told["policy"]).name == "reach.pt"
    assert (told["success_rate"], told["seed"], told["num_envs"]) == (1.0, 1, 2)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--web", "--film"], "--web and --film exclude each other"),
        (["no_such_task"], "no_such_task"),
        (["hold_still"], r"hold_still has no `expert`, and no trained policy ships .*train task="),
    ],
)
def test_what_cannot_be_shown_is_refused(words, said, capsys):
    assert main(["demo", *words]) == 2
    assert re.search(said, capsys.readouterr().err.replace("\n", " "))


@pytest.mark.unmeasured
@needs_chromium
def test_a_browser_starts_it_and_the_last_episode_ends_it(commands, tmp_path):
    words = ["reach", "--web", "episodes=1", "task.max_episode_steps=40", "allow_changed=true"]
    process = commands.start("demo", *words, "--json", cwd=tmp_path)
    try:
        lines = iter(process.stderr.readline, "")
        url = next(found[0] for line in lines if (found := re.search(r"http://\S+", line)))
        with chromium() as visit:
            visit(url, 320, 240)
            out, _ = process.communicate(timeout=120)
    finally:
        process.kill()
    assert json.loads(out) == {"task": "reach", "episodes": 1, "success": 1.0}
    assert process.returncode == 0


def test_a_page_that_nobody_opens_waits_until_it_is_stopped(tmp_path, monkeypatch, capsys):
    opened = []
    # A desktop whose user stops the command once the page is open.
    monkeypatch.setattr(demo.webbrowser, "open", lambda url: opened.append(url) or False)
    monkeypatch.setattr("embodichain.utils.system.display.has_display", lambda: True)
    monkeypatch.setattr(
        "embodichain.cli.terminal.process.StopFlag.is_stopped", lambda self: bool(opened)
    )
    assert main(["demo", "cart_pole", f"output_dir={tmp_path}"]) == 0
    out, err = capsys.readouterr()
    assert opened[0].startswith("http://127.0.0.1:")
    # The printed address may be opened more than once.
    assert "viewer: http://127.0.0.1:" in err and opened[0] not in err
    assert "no browser could be opened here" in err and "waiting 30 s for the page" in err
    assert re.search(r"episodes +0\n", out)


def test_three_demos_are_listed_which_need_nothing_more(capsys):
    assert main(["demo", "--list", "--json"]) == 0
    demos = json.loads(capsys.readouterr().out)["demos"]
    assert len(demos) == 3
    for entry in demos:
        assert entry["command"] == f"embodichain demo {entry['task']}"
        resolved = resolve([f"task={entry['task']}"])
        assert entry["task"] in pretrained_tasks() or resolved.tree["task"]["expert"]
        robot = str(resolved.tree["task"]["robot"]["fpath"])
        assert "example-robot-data" not in robot and not robot.startswith("/")
    assert main(["demo", "--list"]) == 0
    assert "embodichain demo pick_place" in capsys.readouterr().out
    assert main(["demo", "push_cube", "--list"]) == 2
    assert "type it alone" in capsys.readouterr().err


def test_policies_that_ship_are_listed(capsys):
    assert main(["list", "policies", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["policies"]
    assert [row["task"] for row in rows] == pretrained_tasks()
    assert all(re.match(r"9\d\.\d%|100\.0%  \[", row["success"]) for row in rows)
