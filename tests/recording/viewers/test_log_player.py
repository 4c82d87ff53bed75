"""A log on a screen: which states are shown, in which order, and the controls meanwhile."""

import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest

import embodichain
import embodichain.recording as recording
from embodichain.cli.app import call
from embodichain.recording import McapRecorder
from embodichain.recording.viewers import log_player
from embodichain.recording.viewers.log_player import NativeScreen, play_log
from embodichain.recording.viewers.page.web_page import PageOptions, WebPage
from embodichain.utils.errors import ConfigError
from embodichain.utils.number_text import signed_number
from tests.helpers.browser import chromium, needs_chromium, picture, share_of
from tests.recording.scene import SmallEnv

pytestmark = pytest.mark.slow

BLUE = (0.36, 0.62, 0.84)  # of the UR10's joints


@pytest.fixture
def path(tmp_path):
    """A log of three environments with 20 steps."""
    env = SmallEnv()
    env.add_observer(McapRecorder(tmp_path / "log.mcap", env, task="small"))
    env.reset()
    for _ in range(20):
        env.step()
    env.close()
    return tmp_path / "log.mcap"


class Screen:
    """Keeps what it is shown; `then` is done when a number of states was shown."""

    def __init__(self, then, env_id=0):
        self.then, self.env_id = then, env_id
        self.is_open = self.watched = True
        self.shown, self.waits, self.models = [], [], []

    def begin(self, engine):
        self.models.append(engine.model_field("body_mass")[0].copy())

    def show(self, row, facts, commands):
        self.shown.append((self.env_id, facts.step, row.copy(), facts))
        self.then.get(len(self.shown), lambda screen: None)(self)

    def pace(self, seconds):
        self.waits.append(seconds)

    def close(self):
        pass


def shut(screen):
    screen.is_open = False


def test_states_come_in_order_with_rewards_and_each_episodes_model(path):
    screen = Screen({20: shut}, env_id=1)
    with recording.open(path) as log:
        play_log(log, screen, speed=2.0)
        data = log.read(["qpos", "rewards", "episodes"], env=1)
    assert [step for _, step, *_ in screen.shown] == list(range(20))
    for (_, step, row, facts), wait in zip(screen.shown, screen.waits, strict=True):
        assert row[1:10].tolist() == data["qpos"][step, 0, :9].tolist()
        assert facts.lines[1] == ("reward", signed_number(data["rewards"][step, 0]))
        assert wait == pytest.approx(0.01)  # steps of 0.02 s, twice as fast
    # It is shown anew when an episode begins: a reset randomizes the cube's mass.
    assert len(screen.models) == len(set(data["episodes"][:, 0].tolist())) == 3


def test_it_begins_anew_and_goes_on_with_another_environment(path, monkeypatch):
    # It shows the last state for a second.
    monkeypatch.setattr("embodichain.recording.viewers.log_player._AT_THE_END", 0.0)

    def choose(screen):
        screen.env_id = 2

    screen = Screen({8: choose, 12: shut})
    with recording.open(path) as log:
        play_log(log, screen, first=3, last=7)
    steps = [(env, step) for env, step, *_ in screen.shown]
    again = [(0, 3), (0, 4), (0, 5)]
    assert steps == [*((0, t) for t in range(3, 8)), *again, *((2, t) for t in (5, 6, 7, 3))]


def test_a_log_is_played_while_it_is_watched(path):
    screen = Screen({4: shut})
    screen.watched = False
    with recording.open(path) as log:
        thread = threading.Thread(target=play_log, args=(log, screen))
        thread.start()
        time.sleep(0.3)
        assert not screen.shown
        screen.watched = True
        thread.join(10)
    assert len(screen.shown) == 4


def test_a_stop_ends_it_and_wrong_parts_are_refused(path):
    screen = Screen({})
    with recording.open(path) as log:
        play_log(log, screen, stopped=lambda: len(screen.shown) == 5)
        assert len(screen.shown) == 5
        with pytest.raises(ConfigError, match="nothing to show"):
            play_log(log, Screen({}), first=50)
        with pytest.raises(ConfigError, match="no episode 9"):
            play_log(log, Screen({}), episode=9)


def test_the_window_pauses_at_the_space_bar(path, monkeypatch):
    class Window:
        is_running = True

        def __init__(self, engine, env_id, on_key):
            self.on_key, self.states = on_key, []
            self.follow(engine)

        def follow(self, engine):
            self.engine = engine

        def sync(self):
            self.states.append(self.engine.rows[0].copy())
            if len(self.states) == 5:
                self.on_key(32)

        def close(self):
            self.is_running = False

    windows = []
    # There is no display here: this window presses keys.
    monkeypatch.setattr(
        log_player, "NativeViewer", lambda *args: windows.append(Window(*args)) or windows[-1]
    )
    stopped = []
    screen = NativeScreen(0, lambda: bool(stopped))
    with recording.open(path) as log:
        thread = threading.Thread(
            target=play_log, args=(log, screen), kwargs={"speed": 10.0, "stopped": lambda: stopped}
        )
        thread.start()
        time.sleep(0.5)
        assert len(windows[0].states) == 5
        windows[0].on_key(32)
        time.sleep(0.3)
        assert len(windows[0].states) > 5
        stopped.append(True)
        thread.join(10)
    screen.close()
    assert len(windows) == 1 and not windows[0].is_running


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--view", "foxglove"], "embodichain view FILE"),
        (["--view", "hologram"], "there are native, web"),
        (["--view", "native", "--port", "1"], "--host and --port are for --view web"),
        (["--view", "native", "--token", "x"], "--token, --allow-host and --allow-origin are for"),
        (["--allow-origin", "https://a.example"], "--allow-origin needs --view"),
        (["--view", "web", "--speed", "0"], "'--speed': 0.0 is not in the range x>0"),
        (["--view", "--env", "7"], "no environment 7"),
        (["--port", "8080"], "--port needs --view"),
        (["--view", "--verify"], "--verify and --view exclude each other"),
    ],
    ids=str,
)
def test_options_of_the_command(path, options, message):
    with pytest.raises(ConfigError, match=message):
        call(["replay", str(path), *options])


@pytest.mark.slow
@needs_chromium
def test_the_page_shows_the_log(tmp_path):
    env = embodichain.make("push_cube", num_envs=1, overrides=["seed=1"])
    env.add_observer(McapRecorder(tmp_path / "log.mcap", env, task="push_cube"))
    env.reset()
    for _ in range(10):
        env.step(np.zeros((1, 6), np.float32))
    env.close()
    with recording.open(tmp_path / "log.mcap") as log:
        page = WebPage(log.model, PageOptions(resets=False))
        stop = SimpleNamespace(now=False)
        arguments = {"speed": 0.1, "stopped": lambda: stop.now}
        thread = threading.Thread(target=play_log, args=(log, page), kwargs=arguments)
        thread.start()
        try:
            with chromium() as visit:
                browser = visit(page.url, 520, 300)
                end = time.monotonic() + 60
                while share_of(picture(browser), BLUE) < 0.0005:
                    assert time.monotonic() < end
                    time.sleep(0.3)
        finally:
            stop.now = True
            thread.join(30)
            page.close()
    assert not thread.is_alive()
