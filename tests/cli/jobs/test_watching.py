"""Commands with a viewer wait for the first who looks, and stay until the last one is gone."""

import json
import re
import time
from contextlib import contextmanager
from urllib.parse import urlsplit

import pytest
from websockets.sync.client import connect

import embodichain.recording as recording
from embodichain.cli import main
from embodichain.cli.app import call
from embodichain.cli.jobs.watching import Watching
from embodichain.cli.terminal.process import StopFlag
from embodichain.config import resolve
from embodichain.recording.viewers.showing import Audience
from embodichain.utils.errors import ConfigError
from tests.helpers import doors
from tests.helpers.browser import chromium, needs_chromium
from tests.helpers.terminals import Terminal

pytestmark = pytest.mark.slow

SHORT = ("task=random_reach", "num_envs=2", "seed=1", "scene_png=false")
STEP_S = 0.04  # of the task's control step
WAITS = "waiting until the page is opened"
STAYS = "the run is over: close the page"


def url_of(text):
    """The address that was printed."""
    match = re.search(r"viewer: ((?:http|ws)\S+)", text)
    assert match is not None, text
    return match[1]


@contextmanager
def page_at(url, **options):
    """An open page, without a browser: its connection."""
    parts = urlsplit(url)
    path = "/state?sid=me" if parts.scheme == "http" else "/"
    headers = doors.bearer(url)
    # Nobody reads what comes: without a limit the connection takes it all.
    options = {"close_timeout": 0.1, "max_queue": None, "additional_headers": headers, **options}
    with connect(f"ws://{parts.netloc}{path}", **options) as page:
        yield page


def the_log(folder):
    """The log below a folder; it is complete."""
    (path,) = folder.rglob("rollout.mcap")
    with recording.open(path) as log:
        assert log.complete
        return log


def the_summary(folder):
    (path,) = folder.rglob("summary.json")
    return json.loads(path.read_text())


def test_in_a_terminal_a_run_waits_plays_in_real_time_and_stays(commands, tmp_path):
    with Terminal(commands, "run", *SHORT, "max_steps=30", "viewer=web", cwd=tmp_path) as terminal:
        terminal.until(WAITS)
        assert terminal.stands(1.0)  # without the key and the page it waits
        start = time.monotonic()
        with page_at(url_of(terminal.text)):
            terminal.until(STAYS)
            assert time.monotonic() - start >= 29 * STEP_S * 0.9
            # What it has done is on the disk while it stays: it may be killed with its terminal.
            assert the_summary(tmp_path)["control_steps"] == 30
            assert the_log(tmp_path).num_envs == 2
            assert terminal.stands(1.0)
        assert terminal.wait() == 0
    assert "max_steps" in terminal.text


def test_a_key_skips_the_wait_and_nobody_is_waited_for_at_the_end(commands, tmp_path):
    with Terminal(commands, "run", *SHORT, "max_steps=5", "viewer=web", cwd=tmp_path) as terminal:
        terminal.until(WAITS)
        terminal.press("x")
        assert terminal.wait() == 0
    assert "the page was not waited for: the run goes on without it" in terminal.text
    assert STAYS not in terminal.text
    assert the_summary(tmp_path)["status"] == "max_steps"


def test_ctrl_c_while_it_waits_interrupts_and_while_it_stays_does_not(commands, tmp_path):
    waiting = tmp_path / "waiting"
    waiting.mkdir()
    with Terminal(commands, "run", *SHORT, "max_steps=5", "viewer=web", cwd=waiting) as terminal:
        terminal.until(WAITS)
        terminal.press("\x03")
        assert terminal.wait() == 130
    assert "interrupted (SIGINT)" in terminal.text.splitlines()[-1]
    assert the_summary(waiting)["control_steps"] == 0
    staying = tmp_path / "staying"
    staying.mkdir()
    with Terminal(commands, "run", *SHORT, "max_steps=5", "viewer=web", cwd=staying) as terminal:
        terminal.until(WAITS)
        with page_at(url_of(terminal.text)):
            terminal.until(STAYS)
            terminal.press("\x03")
            assert terminal.wait() == 0
    assert "interrupted" not in terminal.text
    the_log(staying)


def test_a_page_that_is_loaded_again_is_waited_for_and_one_that_is_closed_is_not(
    commands, tmp_path
):
    words = ("run", *SHORT, "episodes=1000", "max_steps=2000", "viewer=web", "record=none")
    with Terminal(commands, *words, cwd=tmp_path) as terminal:
        terminal.until(WAITS)
        with page_at(url_of(terminal.text)):
            time.sleep(0.5)
        with page_at(url_of(terminal.text)):  # as when it is loaded again
            time.sleep(0.5)
            assert "was closed" not in terminal.text
        terminal.until("the page was closed: the run goes on without it")
        assert terminal.wait() == 0
    assert the_summary(tmp_path)["control_steps"] == 2000


def test_foxglove_is_waited_for_too(commands, tmp_path):
    words = ("run", *SHORT, "max_steps=30", "viewer=foxglove", "viewer.port=18766", "record=none")
    with Terminal(commands, *words, cwd=tmp_path) as terminal:
        terminal.until("waiting until the connection is opened")
        start = time.monotonic()
        with page_at(url_of(terminal.text), subprotocols=["foxglove.websocket.v1"]):
            terminal.until("the run is over: close the connection")
            assert time.monotonic() - start >= 29 * STEP_S * 0.9
        assert terminal.wait() == 0


@pytest.mark.parametrize(("viewer", "what"), [("web", "the page"), ("foxglove", "the connection")])
def test_without_a_terminal_it_waits_for_some_seconds(viewer, what, capsys):
    words = ["run", *SHORT, "max_steps=3", "record=none", f"viewer={viewer}"]
    start = time.monotonic()
    assert main([*words, "viewer.wait_s=1.5"]) == 0
    assert time.monotonic() - start > 1.5
    printed = capsys.readouterr().err
    assert f"viewer: waiting 1.5 s for {what} to be opened\n" in printed
    assert f"viewer: {what} was not opened: the run goes on without it\n" in printed
    assert main([*words, "viewer.wait_s=0"]) == 0
    assert "waiting" not in capsys.readouterr().err


def test_without_a_terminal_it_ends_when_the_run_is_over(commands, tmp_path):
    words = ("run", *SHORT, "max_steps=30", "viewer=web", "record=none")
    started = commands.start(*words, cwd=tmp_path)
    printed = ""
    while "waiting 30 s for the page" not in printed:
        printed += started.stderr.readline()
    with page_at(url_of(printed)):
        assert started.wait(30) == 0


def test_a_window_that_was_closed_stays_closed(capsys):
    is_open = [True]
    window = Audience(is_watched=lambda: is_open[0], what="the window", may_return=False)
    watching = Watching(window, wait_s=30.0, stop=StopFlag())
    assert watching.wait() and watching.hold()
    is_open[0] = False
    assert not watching.hold()
    assert capsys.readouterr().err == "viewer: the window was closed: the run goes on without it\n"
    assert watching.hold()  # nobody looks any more: it goes on
    watching.stay()


def test_jobs_of_a_sweep_do_not_wait(capsys):
    words = [
        "run",
        "-m",
        *SHORT[:2],
        "scene_png=false",
        "seed=1,2",
        "hydra/launcher=basic",  # workers import everything anew: seconds of CPU time
        "max_steps=3",
        "record=none",
        "viewer=foxglove",
    ]
    assert main([*words, "viewer.port=18767"]) == 0
    assert "waiting" not in capsys.readouterr().err


def test_training_and_evaluation_do_not_wait(capsys):
    tiny = ("algo.n_steps=8", "algo.batch_size=8", "total_timesteps=16", "record=none")
    assert main(["train", "task=cart_pole", *tiny, "eval.episodes=2", "viewer=web"]) == 0
    assert main(["eval", "last", "episodes=2", "viewer=web"]) == 0
    assert "waiting" not in capsys.readouterr().err


def test_a_log_is_played_until_the_page_is_closed(commands, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["run", *SHORT, "max_steps=20", "--quiet"]) == 0
    with Terminal(commands, "replay", "last", "--view", "web", cwd=tmp_path) as terminal:
        terminal.until(f"{WAITS}; any key or Ctrl-C ends it")
        with page_at(url_of(terminal.text)):
            assert terminal.stands(5.0)  # longer than the log: it begins again
        assert terminal.wait() == 0
    with Terminal(commands, "replay", "last", "--view", "web", cwd=tmp_path) as terminal:
        terminal.until(WAITS)
        terminal.press(" ")
        assert terminal.wait() == 0
    assert "nothing was played" in terminal.text


def test_without_a_terminal_a_log_is_played_once(commands, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["run", *SHORT, "max_steps=20", "--quiet"]) == 0
    assert main(["replay", "last", "--view", "web", "--wait", "0.5"]) == 0
    started = commands.start("replay", "last", "--view", "web", cwd=tmp_path)
    printed = ""
    while "waiting 30 s for the page" not in printed:
        printed += started.stderr.readline()
    with page_at(url_of(printed)):
        assert started.wait(30) == 0
    with pytest.raises(ConfigError, match="--wait needs --view"):
        call(["replay", "last", "--wait", "3"])


def test_the_demo_waits_and_ends_with_its_page(commands, tmp_path):
    words = ("demo", "push_cube", "--web", "episodes=1000")
    with Terminal(commands, *words, cwd=tmp_path) as terminal:
        terminal.until(WAITS)
        with page_at(url_of(terminal.text)):
            assert terminal.stands(1.0)
        terminal.until("the page was closed: that ends the demo")
        assert terminal.wait() == 0
    assert "episodes" in terminal.text.partition("that ends the demo")[2]


def test_the_time_to_wait_is_checked():
    assert resolve([*SHORT]).root.viewer.wait_s == 30.0
    assert resolve([*SHORT, "viewer=web", "viewer.wait_s=inf"]).root.viewer.wait_s == float("inf")
    with pytest.raises(ConfigError, match=r"viewer\.wait_s"):
        resolve([*SHORT, "viewer=web", "viewer.wait_s=-1"])


@needs_chromium
def test_the_page_has_the_tasks_name(commands, tmp_path):
    with Terminal(commands, "run", *SHORT, "max_steps=3", "viewer=web", cwd=tmp_path) as terminal:
        terminal.until(WAITS)
        with chromium() as visit:
            page = visit(url_of(terminal.text), 420, 600)
            terminal.until(STAYS)
            page.wait_for_function("Module.calledRun === true")
            assert page.title() == "random_reach"
            page.context.browser.close()
        assert terminal.wait() == 0
