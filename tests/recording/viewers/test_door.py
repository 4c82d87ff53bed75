"""Who gets in: servers are asked with and without token, under other names, by other sites."""

import contextlib
import http.client
import socket

import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from embodichain.recording.viewers.foxglove_server import FoxgloveServer
from embodichain.recording.viewers.page.web_page import PageOptions, WebPage
from embodichain.utils.errors import ConfigError
from embodichain.utils.system.access import Access
from tests.helpers import doors
from tests.recording.scene import MODEL

FOXGLOVE_APP = "https://app.foxglove.dev"
KINDS = ["web", "foxglove"]


@contextlib.contextmanager
def server(kind, host="127.0.0.1", **access):
    """A page or a server of Foxglove's protocol; its address."""
    chosen = Access(**access)
    if kind == "web":
        made = WebPage(MODEL, PageOptions(host, teleop=True, access=chosen))
    else:
        made = FoxgloveServer(host, 0, chosen)
    try:
        yield made.url
    finally:
        made.close()


@pytest.fixture(scope="module", params=KINDS)
def url(request):
    with server(request.param) as found:
        yield found


def ask(url, path="/", **headers):
    """A plain request without a token of its own: status, headers, text."""
    connection = http.client.HTTPConnection("127.0.0.1", doors.port_of(url), timeout=10)
    connection.request(
        "GET", path, headers={name.replace("_", "-"): v for name, v in headers.items()}
    )
    answer = connection.getresponse()
    return answer.status, answer.headers, answer.read().decode(errors="replace")


def shake(url, path="/state?sid=me", **options):
    """Status of a WebSocket's handshake; for a path as a browser or a viewer has it."""
    options = {"subprotocols": ["foxglove.websocket.v1"], "close_timeout": 0.1, **options}
    try:
        with connect(f"ws://127.0.0.1:{doors.port_of(url)}{path}", **options):
            return 101
    except InvalidStatus as error:
        return error.response.status_code


def let_in(status):
    """Whether a plain request passed the door; Foxglove's server has no pages (426)."""
    return status in (200, 426)


def test_a_drawn_token_is_long_and_another_each_time():
    found = set()
    for kind in KINDS:
        for _ in range(2):
            with server(kind) as url:
                found.add(doors.token_of(url))
    assert len(found) == 4
    assert all(len(token) == 43 for token in found)  # 32 random bytes in base64


@pytest.mark.parametrize(
    "path", ["/", "/index.html", "/model", "/web_client.js", "/teleop_page.js"]
)
def test_every_path_asks_for_the_token(url, path):
    status, headers, text = ask(url, path)
    assert status == 401
    assert headers["WWW-Authenticate"] == 'Bearer realm="embodichain"'
    assert "asks for its token" in text
    assert ask(url, f"{path}?token=wrong")[0] == ask(url, path, Authorization="Bearer x")[0] == 401


@pytest.mark.parametrize("path", ["/state?sid=me", "/ui?sid=me", "/teleop", "/"])
def test_every_handshake_asks_for_the_token(url, path):
    token = doors.token_of(url)
    joined = "&" if "?" in path else "?"
    assert shake(url, path) == 401
    for wrong in ("", "x", token[:-1], f"{token}x", token.swapcase(), "%00", "%ff%fe"):
        assert shake(url, f"{path}{joined}token={wrong}") == 401
        if wrong.isascii() and "%" not in wrong:
            header = {"Authorization": f"Bearer {wrong}"}
            assert shake(url, path, additional_headers=header) == 401
    assert shake(url, path, additional_headers={"Authorization": f"Basic {token}"}) == 401
    assert shake(url, path, additional_headers={"Cookie": f"token={token}"}) == 401


@pytest.mark.parametrize("path", ["/state?sid=me", "/ui?sid=me", "/teleop"])
def test_the_token_opens_as_bearer_and_in_the_address(path):
    with server("web") as url:
        token = doors.token_of(url)
        joined = "&" if "?" in path else "?"
        assert shake(url, f"{path}{joined}token={token}") == 101
        assert shake(url, path, additional_headers={"Authorization": f"bearer {token}"}) == 101


def test_a_browser_is_asked_with_a_field(url):
    status, headers, text = ask(url, Accept="text/html,application/xhtml+xml")
    assert status == 401 and headers["Content-Type"].startswith("text/html")
    assert '<input name="token" type="password"' in text


def test_the_first_page_sets_a_cookie_that_opens_the_rest():
    with server("web") as url, server("web") as other:
        port, token = doors.port_of(url), doors.token_of(url)
        _, headers, _ = ask(url, f"/?token={token}")
        cookie, *attributes = [part.strip() for part in headers["Set-Cookie"].split(";")]
        name, _, value = cookie.partition("=")
        assert name == f"embodichain-{port}"
        assert set(attributes) == {"Path=/", "HttpOnly", "SameSite=Strict"}
        assert token not in cookie  # a browser sends it to every port of this machine
        status, headers, _ = ask(url, Cookie=f"of=another; {cookie}")
        assert status == 200 and "Set-Cookie" not in headers
        assert shake(url, additional_headers={"Cookie": cookie}) == 101
        assert shake(url, "/teleop", additional_headers={"Cookie": cookie}) == 101
        for wrong in (f"{name}=x", f"{name}=", f"x{cookie}", f"embodichain-{port + 1}={value}"):
            assert ask(url, Cookie=wrong)[0] == 401
        theirs = f"embodichain-{doors.port_of(other)}={value}"
        assert ask(other, Cookie=theirs)[0] == 401  # another page's


def test_an_address_for_a_command_line_opens_one_page_once():
    page = WebPage(MODEL)
    try:
        ticket = doors.token_of(page.url_once)
        assert ticket != doors.token_of(page.url)
        path = f"/?token={ticket}"
        assert shake(page.url, f"/state?token={ticket}") == 401  # it is for a page alone
        assert ask(page.url, "/", Authorization=f"Bearer {ticket}")[0] == 401
        status, headers, _ = ask(page.url, path)
        cookie = headers["Set-Cookie"].partition(";")[0]
        assert status == ask(page.url, Cookie=cookie)[0] == 200
        assert ask(page.url, path)[0] == 401
    finally:
        page.close()


def test_behind_a_tunnel_the_cookie_has_the_port_that_the_browser_sees():
    with server("web") as url:
        path = f"/?token={doors.token_of(url)}"
        _, headers, _ = ask(url, path, Host="localhost:9000")
        assert headers["Set-Cookie"].startswith("embodichain-9000=")


def test_answers_are_not_for_other_pages(url):
    for _, headers, _ in (ask(url), ask(url, f"/?token={doors.token_of(url)}")):
        if headers["Upgrade"]:
            continue  # Foxglove's server has no pages
        assert headers.get_all("X-Frame-Options") == ["DENY"]
        assert headers.get_all("Cross-Origin-Resource-Policy") == ["same-origin"]
        assert headers.get_all("Referrer-Policy") == ["no-referrer"]
        assert "Access-Control-Allow-Origin" not in headers


SITES = [
    "http://evil.example",
    "null",
    "http://127.0.0.1:1",
    "http://[",
    "https://app.foxglove.dev.evil.example",
]


@pytest.mark.parametrize("site", [*SITES, "https://evil.example/app.foxglove.dev", ""])
def test_other_sites_are_refused_with_the_token_too(url, site):
    token = doors.token_of(url)
    assert ask(url, f"/?token={token}", Origin=site)[0] == 403
    header = {"Authorization": f"Bearer {token}", "Origin": site}
    assert shake(url, additional_headers=header) == 403


NAMES = ["evil.example", "127.0.0.1.evil.example", "localhost.evil.example", "", "[", "1.2.3.4"]


@pytest.mark.parametrize("name", NAMES)
def test_other_names_are_refused_with_the_token_too(url, name):
    token = doors.token_of(url)
    assert ask(url, f"/?token={token}", Host=name)[0] == 403
    assert ask(url, f"/?token={token}", Host=f"{name}:{doors.port_of(url)}")[0] == 403
    for own in ("localhost", "127.0.0.1", "LOCALHOST:80", "[::1]:8080"):
        assert let_in(ask(url, f"/?token={token}", Host=own)[0])


@pytest.mark.parametrize("kind", KINDS)
def test_a_server_for_other_machines_checks_the_same(kind):
    with server(kind, "0.0.0.0", allow_hosts=["lab.example.org"]) as url:
        path = f"/?token={doors.token_of(url)}"
        assert ask(url)[0] == 401
        for foreign in ("evil.example", "evil.lab.example.org", "lab.example.org.evil.example"):
            assert ask(url, path, Host=foreign)[0] == 403
            assert ask(url, path, Host=foreign, Origin=f"http://{foreign}")[0] == 403
        own = (
            "lab.example.org:8443",
            "LAB.example.org.",
            "192.0.2.7:8080",
            "[2001:db8::1]",
            socket.gethostname(),
        )
        for name in own:
            assert let_in(ask(url, path, Host=name)[0])
            assert let_in(ask(url, path, Host=name, Origin=f"https://{name}")[0])
        assert ask(url, path, Origin="http://evil.example")[0] == 403


@pytest.mark.parametrize("kind", KINDS)
def test_without_a_token_names_and_sites_are_still_checked(kind):
    with server(kind, token="none") as url:
        assert "token" not in url
        assert let_in(ask(url)[0])
        assert ask(url, Host="evil.example")[0] == ask(url, Origin="http://evil.example")[0] == 403
        assert shake(url) == 101
        assert shake(url, origin="http://evil.example") == 403


@pytest.mark.parametrize("kind", KINDS)
def test_a_given_token_may_have_any_sign(kind):
    token = "a+b/c=d&e%20?#\"'"
    with server(kind, token=token) as url:
        assert doors.token_of(url) == token
        assert let_in(ask(url, url[url.index("/", 8) :])[0])
        assert let_in(ask(url, Authorization=f"Bearer {token}")[0])
        assert ask(url, Authorization="Bearer a")[0] == 401


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.0.2.7", "lab.example.org"])
@pytest.mark.parametrize("kind", KINDS)
def test_none_is_for_this_machine_alone(kind, host):
    why = rf"viewer\.token: none is for .* viewer\.host is {host}"
    with pytest.raises(ConfigError, match=why), server(kind, host, token="none"):
        pass


def test_the_apps_of_foxglove_are_let_in_by_default_and_others_by_name():
    with server("foxglove") as url:
        path = f"/?token={doors.token_of(url)}"
        for app in (FOXGLOVE_APP, "https://studio.foxglove.dev", "file://"):
            assert shake(url, path, origin=app) == 101
            assert shake(url, "/", origin=app) == 401  # the token is asked for all the same
    with server("foxglove", allow_origins=["http://lichtblick.example:8080/"]) as url:
        path = f"/?token={doors.token_of(url)}"
        assert shake(url, path, origin="http://lichtblick.example:8080") == 101
        assert shake(url, path, origin="http://lichtblick.example:8081") == 403
        assert shake(url, path, origin=FOXGLOVE_APP) == 403
    with server("web") as url:
        assert shake(url, f"/state?token={doors.token_of(url)}", origin=FOXGLOVE_APP) == 403
