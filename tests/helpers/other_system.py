"""Pretends to be Python on Windows: `python other_system.py < COMMANDS`.

Packages of others are imported first, as themselves: only ours are to meet the other system. Then
modules and functions of Python that Windows lacks are taken away (macOS lacks fewer of them), every
module of ours is imported, and the commands on standard input (a JSON list of argument lists) are
run. Prints JSON: the modules that failed to import, and the exit code and output of each command.
"""

import contextlib
import importlib
import io
import json
import os
import pkgutil
import signal
import sys

MODULES = ("fcntl", "grp", "posix", "pty", "pwd", "resource", "termios", "tty")
OS_NAMES = (
    *("sched_getaffinity", "sched_setaffinity", "fork", "register_at_fork", "sysconf", "pread"),
    *("O_DIRECTORY", "O_CLOEXEC", "getloadavg", "getuid", "geteuid", "killpg", "mkfifo", "setsid"),
)
SIGNALS = ("SIGUSR1", "SIGUSR2", "SIGHUP", "SIGALRM", "pthread_kill")
NOT_THERE = ("embodichain.learning.tensors.rsl_rl_ppo", "embodichain.learning.tensors.skrl_ppo")
"""They import an extra, which imports modules of the other system."""
OTHERS = (
    *("click", "rich.console", "rich.table", "rich.progress", "numpy", "torch", "mujoco.batch"),
    *("gymnasium", "hydra", "hydra._internal.config_loader_impl", "omegaconf", "pydantic", "yaml"),
    *("mcap.reader", "mcap.writer", "google.protobuf.message", "trimesh", "PIL.Image", "tempfile"),
    *("stable_baselines3", "multiprocessing.connection", "subprocess", "platform", "socket"),
)


def pretend() -> None:
    for name in OTHERS:
        importlib.import_module(name)
    sys.platform = "win32"
    os.environ["LOCALAPPDATA"] = os.getcwd()
    for name in MODULES:
        sys.modules[name] = None
    for module, names in ((os, OS_NAMES), (signal, SIGNALS)):
        for name in names:
            delattr(module, name)


def imports() -> dict[str, str]:
    """Every module of the package that cannot be imported -> why."""
    import embodichain

    failed = {}
    for module in pkgutil.walk_packages(embodichain.__path__, "embodichain."):
        if module.name.endswith("__main__") or module.name in NOT_THERE:
            continue
        try:
            importlib.import_module(module.name)
        except Exception as error:  # noqa: BLE001  (each is reported)
            failed[module.name] = f"{type(error).__name__}: {error}"
    return failed


def ran(arguments: list[str]) -> dict[str, object]:
    from embodichain.cli import main

    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main(arguments)
    return {"code": code, "out": out.getvalue(), "err": err.getvalue()}


if __name__ == "__main__":
    pretend()
    failed = imports()
    results = [ran(arguments) for arguments in json.load(sys.stdin)]
    print(json.dumps({"failed": failed, "results": results}))
