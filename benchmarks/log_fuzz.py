"""Read thousands of mutated logs: `python -m benchmarks.log_fuzz`; prints what came of them.

Every file is inspected, read in every way that the reader has, verified, recovered, compared with
the whole one and exported, in a process that may use 1 GB more than it starts with. Each must give
data or one clear error (`ConfigError`), within a time.
"""

from __future__ import annotations

import argparse
import functools
import json
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmarks.log_mutations import KINDS, mutate
from benchmarks.machine import machine, table, write_json
from embodichain.utils.errors import ConfigError

if TYPE_CHECKING:
    from embodichain.recording.read.api import Log

ROOT = Path(__file__).parents[1]
SECONDS = 30
"""A file that takes more CPU time counts as a hang."""
MEMORY = 2**30
OUTCOMES = ("data", "data, warned", "refused", "traceback", "hang", "crash")
GOOD = OUTCOMES[:3]
FORMATS = ("csv", "npz", "parquet", "hdf5", "ros2", "lerobot")
"""Of exports that draw nothing, one for each file, in turn."""


class HangError(BaseException):
    """A file took too long; not an Exception, so that nothing takes it for damage."""


def main() -> int:
    """Fuzz in processes of their own, each going on where one crashed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=0, help="of the first file")
    parser.add_argument("--verify-every", type=int, default=1, help="verify and recover each k-th")
    parser.add_argument("--state", choices=("all", "keyframes"), default="all")
    parser.add_argument("--base", type=Path, help="a log to mutate; else a small one is recorded")
    parser.add_argument("--out", type=Path, help="write the figures as JSON")
    parser.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.worker:
        work(options.base, options.seed, options.count, options.verify_every)
        return 0
    with tempfile.TemporaryDirectory() as folder:
        base = options.base or record(Path(folder) / "base.mcap", options.state)
        found = run(base, options.seed, options.count, options.verify_every)
    print(report(found))
    if options.out:
        write_json(options.out, found)
    return 0 if not found["bad"] and found["memory_mb"] < MEMORY / 1e6 else 1


def record(path: Path, state: str = "all") -> Path:
    """A small log with everything that logs have."""
    sys.path.insert(0, str(ROOT))
    from embodichain.recording import McapRecorder, RecordOptions
    from tests.recording.scene import SmallEnv

    env: Any = SmallEnv(num_envs=2, settle=2, push=True)
    how = RecordOptions(state, keyframe_every=5)
    recorder = McapRecorder(path, env, "seed: 0\n", ["seed=0"], how, "small")
    env.add_observer(recorder)
    env.reset()
    for step in range(12):
        env.step()
        if step == 6:
            recorder.flush()
    env.close()
    return path


def run(base: Path, seed: int, count: int, every: int) -> dict[str, Any]:
    """Start workers until all files were read; one that dies has crashed on its last file."""
    outcomes: Counter[tuple[str, str]] = Counter()
    bad: list[str] = []
    memory = slowest = 0.0
    start, at, end = time.time(), seed, seed + count
    while at < end:
        flags = ["--seed", str(at), "--count", str(end - at), "--verify-every", str(every)]
        words = ["-m", "benchmarks.log_fuzz", "--worker", "--base", str(base), *flags]
        process = subprocess.Popen(
            [sys.executable, *words], cwd=ROOT, stdout=subprocess.PIPE, text=True
        )
        began = False
        for line in process.stdout or ():
            if not began:
                began = json.loads(line) == "ready"
                continue
            told = json.loads(line)
            outcomes[told["kind"], told["outcome"]] += 1
            memory, slowest = max(memory, told["memory_mb"]), max(slowest, told["seconds"])
            if told["outcome"] not in GOOD:
                bad.append(f"{at}: {told['kind']}: {told['outcome']}: {told['why']}")
            at += 1
        if process.wait() and not began:
            raise RuntimeError("a worker could not read the base file")
        if process.returncode and at < end:
            kind = list(KINDS)[at % len(KINDS)]
            outcomes[kind, "crash"] += 1
            bad.append(f"{at}: {kind}: crash: exit status {process.returncode}")
            at += 1
    return {
        "machine": machine(),
        "count": count,
        "outcomes": {k: {o: outcomes[k, o] for o in OUTCOMES} for k in KINDS},
        "bad": bad,
        "memory_mb": memory,
        "slowest_s": slowest,
        "minutes": (time.time() - start) / 60,
    }


def work(base: Path, seed: int, count: int, every: int) -> None:
    """Read files one after the other; one line of JSON for each."""
    data = base.read_bytes()
    signal.signal(signal.SIGPROF, _hang)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "mutated.mcap"
        mutate(data, list(KINDS).index("compression bomb"))  # packed once, before memory counts
        for turn in range(len(FORMATS)):
            check(base, everything=True, turn=turn)
        before = _peak()
        print(json.dumps("ready"), flush=True)
        for number in range(seed, seed + count):
            kind, mutated = mutate(data, number)
            path.write_bytes(mutated)
            start = time.perf_counter()
            turn, rest = divmod(number // len(KINDS), every)
            outcome, why = outcome_of(path, rest == 0, base, turn)
            seconds = time.perf_counter() - start
            told = {"kind": kind, "outcome": outcome, "why": why, "seconds": seconds}
            print(json.dumps({**told, "memory_mb": (_peak() - before) / 1e6}), flush=True)


def outcome_of(
    path: Path, everything: bool, base: Path | None = None, turn: int = 0
) -> tuple[str, str]:
    """What reading a file gives, and why if that is bad; arguments are those of `check`."""
    signal.setitimer(signal.ITIMER_PROF, SECONDS)
    try:
        return ("data" if check(path, everything, base, turn) else "data, warned"), ""
    except ConfigError as error:
        return ("refused", "") if _is_clear(error) else ("traceback", str(error))
    except HangError:
        return "hang", ""
    except Exception as error:  # noqa: BLE001  (the finding)
        at = error.__traceback__
        while at is not None and at.tb_next is not None:
            at = at.tb_next
        where = f"{Path(at.tb_frame.f_code.co_filename).name}:{at.tb_lineno}" if at else ""
        return "traceback", f"{where} {error!r}"[:300]
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)


def check(path: Path, everything: bool, base: Path | None = None, turn: int = 0) -> bool:
    """Read a file in every way; returns whether it is complete.

    Args:
        path: The file.
        everything: Whether to do more than to inspect it and to read its arrays.
        base: The file as it was, to compare with; None compares it with itself.
        turn: Chooses the format in which it is exported.

    Raises:
        ConfigError: It cannot be read in some way.
    """
    from embodichain.recording import diff, inspect, open, verify
    from embodichain.recording.read.recover import recover

    def read(log: Log) -> Any:
        return log.read(), log.episodes

    def simulated(log: Log) -> Any:
        return log.read("qpos") if log.header.keyframe_every else None

    saved = path.with_name("saved.mcap")
    ways: list[Callable[[], Any]] = [lambda: inspect(path), lambda: _with(open, path, read)]
    others: list[Callable[[], Any]] = []  # what is asked may lie behind the file's end
    if everything:
        ways += [lambda: verify(path, num_threads=1), lambda: recover(path, saved)]
        ways += [lambda: _with(functools.partial(open, simulate=True), path, simulated)]
        others += [lambda: diff(base or path, path)]
        others += [functools.partial(_with, open, path, way) for way in _readings(turn)]
    refused: ConfigError | None = None
    results = []
    for way in [*ways, *others]:
        try:
            results.append(way())
        except ConfigError as error:
            refused = refused or (error if way in ways else None)
            if not _is_clear(error):
                raise
        finally:
            for made in path.parent.glob("saved*"):
                shutil.rmtree(made) if made.is_dir() else made.unlink()
    if refused is not None:
        raise refused
    return bool(results[0].complete and not results[0].warnings)


def _is_clear(error: ConfigError) -> bool:
    return 0 < len(str(error).splitlines()) < 4


def _with(open: Callable[[Path], Log], path: Path, way: Callable[[Log], Any]) -> Any:
    with open(path) as log:
        return way(log)


def _readings(turn: int) -> list[Callable[[Log], Any]]:
    """What else can be asked of a log."""
    from embodichain.recording.export import export
    from embodichain.recording.read.playback import Playback, span_of

    format = FORMATS[turn % len(FORMATS)]
    return [
        lambda log: (log.config, log.versions, log.metrics(0)),
        lambda log: (list(log.events()), list(log.writes()), list(log.raw_messages())),
        lambda log: log.read(env=1, start=3, stop=9),
        lambda log: list(log.parts(steps=5)),
        lambda log: log.snapshot(1, step=5),
        lambda log: list(Playback(log, 0).steps(span_of(log, 0))),
        lambda log: export(log, format, log.path.with_name(f"saved_{format}")),
    ]


def _hang(number: int, frame: object) -> None:
    raise HangError


def _peak() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def report(found: dict[str, Any]) -> str:
    """The outcomes as a table, and every bad one."""
    rows = [
        [kind, *(f"{outcomes[o]:,}" for o in OUTCOMES)]
        for kind, outcomes in found["outcomes"].items()
    ]
    lines = [
        table(["mutation", *OUTCOMES], rows),
        "",
        f"{found['count']:,} files in {found['minutes']:.1f} min; the slowest took "
        f"{found['slowest_s']:.2f} s; at most {found['memory_mb']:.0f} MB more than at the start.",
    ]
    return "\n".join([*lines, *found["bad"][:50]])


if __name__ == "__main__":
    raise SystemExit(main())
