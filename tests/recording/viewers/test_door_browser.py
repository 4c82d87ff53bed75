"""The door in Chromium: the token is asked for once, and pages of other sites get nothing."""

import contextlib
import http.server
import threading

import pytest

from embodichain.recording.viewers.foxglove_server import FoxgloveServer
from embodichain.recording.viewers.page.web_page import WebPage
from embodichain.utils.system.access import Access
from tests.helpers import doors
from tests.helpers.browser import CHROMIUM, needs_chromium
from tests.recording.scene import MODEL

pytestmark = [needs_chromium, pytest.mark.unmeasured, pytest.mark.slow]

SOCKET = """([url, protocols]) => new Promise((done) => {
  const socket = new WebSocket(url, protocols);
  socket.onmessage = (event) => done(String(event.data).slice(0, 40));
  socket.onerror = () => done("refused");
})"""
FETCH = """(url) => fetch(url, { credentials: "include" })
  .then((answer) => String(answer.status), () => "refused")"""
SCRIPT = """(url) => new Promise((done) => {
  const script = document.createElement("script");
  script.onload = () => done("loaded");
  script.onerror = () => done("refused");
  script.src = url;
  document.head.append(script);
})"""
FRAME = """(url) => new Promise((done) => {
  const frame = document.createElement("iframe");
  frame.onload = () => done();
  frame.src = url;
  document.body.append(frame);
})"""


class Site(http.server.BaseHTTPRequestHandler):
    """A page of somebody else."""

    def do_GET(self):
        body = b"<!doctype html><title>theirs</title><body></body>"
        self.send_response(200)
        self.send_header("Content-Type", "text/html")
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *words):
        pass


@contextlib.contextmanager
def site():
    """Another site on this machine; its origin."""
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Site)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


@pytest.fixture(scope="module")
def browser():
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        found = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield found
        found.close()


@pytest.fixture(scope="module")
def viewer():
    made = WebPage(MODEL)
    yield made
    made.close()


@pytest.fixture
def context(browser):
    """A person's browser, without cookies."""
    made = browser.new_context()
    yield made
    made.close()


def sockets_of(page):
    """A page's WebSockets that got an answer."""
    found = []
    page.on("websocket", lambda made: made.on("framereceived", lambda _: found.append(made.url)))
    return found


def until(page, condition):
    for _ in range(600):
        if condition():
            return
        page.wait_for_timeout(50)
    pytest.fail("it never came")


def test_the_printed_address_opens_the_page_and_a_cookie_keeps_it(context, viewer):
    page = context.new_page()
    answered = sockets_of(page)
    assert page.goto(viewer.url).status == 200
    assert page.url == viewer.address  # the token is in no bookmark, and on no projector
    until(page, lambda: any("/state" in url for url in answered))
    assert not any(doors.token_of(viewer.url) in url for url in answered)
    (cookie,) = context.cookies()
    assert cookie["name"] == f"embodichain-{doors.port_of(viewer.url)}"
    assert (cookie["httpOnly"], cookie["sameSite"], cookie["expires"]) == (True, "Strict", -1)
    assert page.evaluate("document.cookie") == ""
    second = context.new_page()
    assert second.goto(viewer.address).status == 200
    assert second.reload().status == 200


def test_without_the_token_there_is_a_field_for_it(context, viewer):
    page = context.new_page()
    assert page.goto(viewer.address).status == 401
    assert "asks for its token" in page.inner_text("body")
    page.fill("input[name=token]", "wrong")
    page.press("input[name=token]", "Enter")
    page.wait_for_url("**token=wrong")
    assert "asks for its token" in page.inner_text("body")
    page.fill("input[name=token]", doors.token_of(viewer.url))
    page.press("input[name=token]", "Enter")
    page.wait_for_url(viewer.address)
    assert "asks for its token" not in page.content()


def test_pages_of_other_sites_get_nothing_though_the_browser_has_the_cookie(context, viewer):
    first = context.new_page()
    first.goto(viewer.url)
    port, token = doors.port_of(viewer.url), doors.token_of(viewer.url)
    with site() as origin:
        page = context.new_page()
        page.goto(origin)  # the same machine: a cookie is sent to it, and from it
        for path in ("/state?sid=me", "/ui?sid=me", f"/state?sid=me&token={token}"):
            url = f"ws://127.0.0.1:{port}{path}"
            assert page.evaluate(SOCKET, [url, []]) == "refused"
        for path in ("", "model", f"?token={token}"):
            assert page.evaluate(FETCH, f"{viewer.address}{path}") == "refused"
        assert page.evaluate(SCRIPT, f"{viewer.address}web_client.js") == "refused"
        page.evaluate(FRAME, viewer.url)
        assert page.frames[1].url.startswith("chrome-error://")  # nothing to click on
        page.close()


def test_foxgloves_server_answers_the_sites_that_are_named(context):
    with site() as origin, site() as other:
        server = FoxgloveServer("127.0.0.1", 0, Access(allow_origins=(origin,)))
        protocols = ["foxglove.websocket.v1"]
        try:
            page = context.new_page()
            page.goto(origin)
            found = page.evaluate(SOCKET, [server.url, protocols])
            assert found.startswith('{"op": "serverInfo"')
            assert page.evaluate(SOCKET, [server.address, protocols]) == "refused"
            page.goto(other)
            assert page.evaluate(SOCKET, [server.url, protocols]) == "refused"
        finally:
            server.close()
