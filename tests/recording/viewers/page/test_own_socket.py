"""The second port of MuJoCo's web viewer, through which it draws its panel: its process's alone."""

import contextlib
import os
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from websockets.sync.client import connect

from embodichain.recording.viewers.page.own_socket import OwnSocket, is_own
from embodichain.recording.viewers.page.web_page import WebPage
from tests.helpers import doors
from tests.recording.scene import MODEL

LISTENS = "0A"
"""The state of a listening socket in /proc/net/tcp."""
needs_proc = pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="it reads /proc")


def listening_ports(pid):
    """Address and port of each TCP socket that a process listens on."""
    descriptors = Path(f"/proc/{pid}/fd").iterdir()
    own = set()
    for descriptor in descriptors:
        with contextlib.suppress(OSError):
            own.add(os.readlink(descriptor))
    found = set()
    for table in ("tcp", "tcp6"):
        for line in Path(f"/proc/{pid}/net/{table}").read_text().splitlines()[1:]:
            words = line.split()
            if words[3] == LISTENS and f"socket:[{words[9]}]" in own:
                address, _, port = words[1].partition(":")
                found.add((address, int(port, 16)))
    return found


def closed_at_once(port):
    """Whether a connection is closed without a byte, whatever is sent."""
    with socket.create_connection(("127.0.0.1", port), timeout=10) as other:
        with contextlib.suppress(OSError):  # it may be closed before that
            other.sendall(bytes(120))
        try:
            return other.recv(1) == b""
        except ConnectionResetError:
            return True


@needs_proc
def test_the_panels_port_takes_no_other_process():
    page = WebPage(MODEL)
    public = doors.port_of(page.url)
    try:
        ports = listening_ports(page._process.pid)
        assert {address for address, _ in ports} == {"0100007F"}  # 127.0.0.1
        (inner,) = {port for _, port in ports} - {public}
        assert closed_at_once(inner)
        stop = threading.Event()
        pest = threading.Thread(target=pester, args=(inner, stop))
        pest.start()
        try:
            headers = doors.bearer(page.url)
            address = f"ws://127.0.0.1:{public}/ui?sid=me"
            with connect(address, additional_headers=headers, close_timeout=0.1) as panel:
                panel.send(bytes(120))  # the hello of a browser's panel
                assert len(panel.recv(timeout=20)) == 120  # MuJoCo's own code answers
        finally:
            stop.set()
            pest.join()
        assert closed_at_once(inner)
    finally:
        page.close()


def pester(port, stop):
    """Connect to a port again and again."""
    while not stop.is_set():
        closed_at_once(port)
        time.sleep(0.01)


CONNECT = """
import socket, sys
with socket.create_connection(("127.0.0.1", int(sys.argv[1])), timeout=10) as other:
    other.settimeout(10)
    print(other.recv(2))
"""


def test_a_connection_of_the_same_process_is_known_by_both_its_ends():
    with OwnSocket(socket.create_server(("127.0.0.1", 0))) as listening:
        port = listening.getsockname()[1]
        with socket.create_connection(("127.0.0.1", port)) as mine:
            taken, address = listening.accept()
            with taken:
                assert address == mine.getsockname()
                assert is_own(taken)
                taken.sendall(b"hi")
                assert mine.recv(2) == b"hi"
        words = [sys.executable, "-c", CONNECT, str(port)]
        with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as other:
            with pytest.raises(ConnectionAbortedError, match="another process connected"):
                listening.accept()
            out, err = other.communicate(timeout=30)
        assert out.strip() == b"b''" or b"reset" in err
