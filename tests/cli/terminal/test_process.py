"""A signal ends what is under way, wherever it arrives."""

import subprocess
import sys
import textwrap

import pytest

from embodichain.cli.terminal.process import Interrupted

ARRIVES_IN = {
    "a callback of a weak reference": "weakref.ref(target, lambda _: os.kill(os.getpid(), 15))",
    "a finalizer": "setattr(Target, '__del__', lambda self: os.kill(os.getpid(), 15))",
    "code that discards it": "discard()",
}


@pytest.mark.parametrize("setup", ARRIVES_IN.values(), ids=ARRIVES_IN)
def test_a_signal_whose_exception_python_ignores_is_delivered_again(setup: str) -> None:
    script = textwrap.dedent(f"""
        import os, time, weakref
        from embodichain.cli.terminal.process import signals_raise

        class Target:
            pass

        def discard():
            try:
                os.kill(os.getpid(), 15)
                time.sleep(1)
            except BaseException:
                pass

        target = Target()
        with signals_raise():
            kept = {setup}
            del target
            time.sleep(60)
    """)
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=50, check=False
    )
    assert done.stderr.splitlines()[-1] == f"{Interrupted.__module__}.Interrupted: " + (
        "interrupted (SIGTERM)"
    )
    assert "Exception ignored" not in done.stderr
