"""Executes a script in a process that was forked from one with torch and MuJoCo imported.

Nothing else is shared: namespace, working directory and what the script changes are its own.
"""

import multiprocessing
import os
import runpy
import sys
from pathlib import Path

__all__ = ["run_forked"]

_CONTEXT = multiprocessing.get_context("forkserver")
_CONTEXT.set_forkserver_preload(["torch", "mujoco", "gymnasium", "stable_baselines3"])


def run_forked(code: str, folder: Path, timeout: float = 200) -> tuple[int | None, str]:
    """Execute a script as `python script.py` in a folder does.

    Args:
        code: Its text.
        folder: An empty one: the working directory, and the first on the path of modules.
        timeout: In seconds.

    Returns:
        The exit code (negative of a signal; None if it did not end in time), and what it printed.
    """
    said = folder.with_name(f"{folder.name}.said")
    process = _CONTEXT.Process(target=_execute, args=(code, str(folder), str(said)))
    process.start()
    process.join(timeout)
    code_of_exit = process.exitcode
    process.kill()
    process.join()
    return code_of_exit, said.read_text(encoding="utf-8") if said.exists() else ""


def _execute(code: str, folder: str, said: str) -> None:
    descriptor = os.open(said, os.O_WRONLY | os.O_CREAT, 0o600)
    for number in (1, 2):
        os.dup2(descriptor, number)
    os.chdir(folder)
    script = Path(folder, "block.py")
    script.write_text(code, encoding="utf-8")
    sys.argv = [str(script)]
    sys.path.insert(0, folder)
    runpy.run_path(str(script), run_name="__main__")
