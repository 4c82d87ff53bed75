"""Kill recording processes at random moments: `python -m benchmarks.log_survival`.

Each is killed by SIGKILL; then its log is read, verified and recovered, and what was made but is
not in it is timed. The processes are forked from one that has imported everything: moments fall
into all that a recording does, not into imports.
"""

from __future__ import annotations

import argparse
import json
import mmap
import os
import random
import signal
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.machine import table, write_json
from embodichain.utils.errors import ConfigError

TASK, NUM_ENVS = "random_reach", 16
LONGEST = 4.0
"""Seconds of a process's life until it is killed at the latest."""
PAUSE = 0.01
"""Seconds between steps: without, chunks fill before they are a second old, and little is lost."""
MOST_STEPS = 200_000


def main() -> int:
    """Kill, look, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="write the figures as JSON")
    options = parser.parse_args()
    rng = random.Random(options.seed)
    with tempfile.TemporaryDirectory() as folder:
        _import_everything()
        moments = [rng.uniform(0.0, LONGEST) for _ in range(options.kills)]
        found = [kill_one(Path(folder) / str(i), moment) for i, moment in enumerate(moments)]
    print(report(found))
    if options.out:
        write_json(options.out, {"kills": found})
    return 0 if not any(one["wrong"] for one in found) else 1


def _import_everything() -> None:
    from embodichain import make

    env: Any = make(TASK, num_envs=1)
    env.reset()
    env.close()


def kill_one(folder: Path, moment: float) -> dict[str, Any]:
    """Start a recording, kill it after `moment` seconds, and look at what is left.

    Args:
        folder: Made for it.
        moment: Seconds.
    """
    folder.mkdir()
    shared = mmap.mmap(-1, 8 * (MOST_STEPS + 1))
    times = np.frombuffer(shared, np.float64)
    sys.stdout.flush()
    child = os.fork()
    if not child:
        try:
            _record(folder, times)
        finally:
            os._exit(1)
    time.sleep(moment)
    os.kill(child, signal.SIGKILL)
    killed = time.monotonic()
    _, status = os.waitpid(child, 0)
    found = look(folder, times[: int(times[-1])].copy(), killed)
    if os.waitstatus_to_exitcode(status) != -signal.SIGKILL:
        found["wrong"].append("it ended by itself")
    return {"moment": moment, **found}


def _record(folder: Path, times: Any) -> None:
    """Step until killed; the moment of every step's end, and their number last, are shared."""
    from embodichain import make
    from embodichain.recording import McapRecorder

    env: Any = make(TASK, num_envs=NUM_ENVS)
    env.add_observer(McapRecorder(folder / "rollout.mcap", env))
    env.reset()
    home = env.robot.get_qpos()
    for step in range(MOST_STEPS):
        env.step(home)
        times[step] = time.monotonic()
        times[-1] = step + 1
        time.sleep(PAUSE)


def look(folder: Path, times: Any, killed: float) -> dict[str, Any]:
    """Read, verify and recover a killed process's log; what is wrong with it is listed."""
    from embodichain.recording import inspect, verify
    from embodichain.recording.read.recover import recover

    path, saved = folder / "rollout.mcap", folder / "saved.mcap"
    found: dict[str, Any] = {"made": len(times), "steps": 0, "lost_s": 0.0, "wrong": []}
    wrong: list[str] = found["wrong"]
    before = path.read_bytes() if path.exists() else b""
    try:
        found["steps"] = inspect(path).steps
        broken = verify(path)
        recovered = recover(path, saved)
        clean = verify(saved)
    except ConfigError as error:
        found["state"] = "before the log had its metadata" if path.exists() else "before the log"
        if len(times) and killed - times[0] > 1.5:
            wrong.append(f"{len(times)} steps were made, and it reads: {error}")
    else:
        found["state"] = "with steps" if found["steps"] else "before the first flush"
        if broken.difference is not None or len(broken.problems) != 1:
            wrong.append(f"the broken log: {broken}")
        if not clean.ok or not clean.steps == recovered.steps == broken.steps == found["steps"]:
            wrong.append(f"the recovered log: {clean}")
        if path.read_bytes() != before:
            wrong.append("the broken log was changed")
    layout = folder / "foxglove_layout.json"
    if found["steps"] and not json.loads(layout.read_text()):
        wrong.append("the layout beside it is damaged")
    if found["steps"] < len(times):
        found["lost_s"] = killed - float(times[found["steps"]])
    return found


def report(found: Sequence[dict[str, Any]]) -> str:
    """How the files were, and how much of the newest was lost."""
    rows = []
    for state in dict.fromkeys(one["state"] for one in found):
        those = [one for one in found if one["state"] == state]
        most = max(one["lost_s"] for one in those)
        steps = sum(one["steps"] for one in those)
        bad = sum(bool(one["wrong"]) for one in those)
        rows.append([f"killed {state}", len(those), f"{steps:,}", f"{most:.2f}", bad])
    lines = [table(["moment", "logs", "steps read and verified", "most lost, s", "wrong"], rows)]
    return "\n".join([*lines, *(problem for one in found for problem in one["wrong"])])


if __name__ == "__main__":
    raise SystemExit(main())
