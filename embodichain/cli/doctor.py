"""`embodichain doctor`: what this machine has, and what to do where something is missing.

A check never raises: what it finds is its result. Exits 1 when something that every run needs is
not there.
"""

from __future__ import annotations

import importlib.metadata as metadata
import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

from embodichain.cli import process
from embodichain.cli.app import verb
from embodichain.cli.extras import EXTRAS
from embodichain.cli.output import print_json, print_table

__all__ = ["Check", "command"]

_CORE = (
    *("mujoco", "numpy", "torch", "tensordict", "gymnasium", "stable-baselines3", "hydra-core"),
    *("omegaconf", "pydantic", "mcap", "protobuf", "rich"),
)
_LOW_DISK_GB = 2.0
_BALL = "<mujoco><worldbody><light pos='0 0 3'/><geom size='.1'/></worldbody></mujoco>"
_NO_PICTURE = "apt-get install libegl1 libgl1-mesa-dri, or set MUJOCO_GL to what works here"
_RENDER = "from embodichain.cli.doctor import render_once; render_once()"


@dataclass(frozen=True, slots=True)
class Check:
    """One line of the report.

    Attributes:
        part: What was looked at.
        state: ``ok``; ``warn``: works, but; ``missing``: optional and not there; ``fail``.
        found: What was found.
        advice: What to do, or empty.
    """

    part: str
    state: Literal["ok", "warn", "missing", "fail"]
    found: str
    advice: str = ""


@verb(
    "doctor",
    ("doctor", "a table, with what to do where something is missing"),
    ("doctor --json", ""),
)
def command(json: bool) -> int:
    """Check everything and print it."""
    checks = [check for section in _SECTIONS for check in section()]
    if json:
        print_json({"checks": [asdict(check) for check in checks]})
    else:
        print_table("this machine", [asdict(check) for check in checks])
    return process.FAILED if any(check.state == "fail" for check in checks) else process.OK


def _versions() -> Iterator[Check]:
    import embodichain

    yield Check("embodichain", "ok", embodichain.__version__)
    yield Check("Python", "ok", f"{platform.python_version()} on {platform.platform()}")
    for name in _CORE:
        try:
            yield Check(name, "ok", metadata.version(name))
        except metadata.PackageNotFoundError:
            yield Check(name, "fail", "not installed", f"pip install {name}")


def _threads() -> Iterator[Check]:
    usable, present = len(os.sched_getaffinity(0)), os.cpu_count()
    yield Check("threads", "ok", f"{usable} of {present} cores; sim.num_threads=0 uses them all")
    limit = os.environ.get("OMP_NUM_THREADS")
    if limit:
        yield Check("OMP_NUM_THREADS", "ok", f"{limit} (torch's threads; not the engine's)")


def _rendering() -> Iterator[Check]:
    """A tiny picture, in a process of its own: a broken driver may take it down."""
    try:
        done = subprocess.run(
            [sys.executable, "-c", _RENDER], capture_output=True, text=True, timeout=60, check=False
        )
    except subprocess.TimeoutExpired:
        yield Check("rendering", "warn", "no picture within 60 s", _NO_PICTURE)
        return
    if done.returncode == 0:
        yield Check("rendering", "ok", done.stdout.strip())
    else:
        lines = done.stderr.strip().splitlines() or [f"exit code {done.returncode}"]
        yield Check("rendering", "warn", lines[-1], _NO_PICTURE)


def render_once() -> None:
    """Draw one small picture and say with what; raises where no picture can be made."""
    import mujoco

    from embodichain.lab.sim.engine.cpu import CpuEngine
    from embodichain.lab.sim.rendering import SceneRenderer, View

    model = mujoco.MjModel.from_xml_string(_BALL)
    renderer = SceneRenderer(model, 64, 48)
    look = View.look_at((0.4, -0.4, 0.4), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 45.0)
    picture = renderer.draw(CpuEngine(model, 1), 0, look)
    renderer.close()
    from mujoco.rendering.classic import gl_context

    backend = gl_context.GLContext.__module__.rpartition(".")[2]
    if picture.max() == picture.min():
        raise RuntimeError(f"{backend} draws an empty picture")
    sys.stdout.write(f"off screen, with {backend}")


def _display() -> Iterator[Check]:
    display = os.environ.get("WAYLAND_DISPLAY") or os.environ.get("DISPLAY")
    if display:
        yield Check("display", "ok", f"{display}: viewer=native opens a window")
    else:
        yield Check("display", "missing", "none: viewer=native warns and runs without a window")


def _disk() -> Iterator[Check]:
    folder = Path("outputs").resolve()
    existing = next(p for p in (folder, *folder.parents) if p.exists())
    free = shutil.disk_usage(existing).free / 1e9
    state: Literal["ok", "warn"] = "ok" if free > _LOW_DISK_GB else "warn"
    advice = "" if state == "ok" else "logs of many environments are large: record=none, or room"
    yield Check("disk", state, f"{free:.1f} GB free for {folder}", advice)
    if not os.access(existing, os.W_OK):
        yield Check("outputs", "warn", f"{existing} cannot be written", "run elsewhere")


def _optional() -> Iterator[Check]:
    for name, extra in EXTRAS.items():
        versions, missing = extra.found()
        listed = ", ".join(f"{package} {version}" for package, version in versions.items())
        if not missing:
            yield Check(name, "ok", listed)
            continue
        lacking = f"not installed: {', '.join(missing)}"
        found = f"{lacking} (there: {listed})" if listed else lacking
        yield Check(name, "missing", found, f"{extra.purpose}: pip install {extra.install}")
    yield Check("CUDA", "missing", "device=cuda is not available in this version: device=cpu")


def _randomness() -> Iterator[Check]:
    """Classes and terms whose results depend on num_envs: they draw from a global generator."""
    from embodichain.cli.global_random import global_draws, registered_code

    found = False
    for name, thing in registered_code():
        for draw in global_draws(thing):
            found = True
            advice = "use env.rand or env.randn: the same numbers whatever num_envs is"
            yield Check(name, "warn", f"draws from a global generator: {draw}", advice)
    if not found:
        yield Check("random numbers", "ok", "no registered class or term uses a global generator")


_SECTIONS: tuple[Callable[[], Iterator[Check]], ...] = (
    *(_versions, _threads, _rendering, _display, _disk, _optional, _randomness),
)
