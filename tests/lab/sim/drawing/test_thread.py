"""The render thread: results, exceptions, signals while waiting, forks, the end of a process."""

import os
import signal
import subprocess
import sys
import threading
import time
import traceback

import pytest

from embodichain.lab.sim.drawing.thread import RenderThread, render_thread
from embodichain.utils.errors import RenderError

pytestmark = pytest.mark.slow


def test_all_calls_run_in_one_other_thread_in_order():
    thread, seen = RenderThread(), []
    for number in range(3):
        thread.call_later(lambda number=number: seen.append((number, threading.get_ident())))
    ident = thread.call(threading.get_ident)
    assert [number for number, _ in seen] == [0, 1, 2]
    assert {where for _, where in seen} == {ident} != {threading.get_ident()}
    assert thread.call(lambda: thread.call(threading.get_ident)) == ident  # from within
    assert render_thread() is render_thread()


def test_an_exception_comes_back_with_its_traceback():
    def draw_something_wrong():
        raise ZeroDivisionError("no pixels")

    thread = RenderThread()
    with pytest.raises(ZeroDivisionError, match="no pixels") as caught:
        thread.call(draw_something_wrong)
    assert "draw_something_wrong" in "".join(traceback.format_tb(caught.value.__traceback__))
    assert thread.call(lambda: 1) == 1  # it goes on


def test_what_fails_later_is_logged(caplog):
    thread = RenderThread()
    thread.call_later(lambda: 1 / 0)
    assert thread.call(lambda: 1) == 1
    assert "division by zero" in caplog.text


def test_a_signal_while_waiting_raises_after_the_drawing_ended():
    thread, ended = RenderThread(), []

    def draw():
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.2)
        ended.append(True)

    with pytest.raises(KeyboardInterrupt):
        thread.call(draw)
    assert ended == [True]
    assert thread.call(lambda: 2) == 2


def test_a_forked_process_is_refused_and_ends():
    thread = RenderThread()
    thread.call(lambda: None)
    read, write = os.pipe()
    child = os.fork()
    if not child:
        try:
            thread.call_later(lambda: None)
            thread.call(lambda: None)
        except RenderError as error:
            os.write(write, str(error).encode())
        finally:
            os._exit(0)
    os.close(write)
    with os.fdopen(read) as said:
        assert "forked from one that made pictures" in said.read()
    assert os.waitpid(child, 0)[1] == 0


SCENE = "<mujoco><worldbody><geom size='1'/></worldbody></mujoco>"


@pytest.mark.unmeasured
@pytest.mark.parametrize("last", ["", "renderer.close()", "del renderer", "fork()", "1 / 0"])
def test_the_process_ends(last):
    """With an open renderer, a closed one, one that is garbage, a fork, and an exception."""
    script = f"""
import os, mujoco
from embodichain.lab.sim.drawing.offscreen import OffscreenRenderer
from embodichain.lab.sim.drawing.states import DataState
from embodichain.lab.sim.drawing.views import Viewpoint
model = mujoco.MjModel.from_xml_string({SCENE!r})
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
renderer = OffscreenRenderer(model)
for kind in ("classic", "layered"):
    os.environ["EMBODICHAIN_RENDERER"] = kind
    renderer = OffscreenRenderer(model)  # the other one is garbage
    assert renderer.pictures(DataState(data), Viewpoint.look_at([3, 0, 1], [0, 0, 0]), (8, 8)).any()
def fork():
    child = os.fork()
    if not child:
        try:
            renderer.pictures(DataState(data), Viewpoint.look_at([3, 0, 1], [0, 0, 0]), (8, 8))
        except RuntimeError as error:
            print("refused")
        raise SystemExit(0)
    assert os.waitpid(child, 0)[1] == 0
{last}
"""
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=240, check=False
    )
    assert done.returncode == (1 if "/" in last else 0), done.stderr
    assert ("ZeroDivisionError" in done.stderr) == ("/" in last)
    assert done.stdout == ("refused\n" if last == "fork()" else "")
    assert "ignored" not in done.stderr and "EGL" not in done.stderr  # in a destructor
