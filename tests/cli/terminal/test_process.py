"""A signal ends what is under way, wherever it arrives."""

import contextlib
import os
import signal
import subprocess
import sys
import textwrap
import time

import pytest

from embodichain.cli.terminal.process import Interrupted, interrupts_say, signals_raise

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


@pytest.mark.parametrize("consequence", ["", "nothing was written"])
def test_a_signal_for_which_a_library_raises_its_own_error_is_an_interrupt(
    consequence: str,
) -> None:
    """HDF5 raises a TypeError if a signal comes while it converts values."""

    def raise_as_a_library() -> None:
        with contextlib.suppress(BaseException):
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(1)
        raise TypeError("Operation not defined for data type class")

    expected = "interrupted (SIGTERM)"
    if consequence:
        expected = f"interrupted (SIGTERM); {consequence}"
    with (
        pytest.raises(Interrupted) as interrupted,
        signals_raise(),
        interrupts_say(consequence),
    ):
        raise_as_a_library()
    assert str(interrupted.value) == expected
    assert interrupted.value.signal == "SIGTERM"
    assert isinstance(interrupted.value.__cause__, TypeError | Interrupted)


def test_an_error_after_a_signal_of_an_earlier_command_stays() -> None:
    with pytest.raises(Interrupted), signals_raise():
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(1)
    with pytest.raises(TypeError, match="of the second"), signals_raise():
        raise TypeError("of the second")
