"""`OwnSocket`: a loopback socket on which a process talks to itself, and to nobody else.

MuJoCo's web viewer draws its panel through one: native code connects to a port that a thread of the
same process listens on. Any local user could connect to it instead, draw the panel, and read what
is typed.
"""

from __future__ import annotations

import os
import socket
import stat
from typing import Any

__all__ = ["OwnSocket", "is_own"]

_DESCRIPTORS = "/dev/fd"
"""This process's open files, on Linux and macOS."""


class OwnSocket(socket.socket):
    """A listening socket that takes connections of this process only; others are closed at once.

    Args:
        listening: A listening socket, which is taken over.
    """

    def __init__(self, listening: socket.socket) -> None:
        timeout = listening.gettimeout()
        super().__init__(listening.family, listening.type, listening.proto, listening.detach())
        self.settimeout(timeout)

    def accept(self) -> tuple[socket.socket, Any]:
        """Accept a connection.

        Raises:
            ConnectionAbortedError: It is another process's, and was closed. Servers go on to the
                next one.
        """
        connection, address = super().accept()
        if not is_own(connection):
            connection.close()
            raise ConnectionAbortedError("another process connected")
        return connection, address


def is_own(connection: socket.socket) -> bool:
    """Whether the other end of a TCP connection is a socket of this process.

    A pair of addresses belongs to one connection, so its other end is the socket that has them the
    other way round.
    """
    try:
        ends = (connection.getpeername(), connection.getsockname())
    except OSError:  # closed already
        return False
    for name in os.listdir(_DESCRIPTORS):
        try:
            if not stat.S_ISSOCK(os.fstat(int(name)).st_mode):
                continue
            with socket.socket(fileno=os.dup(int(name))) as other:
                if (other.getsockname(), other.getpeername()) == ends:
                    return True
        except OSError:  # closed meanwhile, or not connected
            continue
    return False
