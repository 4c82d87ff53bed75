"""Processes told apart, and one that ends with another."""

import os
import subprocess
import sys
import time
from dataclasses import replace
from subprocess import PIPE

import pytest

from embodichain.utils.system.processes import ProcessId, own_process

PARENT = """
import subprocess, sys, threading, time
from embodichain.utils.system.processes import own_process

code = '''
import sys, time
from embodichain.utils.system.processes import ProcessId, end_with
end_with(ProcessId.parse(sys.argv[1]))
print("begun", flush=True)
time.sleep(600)
'''
command = [sys.executable, "-c", code, str(own_process())]

def start():  # by a thread that ends, which is no reason for the child to end
    child = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True)
    child.stdout.readline()
    print(child.pid, flush=True)

thread = threading.Thread(target=start)
thread.start()
thread.join()
time.sleep(600)
"""


def is_running(pid: int) -> bool:
    """Whether a process has not ended; it may not have been waited for."""
    try:
        with open(f"/proc/{pid}/stat") as stream:
            return stream.read().rpartition(")")[2].split()[0] not in "ZX"
    except FileNotFoundError:
        return False


def test_a_process_ends_with_the_one_that_is_killed_not_with_its_thread() -> None:
    with subprocess.Popen([sys.executable, "-c", PARENT], stdout=PIPE, text=True) as parent:
        assert parent.stdout is not None
        child = int(parent.stdout.readline())
        time.sleep(1.5)  # three times the watch's period
        assert is_running(child)
        parent.kill()
    end = time.monotonic() + 30.0
    while is_running(child) and time.monotonic() < end:
        time.sleep(0.05)
    assert not is_running(child)


def test_a_process_is_another_one_if_its_id_is_used_again() -> None:
    own = own_process()
    assert own.pid == os.getpid() and ProcessId.parse(str(own)) == own
    assert not own.has_ended
    assert replace(own, began=own.began - 1).has_ended
    assert not replace(own, began=0).has_ended  # not known
    assert not replace(own, place="00000000", began=1).has_ended  # of another machine


@pytest.mark.parametrize("text", ["", "12-3-4", "0123456g-1-2", "01234567-1-2-3"])
def test_another_text_is_no_process(text: str) -> None:
    assert ProcessId.parse(text) is None
