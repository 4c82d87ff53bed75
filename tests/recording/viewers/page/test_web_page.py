"""The page of `viewer=web`, without a browser: access, controls, and that the run never waits."""

import dataclasses
import http.client
import socket
import subprocess
import sys
import threading
import time

import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from embodichain.recording.viewers.page.web_page import Controls, Facts, PageOptions, WebPage
from embodichain.utils.errors import ConfigError
from tests.helpers import doors
from tests.recording.scene import MODEL, SmallEnv

OTHERS = "pages of other sites"
ROW = SmallEnv(num_envs=1).sim.engine.rows[0]


@pytest.fixture(scope="module")
def served():
    made = WebPage(MODEL, num_envs=3)
    yield made
    made.close()


@pytest.fixture
def page(served):
    """The page, without a browser, with its initial controls."""
    # The server takes a second to start, so one page serves all tests, each with new controls.
    served._controls, served._taken_steps, served._taken_resets = Controls(), 0, 0
    return served


def port_of(page):
    return doors.port_of(page.url)


def ask(page, path="/", **headers):
    """A plain request with the token; returns status and text."""
    connection = http.client.HTTPConnection("127.0.0.1", port_of(page), timeout=10)
    connection.request("GET", path, headers=doors.bearer(page.url) | headers)
    answer = connection.getresponse()
    return answer.status, answer.read().decode(errors="replace")


def visit(page, path="/state?sid=me", **options):
    """A WebSocket with the token."""
    headers = doors.bearer(page.url)
    options = {"close_timeout": 0.1, "additional_headers": headers, **options}
    return connect(f"ws://127.0.0.1:{port_of(page)}{path}", **options)


def until(condition, seconds=10.0):
    """Wait for something; returns whether it came."""
    end = time.monotonic() + seconds
    while not (found := condition()) and time.monotonic() < end:
        time.sleep(0.01)
    return found


def own_addresses():
    """Addresses of this machine on which a server on every interface would answer."""
    found = {"127.0.0.2", "::1"}
    found |= {info[4][0] for info in socket.getaddrinfo(socket.gethostname(), None)}
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.connect(("192.0.2.1", 9))  # sends nothing: asks which address would be used
        found.add(probe.getsockname()[0])
    return sorted(found - {"127.0.0.1"})


def test_only_loopback_answers(page):
    assert ask(page)[0] == 200
    for address in own_addresses():
        family = socket.AF_INET6 if ":" in address else socket.AF_INET
        with socket.socket(family) as other, pytest.raises(OSError):
            other.settimeout(2)
            other.connect((address, port_of(page)))


def test_an_upload_is_refused_to_the_controller_too(page):
    with visit(page, "/ui?sid=me"), visit(page) as state:
        assert until(lambda: "role=controller" in str(state.recv(timeout=5)))
        for path in ("/drop?sid=me", "//drop?sid=me", "/drop"):
            with pytest.raises(InvalidStatus) as refused, visit(page, path):
                pass
            assert refused.value.response.status_code == 403
            assert b"takes no files" in refused.value.response.body
        assert until(lambda: page.watched)
    assert until(lambda: not page.watched)
    assert ask(page, "/drop") == (403, "this viewer takes no files\n")


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://127.0.0.1:1"])
def test_pages_of_other_sites_are_refused(page, origin):
    with pytest.raises(InvalidStatus) as refused, visit(page, origin=origin):
        pass
    assert refused.value.response.status_code == 403
    assert OTHERS in ask(page, "/model", Origin=origin)[1]
    assert not page.watched


def test_a_name_that_points_here_is_refused(page):
    assert ask(page, Host="evil.example") == (403, "this viewer is not known by that name\n")
    own = f"localhost:{port_of(page)}"
    assert ask(page, Host=own)[0] == 200
    assert ask(page, Host="localhost:9000", Origin="http://localhost:9000")[0] == 200  # a tunnel


def test_a_new_connection_receives_the_state_at_once(page):
    page.show(ROW, Facts(step=1, seconds=0.0))
    with visit(page, "/ui?sid=me") as ui:
        ui.send(bytes(120))
        with visit(page) as state:
            assert until(lambda: page.watched)
            assert until(lambda: isinstance(state.recv(timeout=10), bytes))
    assert until(lambda: not page.watched)


def control(page, **controls):
    """Set controls as a browser would (`test_web_browser.py` uses one)."""
    # Controls arrive from a browser alone.
    page._controls = dataclasses.replace(page._controls, watched=True, **controls)


def seconds_of(call):
    began = time.monotonic()
    call()
    return time.monotonic() - began


def test_the_run_does_not_wait_without_a_browser(page):
    # As if a browser had set them before it went.
    page._controls = dataclasses.replace(page._controls, paused=True, speed=0.1)
    began = time.monotonic()
    for _ in range(1000):
        page.pace(1.0, lambda: None)
    assert time.monotonic() - began < 60  # of 10,000


def test_a_pause_takes_single_steps_and_ends(page):
    control(page, paused=True, speed=None, steps=2)
    page.pace(1.0, lambda: None)
    page.pace(1.0, lambda: None)
    later = threading.Timer(0.1, control, (page,), {"paused": False})
    later.start()
    assert seconds_of(lambda: page.pace(1.0, lambda: None)) > 0.05
    later.join()


def test_a_pause_ends_when_the_run_is_told_to_stop():
    page = WebPage(MODEL, stopped=lambda: True)
    control(page, paused=True)
    page.pace(1.0, lambda: None)
    page.close()


def test_another_environment_is_shown_during_a_pause(page):
    shown = []

    def changed():
        shown.append(page.env_id)
        control(page, paused=page.env_id == 0)

    control(page, paused=True, speed=None)
    later = threading.Timer(0.1, control, (page,), {"env_id": 1})
    later.start()
    page.pace(1.0, changed)
    later.join()
    assert shown == [0, 1]


def test_real_time_is_kept_while_the_page_is_open(page):
    control(page, speed=2.0)
    assert seconds_of(lambda: [page.pace(0.2, lambda: None) for _ in range(4)]) > 0.29


def test_a_reset_is_taken_once(page):
    assert page.take_reset() is None
    control(page, resets=1, reset_env=2)
    assert page.take_reset() == 2
    assert page.take_reset() is None


def test_the_run_goes_on_when_the_viewer_dies(caplog):
    page = WebPage(MODEL)
    # A server that dies: nothing public ends it without an orderly `close`.
    page._process.kill()
    page._listener.join()
    for _ in range(3):
        page.show(ROW)
    page.show_model(painted())
    assert not page.watched
    assert "the web viewer has ended; the run continues" in caplog.text
    page.close()


def test_an_address_that_cannot_be_listened_on():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(ConfigError, match=f"Port {port} is already in use"):
            WebPage(MODEL, PageOptions(port=port))
    with pytest.raises(ConfigError, match=r"viewer\.port: cannot listen on 192\.0\.2\.77"):
        WebPage(MODEL, PageOptions("192.0.2.77"))


def test_two_pages_have_a_port_each(page):
    other = WebPage(MODEL, PageOptions("localhost"))
    assert port_of(other) != port_of(page)
    assert ask(other)[0] == ask(page)[0] == 200
    other.close()
    other.close()
    with pytest.raises(ConnectionRefusedError):
        ask(other)


def painted():
    model = SmallEnv(num_envs=1).sim.engine.model_of(0)
    model.geom_rgba[:] = (1, 0, 1, 1)
    return model


def test_a_model_is_sent_again_only_if_it_looks_different(page):
    heavier = SmallEnv(num_envs=1).sim.engine.model_of(0)
    heavier.body_mass[:] *= 2
    with visit(page) as state:
        before = crc_of(state)
        page.show_model(MODEL)
        page.show_model(heavier)
        page.show(ROW)
        time.sleep(0.3)
        assert crc_of(state) == before
        page.show_model(painted())
        assert until(lambda: crc_of(state) != before)
    assert until(lambda: not page.watched)


def crc_of(state):
    """Which model the page is told to have, in the newest message of state."""
    while not isinstance(message := state.recv(timeout=10), bytes):
        pass
    return message[8:12]


ANOTHER_SOCKET = """
class Other(web_server.WebServer):
    def start(self):
        self.tcp_sock = web_server.bind_loopback_socket()
        super().start()
web_server.WebServer = Other
"""


@pytest.mark.parametrize(
    ("break_it", "why"),
    [
        ("s.guard_serving = lambda: None", "are not checked"),
        ("s._Viewer._host = '::'", "listens on ::"),
        (f"from mujoco.studio.web import web_server\n{ANOTHER_SOCKET}", "in another way"),
    ],
)
def test_a_studio_that_cannot_be_confined_serves_nothing(break_it, why):
    """A later MuJoCo may go another way: then there is an error, and no open port."""
    code = (
        "import mujoco, embodichain.recording.viewers.page.web_process as s\n"
        f"s._START_SECONDS = 2.0\n{break_it}\n"
        "s.Studio(mujoco.MjSpec().compile(), s.PageOptions())\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], check=False, timeout=60, capture_output=True, text=True
    )
    assert done.returncode == 1
    assert why in done.stderr
