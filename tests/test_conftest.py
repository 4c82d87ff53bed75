"""What `conftest.py` gives to every test."""

import signal
import subprocess
import sys

IGNORED = (
    "import signal, sys; signal.signal(signal.SIGINT, signal.SIG_IGN); import pytest;"
    "sys.exit(pytest.main(['-q', '-p', 'no:cacheprovider', *sys.argv[1:]]))"
)


def test_ctrl_c_interrupts_a_test_and_what_it_starts() -> None:
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    code = "import signal; print(signal.getsignal(signal.SIGINT) is signal.SIG_IGN)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"


def test_ctrl_c_interrupts_a_test_of_a_background_job(request) -> None:
    """As after `make test &`, where the shell has SIGINT ignored."""
    other = test_ctrl_c_interrupts_a_test_and_what_it_starts.__name__
    command = [
        sys.executable,
        "-c",
        IGNORED,
        f"{__file__}::{other}",
        f"--rootdir={request.config.rootpath}",
    ]
    done = subprocess.run(
        command, cwd=request.config.rootpath, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout
