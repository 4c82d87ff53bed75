"""People move the robot on the page of `viewer=web`: Chromium reads the page and presses keys."""

import re
import threading
import time

import pytest

import embodichain.recording as recording
from embodichain.cli import main
from embodichain.lab.gym.teleop import DISCARDED
from embodichain.recording.chunks import LogReader
from embodichain.recording.collection import read_collection
from embodichain.recording.verification import verify
from embodichain.recording.viewers.web_page import WebPage
from tests.helpers.browser import chromium, needs_chromium

pytestmark = [needs_chromium, pytest.mark.unmeasured]

SECONDS = 60.0
PACE = 3.0
"""Simulated seconds per second."""
KEYS = {
    "x": ("KeyW", "KeyS"),
    "y": ("KeyA", "KeyD"),
    "z": ("KeyE", "KeyQ"),
    "yaw": ("KeyJ", "KeyL"),
}


def wait(condition, pause=0.01):
    end = time.monotonic() + SECONDS
    while not (found := condition()):
        assert time.monotonic() < end
        time.sleep(pause)
    return found


class Run(threading.Thread):
    """`embodichain run policy=teleop` in a thread of its own."""

    def __init__(self, folder, verb, *overrides):
        super().__init__(daemon=True)
        self.folder, self.result = folder, None
        self.line = [
            *(verb, "task=pick_place", "policy=teleop", "viewer=web", "scene_png=false"),
            *("seed=4", f"output_dir={folder}", "task.max_episode_steps=2000", *overrides),
        ]
        self.start()

    def run(self):
        self.result = main(self.line)

    def url(self):
        logs = wait(lambda: list(self.folder.rglob("run.log")))
        return wait(lambda: re.search(r"viewer: (http\S+)", logs[0].read_text()))[1]

    @property
    def log(self):
        return next(self.folder.rglob("rollout.mcap"))


class Person:
    """Reads the panel of the page, and presses keys."""

    def __init__(self, page):
        self.page, self.down = page, set()
        wait(lambda: "you move the robot" in self.read("role"))

    def read(self, name):
        return self.page.inner_text(f"#teleop-{name}")

    def pose(self, name):
        """mm and degrees."""
        row = f"#teleop-poses [data-name={name}]"
        numbers = [float(t.strip("\u00b0")) for t in self.page.inner_text(row).split()[1:]]
        return dict(zip(("x", "y", "z", "roll", "pitch", "yaw"), numbers, strict=True))

    def hold(self, keys):
        for key in self.down - keys:
            self.page.keyboard.up(key)
        for key in keys - self.down:
            self.page.keyboard.down(key)
        self.down = set(keys)

    def go(self, near=4.0, **goal):
        """Brings the tool to coordinates, mm and degrees."""

        still = None  # since which step nothing is pressed: the arm is behind its targets

        def arrived():
            nonlocal still
            at, keys = self.pose("tool"), set()
            way = {name: value - at[name] for name, value in goal.items()}
            if "yaw" in way:  # a gripper is the same after half a turn
                way["yaw"] = (way["yaw"] + 90) % 180 - 90
            for name, distance in way.items():
                if abs(distance) > near:
                    keys.add(KEYS[name][distance < 0])
            if keys and max(map(abs, way.values())) < 40:
                keys.add("ShiftLeft")
            self.hold(keys)
            still = None if keys else self.steps() if still is None else still
            return not keys and self.steps() > still + 8

        wait(arrived, pause=0.0)

    def grip(self, closed):
        self.page.keyboard.press("Space")
        wait(lambda: ("gripper closed" in self.page.inner_text("#teleop h1")) == closed)
        steps = self.steps()
        wait(lambda: self.steps() > steps + 12)

    def steps(self):
        return int(re.search(r"step (\d+)", self.read("progress"))[1])

    def pick_and_place(self):
        cube, stand = self.pose("cube"), self.pose("stand")
        turn = self.pose("tool")["yaw"]
        turn += (cube["yaw"] - turn + 45) % 90 - 45  # the fingers parallel to faces
        self.go(x=cube["x"], y=cube["y"], yaw=turn)
        self.go(z=cube["z"])
        self.grip(closed=True)
        self.go(z=cube["z"] + 90, near=20)
        self.go(x=stand["x"], y=stand["y"])
        self.go(z=cube["z"] + 43, near=3)
        self.grip(closed=False)
        print(
            time.monotonic(),
            self.read("progress"),
            self.pose("tool"),
            self.pose("cube"),
            self.pose("stand"),
            flush=True,
        )
        wait(lambda: any("success" in self.read(name) for name in ("progress", "last")))


@pytest.fixture
def quick(monkeypatch):
    pace = WebPage.pace
    monkeypatch.setattr(WebPage, "pace", lambda page, s, changed: pace(page, s / PACE, changed))


@pytest.fixture(scope="module")
def visit():
    """Opens a page; without `scene` it has the operator's panel only, which costs less."""
    with chromium() as open_page:

        def visit(url, scene=False, script=None):
            page = open_page("about:blank", 700, 500)
            if script is not None:
                page.add_init_script(script)
            if not scene:
                page.route("**/web_client.js", lambda route: route.abort())
            page.goto(url)
            return page

        yield visit


def test_ten_demonstrations_with_the_keyboard(tmp_path, quick, visit):
    run = Run(tmp_path, "run", "episodes=10")
    person = Person(visit(run.url()))
    for episode in range(10):
        person.pick_and_place()
        person.page.keyboard.press("Enter")
        if episode < 9:
            wait(lambda n=episode: f"episode {n}: success" in person.read("last"))
    run.join()
    assert run.result == 0
    with LogReader(run.log) as reader:
        assert reader.header.policy == "teleop"
    with recording.open(run.log) as log:
        assert [episode.succeeded for episode in log.episodes] == [True] * 10
    assert verify(run.log).ok


PAD = """
window.pad = null;
navigator.getGamepads = () => [window.pad && {
  connected: true, axes: window.pad[0],
  buttons: [...Array(17).keys()].map((i) => ({pressed: window.pad[1].includes(i)}))}];
"""


def test_a_gamepad_and_the_mouse_collect_what_is_not_discarded(tmp_path, quick, visit):
    run = Run(tmp_path, "collect", "episodes=1", "collect.success_steps=5")
    page = visit(run.url(), script=PAD)
    person = Person(page)

    def pad(axes=(0, 0, 0, 0), buttons=()):
        page.evaluate("pad => { window.pad = pad; }", [list(axes), list(buttons)])

    # the right stick turns about z while it is held; A is the gripper
    yaw = person.pose("tool")["yaw"]
    pad(axes=(0, 0, -0.8, 0))
    wait(lambda: person.pose("tool")["yaw"] > yaw + 10)
    pad(buttons=[0])
    wait(lambda: "gripper closed" in page.inner_text("#teleop h1"))
    assert page.is_visible("text=left stick")
    pad()
    # the ring is dragged upwards
    wait(lambda: page.is_visible("#teleop-handle"))
    at = person.pose("tool")
    box = page.locator("#teleop-handle").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x, y - 40, steps=4)
    wait(lambda: person.pose("tool")["z"] > at["z"] + 20)
    page.mouse.up()
    wait(lambda: page.locator("#teleop-handle").bounding_box()["y"] < box["y"] - 10)
    page.keyboard.press("Backspace")
    wait(lambda: "episode 0: discarded" in person.read("last"))
    person.pick_and_place()
    run.join()
    assert run.result == 0
    found = read_collection(run.log.parent, failures=True)
    assert [episode.failure for episode in found] == [DISCARDED, None]
