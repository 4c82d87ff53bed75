"""The page of `viewer=web` in Chromium: what it shows, and what its keys do to the run."""

import threading
import time

import pytest
import torch

from embodichain.config import make_env, resolve
from embodichain.recording.viewers.web import WebView
from tests.helpers.browser import chromium, needs_chromium, picture, share_of

pytestmark = [needs_chromium, pytest.mark.slow]

BLUE, MAGENTA = (0.36, 0.62, 0.84), (1.0, 0.0, 1.0)  # of the UR10's joints; of nothing
HALO = (0.6, 0.95, 0.6)  # a third of green over the floor
SECONDS = 60.0


class Run:
    """An environment that steps in a thread of its own until it is told to stop."""

    def __init__(self):
        overrides = ["task=push_cube", "num_envs=2", "seed=1", "sim.num_threads=1"]
        overrides += ["task.max_episode_steps=1000000"]  # only a key ends an episode
        overrides += ["task.objects.goal.halo={radius: 0.25, color: [0, 1, 0]}"]
        self.env = make_env(resolve(overrides))
        self.view = WebView(self.env, stopped=lambda: self.stopped)
        self.env.add_observer(self.view)
        self.stopped = False
        self.truncated = []
        self.thread = threading.Thread(target=self.play)
        self.thread.start()

    def play(self):
        self.env.reset()
        action = torch.zeros(self.env.action_space.shape)
        while not self.stopped:
            *_, truncated, info = self.env.step(action)
            if bool(truncated.any()):
                steps = info["elapsed_steps"].tolist()
                self.truncated += [(i, steps[i]) for i, cut in enumerate(truncated) if cut]

    def close(self):
        self.stopped = True
        self.thread.join()
        self.env.close()

    @property
    def controls(self):
        # What the browser's last message said; a run sees only its effects.
        return self.view._page._controls


@pytest.fixture(scope="module")
def run():
    run = Run()
    yield run
    run.close()


@pytest.fixture(scope="module")
def visit(run):
    """Opens the run's page in a browser of its own, and waits until the robot is seen."""
    with chromium() as open_page:

        def visit(width, height, least):
            page = open_page(run.view.url, width, height)
            wait(lambda: share_of(picture(page), BLUE) > least, 0.3)
            return page

        yield visit


@pytest.fixture(scope="module")
def page(visit):
    """The first one: it has the panel."""
    return visit(520, 300, 0.0005)


def wait(condition, pause=0.05):
    """Wait until something is so; fail if it never is."""
    end = time.monotonic() + SECONDS
    while not condition():
        assert time.monotonic() < end
        time.sleep(pause)


def press(page, key, expected):
    """Press a key, again if the page was too busy to see it, until it had an effect."""
    end = time.monotonic() + SECONDS
    while time.monotonic() < end:
        page.keyboard.press(key, delay=150)
        deadline = time.monotonic() + 3
        while time.monotonic() < deadline:
            if expected():
                return
            time.sleep(0.05)
    pytest.fail(f"{key} had no effect")


def stands(run):
    """Whether the run takes no step for a while."""
    before = run.env.control_step
    time.sleep(0.3)
    return run.env.control_step == before


def test_the_page_shows_the_robot_and_the_panel(page):
    image = picture(page)
    assert share_of(image, BLUE) > 0.0005
    assert share_of(image, MAGENTA) == 0.0  # what is not there
    panel = image[84:124, 10:240].mean(axis=2)  # below the scene: the page is narrow
    assert (panel < 70).mean() > 0.7  # dark, with text on it
    assert (panel > 120).mean() > 0.01
    assert (image[:75].mean(axis=2) < 70).mean() < 0.2  # the scene
    press(page, "p", lambda: (picture(page)[84:124, 10:240].mean(axis=2) < 70).mean() < 0.5)


def test_the_page_shows_halos(page):
    wait(lambda: share_of(picture(page), HALO) > 0.005)


def test_keys_pause_step_and_end_an_episode(page, run):
    press(page, "Space", lambda: run.controls.paused)
    wait(lambda: stands(run))
    step, asked = run.env.control_step, run.controls.steps
    press(page, "ArrowRight", lambda: run.controls.steps > asked)
    wait(lambda: stands(run))
    assert run.env.control_step - step == run.controls.steps - asked >= 1
    ends, asked = len(run.truncated), run.controls.resets
    press(page, "Backspace", lambda: run.controls.resets > asked)
    press(page, "ArrowRight", lambda: len(run.truncated) > ends)
    env_id, steps = run.truncated[ends]
    assert env_id == 0 and steps < run.env.max_episode_steps
    press(page, "Space", lambda: not run.controls.paused)
    wait(lambda: not stands(run))


def test_a_second_browser_looks_on_and_no_tab_stops_the_run(page, visit, run):
    second = visit(320, 200, 0.002)  # the whole robot: it has no panel
    assert not run.controls.paused
    press(page, "Space", lambda: run.controls.paused)
    page.context.browser.close()
    wait(lambda: not run.controls.paused)  # the browser that requested the pause is gone
    wait(lambda: not stands(run))
    assert run.view.watched
    before = picture(second)
    wait(lambda: (picture(second) != before).any())  # and is still shown what happens
    second.context.browser.close()
    wait(lambda: not run.view.watched)
    wait(lambda: not stands(run))
