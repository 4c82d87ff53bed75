"""People move the robot on the page of `viewer=web`: Chromium reads the page and presses keys.

The run waits after each step until the test lets it go on, so nothing depends on how fast it is.
"""

import re
import threading
import time

import pytest

import embodichain.recording as recording
from embodichain.cli import main
from embodichain.lab.gym.teleop import DISCARDED
from embodichain.recording.check.verification import verify
from embodichain.recording.demos.collection import read_collection
from embodichain.recording.read.chunks import LogReader
from embodichain.recording.viewers.operators.teleop_input import OperatorInput
from embodichain.recording.viewers.page.web_page import WebPage
from tests.helpers.browser import chromium, needs_chromium

pytestmark = [needs_chromium, pytest.mark.unmeasured, pytest.mark.slow]

SECONDS = 60.0
TOKEN = "of-these-tests"
KEYS = {
    "x": ("KeyW", "KeyS"),
    "y": ("KeyA", "KeyD"),
    "z": ("KeyE", "KeyQ"),
    "yaw": ("KeyJ", "KeyL"),
}
STEP = {"x": 10.0, "y": 10.0, "z": 10.0, "yaw": 2.29}
"""Mm or degrees that the tool moves in a control step of 40 ms."""
SLOW = 5.0


def wait(condition):
    end = time.monotonic() + SECONDS
    while not (found := condition()):
        assert time.monotonic() < end
        time.sleep(0.005)
    return found


class Pace:
    """In place of real time: after each step the run waits until it may take another one."""

    def __init__(self):
        self.credit, self.page = threading.Semaphore(0), None

    def __call__(self, page, seconds, changed):
        self.page = page
        while not self.credit.acquire(timeout=0.1) and page.watched:
            changed()  # a state is skipped where the page's process is behind


@pytest.fixture
def pace(monkeypatch):
    made = Pace()
    # Steps are made when the test says so, not in real time.
    monkeypatch.setattr(WebPage, "pace", lambda *args: made(*args))
    return made


class Run(threading.Thread):
    """A verb with `policy=teleop`, in a thread of its own."""

    def __init__(self, folder, *words):
        super().__init__(daemon=True)
        self.folder, self.result = folder, None
        self.line = [*words, "task=pick_place", "policy=teleop", "viewer=web", "seed=4"]
        self.line += [f"output_dir={folder}", "task.max_episode_steps=600"]
        self.line += [f"viewer.token={TOKEN}"]  # a drawn one is in no file of the run
        self.line += ["scene_png=false"] if words[0] == "run" else []
        self.start()

    def run(self):
        self.result = main(self.line)

    def url(self):
        logs = wait(lambda: list(self.folder.rglob("run.log")))
        address = wait(lambda: re.search(r"viewer: (http\S+)", logs[0].read_text()))[1]
        return f"{address}?token={TOKEN}"

    @property
    def log(self):
        return next(self.folder.rglob("rollout.mcap"))


class Person:
    """Reads the panel of the page, and presses keys."""

    def __init__(self, page, pace):
        self.page, self.pace, self.down, self.shown = page, pace, set(), 0
        wait(lambda: "you move the robot" in self.read("role"))

    def read(self, name):
        return self.page.inner_text(f"#teleop-{name}")

    def pose(self, name):
        """mm and degrees."""
        row = self.page.inner_text(f"#teleop-poses [data-name={name}]")
        numbers = [float(text.strip("\u00b0")) for text in row.split()[1:]]
        return dict(zip(("x", "y", "z", "roll", "pitch", "yaw"), numbers, strict=True))

    def hold(self, keys):
        """Presses and releases keys until just these are held."""
        for key in self.down - keys:
            self.page.keyboard.up(key)
        for key in keys - self.down:
            self.page.keyboard.down(key)
        begins, self.down = not self.shown and bool(keys), set(keys)
        while begins and not self.begun():  # it was pressed before the run waited for it
            for key in keys:
                self.page.keyboard.up(key)
                self.page.keyboard.down(key)
        if self.pace.page is not None:
            wanted = OperatorInput()
            wanted.hold(keys)
            wait(lambda: self.pace.page.command.linear == wanted.command().linear)
            wait(lambda: self.pace.page.command.angular == wanted.command().angular)
            wait(lambda: self.pace.page.command.speed == wanted.command().speed)

    def begun(self):
        """Whether the episode began, with the first key, and took its first step."""
        end = time.monotonic() + 2.0
        while time.monotonic() < end:
            if ", step 1 of " in self.read("progress"):
                self.shown = 1
                return True
        return False

    def until(self, step):
        """Waits until the page shows a control step."""
        wait(lambda: f", step {step} of " in self.read("progress"))
        self.shown = step

    def watch(self, steps):
        """Lets the run go on, and waits until the page shows it."""
        for _ in range(steps):
            self.pace.credit.release()
        self.until(self.shown + steps)

    def go(self, near=4.0, **goal):
        """Brings the tool to coordinates, mm and degrees."""
        for _ in range(30):
            at = self.pose("tool")
            way = {name: value - at[name] for name, value in goal.items()}
            if "yaw" in way:  # a gripper is the same after half a turn
                way["yaw"] = (way["yaw"] + 90) % 180 - 90
            way = {name: distance for name, distance in way.items() if abs(distance) > near}
            if not way:
                return
            slow = max(map(abs, way.values())) < 30
            steps = min(abs(d) / STEP[name] * (SLOW if slow else 1) for name, d in way.items())
            keys = {KEYS[name][distance < 0] for name, distance in way.items()}
            self.hold(keys | ({"ShiftLeft"} if slow else set()))
            self.watch(max(1, round(steps)))
            self.hold(set())
            self.watch(8)  # the arm is behind its targets
        pytest.fail(f"did not get to {goal}")

    def grip(self, closed):
        grips = self.pace.page.command.grips
        self.page.keyboard.press("Space")
        wait(lambda: self.pace.page.command.grips > grips)
        self.watch(15)
        assert ("gripper closed" in self.page.inner_text("#teleop h1")) == closed

    def end(self, key, says):
        """Ends the episode with a key."""
        ends = self.pace.page.command
        self.page.keyboard.press(key)
        wait(lambda: self.pace.page.command != ends)
        self.pace.credit.release()
        wait(lambda: says in self.read("last"))
        self.pace.credit.release()  # the run waits for the first key now
        wait(lambda: ", step 0 of " in self.read("progress"))
        self.shown = 0

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


@pytest.fixture
def visit():
    """Opens a page of the operator's panel only: the scene costs time, and is tested elsewhere."""
    with chromium() as open_page:

        def visit(url, script=""):
            page = open_page("about:blank", 700, 500)
            page.add_init_script(script)
            page.route("**/web_client.js", lambda route: route.abort())
            page.goto(url)
            return page

        yield visit


def test_ten_demonstrations_with_the_keyboard(tmp_path, pace, visit):
    run = Run(tmp_path, "run", "episodes=10")
    person = Person(visit(run.url()), pace)
    for episode in range(9):
        person.pick_and_place()
        assert "success" in person.read("progress")
        person.end("Enter", f"episode {episode}: success")
    person.pick_and_place()
    person.page.keyboard.press("Enter")
    wait(lambda: pace.credit.release() or not run.is_alive())
    assert run.result == 0
    with LogReader(run.log) as reader:
        assert reader.header.policy == "teleop"
    with recording.open(run.log) as log:
        assert [episode.success for episode in log.episodes] == [True] * 10
    assert verify(run.log).ok


PAD = """
window.pad = null;
navigator.getGamepads = () => [window.pad && {
  connected: true, axes: window.pad[0],
  buttons: [...Array(17).keys()].map((i) => ({pressed: window.pad[1].includes(i)}))}];
"""


def test_a_gamepad_and_the_mouse_and_what_is_discarded(tmp_path, pace, visit):
    run = Run(tmp_path, "collect", "episodes=1", "collect.success_steps=40")
    page = visit(run.url(), script=PAD)
    person = Person(page, pace)

    def pad(axes=(0, 0, 0, 0), buttons=()):
        page.evaluate("pad => { window.pad = pad; }", [list(axes), list(buttons)])

    yaw = person.pose("tool")["yaw"]
    pad(axes=(0, 0, -1, 0))  # the right stick to the left
    person.until(1)
    person.watch(10)
    assert person.pose("tool")["yaw"] > yaw + 10
    assert page.is_visible("text=left stick")
    pad(buttons=[0])
    wait(lambda: pace.page.command.grips == 1)
    person.watch(1)
    assert "gripper closed" in page.inner_text("#teleop h1")
    pad()
    wait(lambda: page.is_visible("#teleop-handle"))
    person.watch(10)
    at, box = person.pose("tool"), page.locator("#teleop-handle").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x, y - 40, steps=3)
    wait(lambda: pace.page.command.goal is not None and pace.page.command.goal[2] > 1.0)
    person.watch(40)
    ring = page.locator("#teleop-handle").bounding_box()
    assert (ring["x"], ring["y"]) == pytest.approx((box["x"], box["y"] - 40), abs=2)
    assert person.pose("tool")["z"] > at["z"] + 50  # the view looks down on it
    page.mouse.up()
    wait(lambda: pace.page.command.goal is None)
    person.end("Backspace", "episode 0: discarded")
    person.pick_and_place()
    wait(lambda: pace.credit.release() or not run.is_alive())
    assert run.result == 0
    found = read_collection(run.log.parent, failures=True)
    assert [episode.failure for episode in found] == [DISCARDED, None]
