"""The process that writes logs, as a thread of this one: what a test patches holds for it too."""

import os
import socket
import threading

from embodichain.recording import worker, write_process


class Here:
    """Stands for a `Worker`."""

    def __init__(self):
        self.orders = self._slabs = 0
        self.connection, theirs = socket.socketpair()
        hurry, self._hurry = os.pipe()
        ends = theirs.detach(), hurry
        self.thread = threading.Thread(target=write_process.main, args=ends, daemon=True)
        self.thread.start()

    def new_slab(self):
        self._slabs += 1
        return self._slabs

    def hurry(self):
        os.write(self._hurry, b"!")

    def close(self):
        self.connection.close()
        os.close(self._hurry)
        self.thread.join()


def write_here(patch=setattr):
    """Have every log that is opened from now on written by a thread.

    Args:
        patch: pytest's `monkeypatch.setattr`, or `setattr` for good.
    """
    patch(worker, "acquire", Here)
    patch(worker, "release", Here.close)
