"""The operator's place on the page of `viewer=web`, without a browser: who operates, and how."""

import http.client
import json
import threading
import time

import mujoco
import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from embodichain.lab.gym.teleop import ToolCommand
from embodichain.recording.viewers.operators.operator_pages import OperatorPages, look_like, view_of
from embodichain.recording.viewers.page.web_page import PageOptions, WebPage
from embodichain.utils.errors import EmbodichainError
from tests.helpers import doors
from tests.recording.scene import MODEL

STATUS = {"tool": [0.1, 0.2, 0.3, 1.0, 0.0, 0.0, 0.0], "step": 3}


@pytest.fixture(scope="module")
def served():
    made = WebPage(MODEL, PageOptions(teleop=True))
    yield made
    made.close()


def is_operated(page):
    """Whether a browser has the controls, as its message said that arrived last.

    A run only sees the commands, which are the same while nobody moves.
    """
    # Nothing public tells it, see above.
    return page._controls.operated


@pytest.fixture
def page(served):
    """The page, with nobody there."""
    assert until(lambda: not served.watched and not is_operated(served))
    return served


def until(condition, seconds=20.0):
    end = time.monotonic() + seconds
    while not (found := condition()) and time.monotonic() < end:
        time.sleep(0.01)
    return found


def port_of(page):
    return doors.port_of(page.url)


def get(page, path):
    connection = http.client.HTTPConnection("127.0.0.1", port_of(page), timeout=10)
    connection.request("GET", path, headers=doors.bearer(page.url))
    answer = connection.getresponse()
    return answer.status, answer.read().decode(errors="replace"), answer


class Browser:
    """A page's WebSocket."""

    def __init__(self, page, **options):
        address = f"ws://127.0.0.1:{port_of(page)}/teleop"
        headers = doors.bearer(page.url)
        self.connecting = connect(address, close_timeout=0.1, additional_headers=headers, **options)

    def __enter__(self):
        self.socket = self.connecting.__enter__()
        return self

    def __exit__(self, *error):
        self.connecting.__exit__(*error)

    def send(self, **message):
        self.socket.send(json.dumps(message))

    def hold(self, *keys, axes=(), buttons=(), speed=1.0, drag=None, away=False):
        held, axes, buttons = list(keys), list(axes), list(buttons)
        self.send(held=held, axes=axes, buttons=buttons, speed=speed, drag=drag, away=away)

    def receive(self, found):
        """The next message for which something holds."""
        while not found(message := json.loads(self.socket.recv(timeout=20))):
            pass
        return message


def test_the_page_gets_the_panel_and_needs_nothing_else(page):
    status, text, answer = get(page, "/")
    assert status == 200 and '<script src="teleop_page.js"></script></head>' in text
    assert answer.headers["Cross-Origin-Opener-Policy"] == "same-origin"
    assert int(answer.headers["Content-Length"]) == len(text.encode())
    status, text, _ = get(page, "/teleop_page.js")
    assert status == 200 and "new WebSocket" in text
    assert "http:" not in text and "https://" not in text and "import(" not in text


def test_a_page_without_teleoperation_is_as_it_was():
    plain = WebPage(MODEL)
    try:
        assert "teleop" not in get(plain, "/")[1]
        assert get(plain, "/teleop_page.js")[0] == 404
    finally:
        plain.close()


def test_pages_of_other_sites_do_not_operate(page):
    with pytest.raises(InvalidStatus) as refused, Browser(page, origin="http://evil.example"):
        pass
    assert refused.value.response.status_code == 403
    assert not is_operated(page)


def test_keys_become_a_command_while_they_are_held(page):
    with Browser(page) as operator:
        hello = operator.receive(lambda m: "hello" in m)["hello"]
        assert ["Space", "open or close the gripper"] in hello["keys"]
        assert {"KeyW", "Space", "ShiftLeft"} <= set(hello["codes"])
        operator.hold("KeyW", "KeyQ", "ShiftLeft", "KeyZ", speed=2.0)
        assert until(lambda: page.command.linear == (1.0, 0.0, -1.0))
        assert page.command.speed == pytest.approx(0.4) and page.command.angular == (0, 0, 0)
        operator.hold("KeyW", "KeyS", "KeyJ", speed=1000.0)  # opposite keys; the fastest there is
        assert until(lambda: page.command.angular == (0.0, 0.0, 1.0))
        assert page.command.linear == (0.0, 0.0, 0.0) and page.command.speed == 4.0
        operator.hold()
        assert until(lambda: page.command.angular == (0.0, 0.0, 0.0))


def test_presses_are_counted_once(page):
    before = page.command
    with Browser(page) as operator:
        for key in ("Space", "Space", "Enter", "Backspace", "Tab", "KeyT", "KeyZ"):
            operator.send(press=key)
        assert until(lambda: page.command.axes != before.axes)
        now = page.command
        assert (now.grips, now.ends) == (before.grips + 2, before.ends + 1)
        assert (now.discards, now.switches) == (before.discards + 1, before.switches + 1)
        operator.hold(buttons=[0, 9])  # the gripper, and the end of the episode
        assert until(lambda: page.command.ends == before.ends + 2)
        operator.hold(buttons=[0])
        operator.hold(buttons=[0, 12], axes=[0.0, -1.0, 0.5, 0.1])
        assert until(lambda: page.command.linear[0] == 1.0)
        now = page.command
        assert now.grips == before.grips + 3  # it was held all the time
        assert now.linear == (1.0, 0.0, 0.0)  # 0.1 is in the dead zone
        assert now.angular[1] == 1.0 and now.angular[2] == pytest.approx(-0.35 / 0.85)
        operator.send(press="KeyT")
        assert until(lambda: page.command.axes == before.axes)


def test_the_tool_stays_when_the_page_is_silent_and_the_run_waits(page):
    with Browser(page) as operator:
        operator.hold("KeyW")
        assert until(lambda: page.command.linear == (1.0, 0.0, 0.0))
        began = time.monotonic()
        assert until(lambda: page.command.linear == (0.0, 0.0, 0.0))  # half a second later
        assert is_operated(page)
        assert until(lambda: not is_operated(page))  # two seconds later
        assert time.monotonic() - began > 1.0
        operator.hold(away=True)
        time.sleep(0.1)
        assert not is_operated(page)  # a hidden page does not operate
        operator.hold()
        assert until(lambda: is_operated(page))


def test_the_first_page_operates_and_the_next_one_takes_its_place(page):
    page.tell(STATUS)
    with Browser(page) as first, Browser(page) as second:
        first.hold("KeyA")
        assert first.receive(lambda m: "step" in m)["operator"]
        assert not second.receive(lambda m: "step" in m)["operator"]
        assert until(lambda: page.command.linear == (0.0, 1.0, 0.0))
        second.hold("KeyD")
        second.send(press="Enter")
        time.sleep(0.2)
        assert page.command.linear[1] >= 0.0  # it only watches
        ends = page.command.ends
        first.socket.close()
        assert second.receive(lambda m: m.get("operator"))["step"] == 3
        assert until(lambda: page.command.linear == (0.0, 0.0, 0.0))  # nothing is held any more
        second.hold("KeyD")
        assert until(lambda: page.command.linear == (0.0, -1.0, 0.0))
        assert page.command.ends == ends
    assert until(lambda: not is_operated(page))


def test_a_hidden_page_gives_its_place_away(page):
    with Browser(page) as first:
        first.hold(away=True)  # alone: the run waits for it
        time.sleep(0.1)
        assert not is_operated(page)
        first.hold()
        assert until(lambda: is_operated(page))
        with Browser(page) as second:
            first.hold("KeyW", away=True)
            second.receive(lambda m: m.get("operator"))
            time.sleep(0.1)
            assert not is_operated(page)  # it has not been heard yet
            second.hold("KeyA")
            assert until(lambda: page.command.linear == (0.0, 1.0, 0.0))
            first.hold("KeyW")  # back again: it watches
            time.sleep(0.1)
            assert page.command.linear == (0.0, 1.0, 0.0)


@pytest.mark.parametrize(
    "message",
    [
        *("nonsense", "[]", "{}", b"bytes", '{"held": 3}', "[" * 4000, '{"press": 1' + " " * 5000),
        '{"held": [], "axes": [NaN], "buttons": [], "speed": 1, "drag": null, "away": false}',
        '{"held": [], "axes": [], "buttons": [], "speed": 1, "drag": {"at": [1]}, "away": 0}',
    ],
)
def test_what_no_page_sends_ends_its_connection(page, message):
    with Browser(page) as stranger:
        stranger.socket.send(message)
        with pytest.raises(ConnectionClosed) as closed:
            while True:
                stranger.socket.recv(timeout=20)
        assert closed.value.rcvd.code == 1008
    with Browser(page) as operator:  # the next one is served
        operator.hold("KeyW")
        assert until(lambda: page.command.linear == (1.0, 0.0, 0.0))


def test_the_run_waits_for_an_operator_and_shows_the_scene_meanwhile(page):
    shown = []
    waiting = threading.Thread(target=page.wait_for_operator, args=(lambda: shown.append(1),))
    waiting.start()
    time.sleep(0.1)
    assert waiting.is_alive()
    with Browser(page) as operator:
        operator.hold()
        waiting.join(20)
        assert not waiting.is_alive()
        began = page.command
        page.wait_for_operator(lambda: None)  # at once
        done = []
        waiting = threading.Thread(
            target=page.wait_for_operator,
            args=(lambda: shown.append(2), lambda: page.command != began),
        )
        waiting.start()
        assert until(lambda: 2 in shown)
        assert waiting.is_alive() and not done
        operator.hold("KeyE")
        waiting.join(20)
        assert not waiting.is_alive()


def test_a_run_that_is_stopped_or_lost_its_page_does_not_wait():
    stopped = WebPage(MODEL, PageOptions(teleop=True), stopped=lambda: True)
    stopped.wait_for_operator(lambda: None)
    stopped.close()
    lost = WebPage(MODEL, PageOptions(teleop=True))
    # A server that dies: nothing public ends it without an orderly `close`.
    lost._process.kill()
    with pytest.raises(EmbodichainError, match="can no longer be operated"):
        lost.wait_for_operator(lambda: None)
    lost.close()


# -- dragging in the view ------------------------------------------------------------------------

XML = """<mujoco><worldbody>
<camera name="front" pos="1 -2 1.5" xyaxes="1 0 0 0 0.6 0.8" fovy="30"/>
<geom type="box" size="0.2 0.2 0.2"/></worldbody></mujoco>"""


def view_at(azimuth, elevation, model=None):
    model = model or mujoco.MjModel.from_xml_string(XML)
    data, camera = mujoco.MjData(model), mujoco.MjvCamera()
    mujoco.mj_forward(model, data)
    camera.lookat[:], camera.distance = (0.1, 0.0, 0.2), 2.0
    camera.azimuth, camera.elevation = azimuth, elevation
    return view_of(model, data, camera, mujoco.MjvScene(model, 1))


def test_points_of_the_picture_are_those_of_the_camera():
    view = view_at(90.0, 0.0)  # looks along y
    assert view.eye == pytest.approx([0.1, -2.0, 0.2], abs=1e-6)
    u, v, depth = view.point(np.array([0.6, 0.0, 0.2]))
    slope = np.tan(np.deg2rad(45.0) / 2)  # MuJoCo's free camera has a field of view of 45 degrees
    assert (u, v, depth) == pytest.approx((0.25 / slope, 0.0, 2.0), abs=1e-5)
    assert view.point(np.array([0.1, 0.0, 0.7]))[1] == pytest.approx(0.25 / slope, abs=1e-5)
    assert view.point(np.array([0.1, -3.0, 0.2]))[2] < 0  # behind
    tilted = view_at(37.0, -25.0)
    place = np.array([0.3, -0.2, 0.1])
    assert tilted.position(*tilted.point(place)) == pytest.approx(place, abs=1e-6)


def test_a_camera_of_the_model_gives_the_first_view():
    model = mujoco.MjModel.from_xml_string(XML)
    model.vis.global_.fovy = 30.0
    camera = mujoco.MjvCamera()
    look_like(model, camera, "front")
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    view = view_of(model, data, camera, mujoco.MjvScene(model, 1))
    assert view.eye == pytest.approx([1.0, -2.0, 1.5], abs=1e-5)
    assert view.forward == pytest.approx([0.0, 0.8, -0.6], abs=1e-5)
    look_like(model, camera, "nowhere")  # stays as it is
    assert camera.distance > 0.5


def test_a_drag_moves_the_goal_in_the_plane_of_the_view():
    operators = OperatorPages(threading.Event())
    operators.tell(STATUS)
    drag = {"held": [], "axes": [], "buttons": [], "speed": 1, "away": False}

    def take(drag_at):
        # What the listener calls for each message, without a browser between.
        assert operators._handle_message(json.dumps({**drag, "drag": drag_at}))
        return operators.command.goal

    assert take({"at": [0, 0], "depth": 0}) is None  # no view yet
    operators.view = view = view_at(90.0, 0.0)
    u, v, depth = view.point(np.array(STATUS["tool"][:3]))
    start = take({"at": [u + 0.01, v], "depth": 0})  # not in the middle of the ring
    assert start == pytest.approx(STATUS["tool"][:3], abs=1e-6)
    moved = take({"at": [u + 0.11, v + 0.2], "depth": 0})
    way = np.array([0.1, 0.0, 0.2]) * view.slope * depth
    assert np.subtract(moved, start) == pytest.approx(way, abs=1e-6)
    nearer = take({"at": [u + 0.01, v], "depth": -0.05})
    assert nearer[1] == pytest.approx(start[1] - 0.05, abs=1e-6)
    assert take(None) is None
    assert operators.command == ToolCommand()
