"""A Slurm on this machine for tests: munged, slurmctld and two slurmd, without systemd and cgroups.

All of it are descendants of one process, ``python tests/helpers/slurm_cluster.py FOLDER``, which
ends them when its standard input is closed: by the test, or by the kernel if the test is killed.
It is a subreaper (prctl(2)), so that job steps, which slurmd detaches, stay its descendants.
"""

import contextlib
import ctypes
import os
import secrets
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

PROGRAMS = ("munged", "slurmctld", "slurmd", "sbatch", "squeue", "scontrol", "scancel")
NODES = ("n1", "n2")
READY = "ready"
_SBIN = "/usr/local/sbin:/usr/sbin:/sbin"
_SUBREAPER = 36  # PR_SET_CHILD_SUBREAPER, see prctl(2)
_CONF = """\
ClusterName=embodichain
SlurmctldHost={host}(127.0.0.1)
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
AuthInfo=socket={folder}/munge.socket
StateSaveLocation={folder}/state
SlurmctldPort={controller}
SlurmctldPidFile={folder}/slurmctld.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdSpoolDir={folder}/spool.%n
SlurmdPidFile={folder}/slurmd.%n.pid
SlurmdLogFile={folder}/slurmd.%n.log
SlurmdParameters=config_overrides
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
SchedulerParameters=batch_sched_delay=0,sched_min_interval=0,bf_interval=1
ReturnToService=2
KillWait=20
MpiDefault=none
NodeName={nodes[0]} NodeHostname={host} NodeAddr=127.0.0.1 Port={ports[0]} CPUs=1 RealMemory=4000
NodeName={nodes[1]} NodeHostname={host} NodeAddr=127.0.0.1 Port={ports[1]} CPUs=1 RealMemory=4000
PartitionName=debug Nodes=ALL Default=YES MaxTime=INFINITE State=UP
"""


@dataclass(frozen=True)
class Slurm:
    """A running cluster: the environment of its commands."""

    folder: Path
    env: dict[str, str]

    def call(self, *command: str) -> str:
        """The output of one of Slurm's commands."""
        done = subprocess.run(command, env=self.env, capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"{command}: {done.stderr}"
        return done.stdout


def why_not() -> str | None:
    """Why no Slurm can be started here, or None."""
    if os.geteuid() != 0:
        return "slurmctld and slurmd are started as root"
    missing = [name for name in PROGRAMS if shutil.which(name, path=_path()) is None]
    what = "apt-get install slurmctld slurmd slurm-client munge (scripts/system_deps.sh does)"
    return f"no {', '.join(missing)}: {what}" if missing else None


@contextlib.contextmanager
def slurm(folder: Path) -> Iterator[Slurm]:
    """Start a cluster whose files are in `folder`; it has ended when the context is left."""
    folder.mkdir(parents=True, exist_ok=True)
    env = {**os.environ, "SLURM_CONF": str(folder / "slurm.conf"), "PATH": _path()}
    with (folder / "keeper.log").open("w") as log:
        command = [sys.executable, __file__, str(folder)]
        keeper = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=log, stderr=log, start_new_session=True, env=env
        )
    assert keeper.stdin is not None
    try:
        _wait(lambda: (folder / READY).exists() or keeper.poll() is not None)
        found = Slurm(folder, env)
        _wait(lambda: _idle(found))
        yield found
    finally:
        keeper.stdin.close()
        keeper.wait(timeout=20)


def _idle(cluster: Slurm) -> bool:
    return cluster.call("sinfo", "--noheader", "--format=%T %D").strip() == f"idle {len(NODES)}"


def _path() -> str:
    return f"{os.environ.get('PATH', '')}:{_SBIN}"


def _wait(done: object, seconds: float = 30.0) -> None:
    end = time.monotonic() + seconds
    while not done():  # type: ignore[operator]
        if time.monotonic() > end:
            raise TimeoutError(f"no Slurm after {seconds} s")
        time.sleep(0.05)


def _free_ports(count: int) -> list[int]:
    with contextlib.ExitStack() as stack:
        found = [stack.enter_context(socket.socket()) for _ in range(count)]
        for one in found:
            one.bind(("127.0.0.1", 0))
        return [one.getsockname()[1] for one in found]


def _keep(folder: Path) -> None:
    """Start the daemons, and end everything when standard input is closed."""
    ctypes.CDLL(None).prctl(_SUBREAPER, 1, 0, 0, 0)
    controller, *ports = _free_ports(3)
    values = {"folder": folder, "host": socket.gethostname(), "nodes": NODES, "ports": ports}
    conf = folder / "slurm.conf"
    conf.write_text(_CONF.format(controller=controller, **values))
    (folder / "state").mkdir(exist_ok=True)
    key = folder / "munge.key"
    key.write_bytes(secrets.token_bytes(128))
    key.chmod(0o600)
    socket_file = folder / "munge.socket"
    files = {"key-file": key, "socket": socket_file, "pid-file": folder / "munged.pid"}
    files |= {"log-file": folder / "munged.log", "seed-file": folder / "munge.seed"}
    try:
        _start("munged", "--foreground", "--force", *(f"--{n}={f}" for n, f in files.items()))
        _wait(socket_file.exists)
        _start("slurmctld", "-D", "-f", str(conf))
        for node in NODES:
            _start("slurmd", "-D", "-N", node, "-f", str(conf))
        (folder / READY).touch()
        sys.stdin.read()
    finally:
        _end_descendants()


def _start(*command: str) -> None:
    subprocess.Popen(command, stdin=subprocess.DEVNULL)


def _end_descendants() -> None:
    """Kill all descendants; those of a killed one become children of this process."""
    end = time.monotonic() + 10
    while (children := _children(os.getpid())) and time.monotonic() < end:
        for child in children:
            with contextlib.suppress(ProcessLookupError):
                os.kill(child, signal.SIGKILL)
        with contextlib.suppress(ChildProcessError):
            while os.waitpid(-1, os.WNOHANG)[0]:
                pass
        time.sleep(0.02)


def _children(pid: int) -> list[int]:
    found: list[int] = []
    for task in Path(f"/proc/{pid}/task").iterdir():
        found += map(int, (task / "children").read_text().split())
    return found


if __name__ == "__main__":
    _keep(Path(sys.argv[1]))
