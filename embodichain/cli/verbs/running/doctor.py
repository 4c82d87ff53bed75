"""`embodichain doctor`: checks of this machine, with advice on what is missing.

A check never raises. The exit code is 1 if something that every run needs is missing.
"""

from __future__ import annotations

import os
import platform
import re
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import Any, Literal

import click

from embodichain.cli.terminal import process
from embodichain.cli.terminal.output import print_json, print_table, wrapped
from embodichain.cli.verb import verb
from embodichain.utils.errors import ConfigError
from embodichain.utils.register import Register
from embodichain.utils.system import platforms

__all__ = ["EXTRAS", "Check", "command"]

EXTRAS = {
    "robots": ("robots of example-robot-data", "example-robot-data"),
    "rsl-rl": ("trainings on the environment's device", "rsl-rl-lib"),
    "skrl": ("trainings on the environment's device", "skrl"),
    "gpu": ("MuJoCo Warp: device=cuda", "mujoco-warp", "warp-lang"),
    "decompose": ("convex parts of meshes: collision: decompose", "coacd"),
    "plot": ("curves of trainings as PNG", "matplotlib"),
    "wandb": ("trainings in Weights & Biases", "wandb"),
    "sweep": (
        "sweeps in parallel, and searches with Optuna",
        "hydra-joblib-launcher",
        "hydra-optuna-sweeper",
        "joblib",
        "alembic",
        "sqlalchemy",
    ),
    "slurm": ("sweeps on Slurm", "submitit"),
    "study": ("which factor breaks a policy, in studies", "statsmodels", "pyarrow"),
    "ray": ("many machines: sim.backend=ray", "ray", "cloudpickle"),
    "export": ("policies as ONNX files", "onnx", "onnxruntime"),
    "video": ("films: video=true, replay --video", "imageio-ffmpeg"),
    "h264": ("videos of cameras in logs: record.images", "av"),
    "pandas": ("logs as data frames", "pandas"),
    "parquet": ("logs as Parquet files", "pyarrow"),
    "hdf5": ("logs as HDF5 files", "h5py"),
    "ros2": ("logs as ROS 2 bags", "rosbags"),
    "rerun": ("logs as recordings for Rerun", "rerun-sdk"),
    "lerobot": ("logs as LeRobot data sets", "pandas", "pyarrow", "imageio-ffmpeg"),
}
"""Extra of this package -> its purpose and its packages (versions are in `pyproject.toml`).

What registers name it is added to its purpose: `sim.engine=warp`."""
OTHERS = {
    "tensorboard": "event files of trainings",
    "sb3-contrib": "algorithms TRPO, TQC, CrossQ, RecurrentPPO",
}
"""Optional package that is in no extra -> its purpose."""
_CORE = (
    "mujoco",
    "numpy",
    "torch",
    "tensordict",
    "gymnasium",
    "stable-baselines3",
    "hydra-core",
    "omegaconf",
    "pydantic",
    "mcap",
    "protobuf",
    "rich",
)
_STATE_WORDS = {"fail": "failed", "warn": "limited", "ok": "ok", "missing": "not here"}
"""State of a check -> how the table calls it, in the order of its rows."""
_LOW_DISK_GB = 2.0
_BALL = "<mujoco><worldbody><light pos='0 0 3'/><geom size='.1'/></worldbody></mujoco>"
_NO_PICTURE = (
    "apt-get install libegl1 libgl1-mesa-dri libopengl0, or set MUJOCO_GL to what works here"
)
_RENDER = "from embodichain.cli.verbs.running.doctor import render_once; render_once()"


@dataclass(frozen=True, slots=True)
class Check:
    """One line of the report.

    Attributes:
        part: Name of the check.
        state: ``ok``; ``warn``: works with limits; ``missing``: optional, not installed; ``fail``.
        found: The result.
        advice: What to do, or empty.
        purpose: What an optional package is for, or empty.
    """

    part: str
    state: Literal["ok", "warn", "missing", "fail"]
    found: str
    advice: str = ""
    purpose: str = ""


@dataclass(frozen=True)
class DoctorOptions:
    """What was typed after `doctor`.

    Attributes:
        extras: Print what each optional package is for, and how to install it.
        json: Print the result as one JSON object.
    """

    extras: bool
    json: bool


@verb(
    "doctor",
    ("doctor", "what does not work is on top"),
    ("doctor --extras", "what each extra is for, and how to install it"),
    ("doctor --json", ""),
    options=DoctorOptions,
)
@click.option("--extras", is_flag=True, help="What each extra is for, and how to install it.")
def command(options: DoctorOptions) -> int:
    """Run all checks and print their results."""
    machine = [
        *_versions(),
        *_threads(),
        *_rendering(),
        *_display(),
        *_disk(),
        *_randomness(),  # the first that imports MuJoCo: it reports whether that is possible
    ]
    extras = list(_extras())
    machine.append(_cuda())
    if options.json:
        print_json({"checks": [asdict(check) for check in (*machine, *extras)]})
    else:
        _print_machine(machine)
        if options.extras:
            _print_extras(extras)
        else:
            _summarize_extras(extras)
    return process.FAILED if any(check.state == "fail" for check in machine) else process.OK


def _print_machine(checks: Sequence[Check]) -> None:
    """Print what was checked of this machine; what does not work is on top."""
    packages = [check for check in checks if check.part in _CORE and check.state == "ok"]
    versions = ", ".join(f"{check.part} {check.found}" for check in packages)
    rows = [check for check in checks if check not in packages]
    if versions:
        rows.insert(2, Check("packages", "ok", versions))  # after Python
    rows.sort(key=lambda check: list(_STATE_WORDS).index(check.state))
    table = []
    for check in rows:
        state = _STATE_WORDS[check.state]
        table.append({"part": check.part, "state": state, "result": check.found})
    if any(check.advice for check in rows):
        for row, check in zip(table, rows, strict=True):
            row["advice"] = check.advice
    print_table(f"this machine: {_verdict(checks)}", table)


def _verdict(checks: Sequence[Check]) -> str:
    """Whether tasks can run here, in a few words."""
    counts = Counter(check.state for check in checks)
    if counts["fail"]:
        return f"not ready, {counts['fail']} of the checks failed"
    if counts["warn"]:
        return f"ready, but {counts['warn']} of the checks found a limit"
    return "ready"


def _print_extras(checks: Sequence[Check]) -> None:
    """Print a row for each optional package, those that are not installed last."""
    rows = []
    for check in sorted(checks, key=lambda check: check.state == "missing"):
        what_for = check.purpose
        if check.advice:
            what_for = check.advice
        rows.append({"part": check.part, "packages": check.found, "for": what_for})
    print_table("optional", rows)


def _summarize_extras(checks: Sequence[Check]) -> None:
    """Print the names of the optional packages that are installed, and of the others."""
    installed = [check.part for check in checks if check.state == "ok"]
    others = [check.part for check in checks if check.state != "ok"]
    for state, names in (("installed", installed), ("not installed", others)):
        if names:
            sys.stdout.write(wrapped(f"optional, {state}: {', '.join(names)}") + "\n")
    sys.stdout.write("what each is for, and how to install it: embodichain doctor --extras\n")


def _installed(packages: Sequence[str]) -> tuple[dict[str, str], list[str]]:
    """Versions of the packages that are installed, and the names of the others."""
    versions: dict[str, str] = {}
    for name in packages:
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return versions, [name for name in packages if name not in versions]


def _versions() -> Iterator[Check]:
    import embodichain

    yield Check("embodichain", "ok", embodichain.__version__)
    yield Check("Python", "ok", f"{platform.python_version()} on {platform.platform()}")
    if sys.platform not in {"linux"}:
        about = "untried: everything is developed and tested on Linux"
        yield Check("system", "warn", about, "docs/install.md names what is missing here")
    for limit in platforms.limits():
        yield Check(limit.feature, "missing", limit.reason, limit.instead)
    versions, missing = _installed(_CORE)
    yield from (Check(name, "ok", version) for name, version in versions.items())
    yield from (Check(name, "fail", "not installed", f"pip install {name}") for name in missing)


def _threads() -> Iterator[Check]:
    present = os.cpu_count()
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else present
    yield Check("threads", "ok", f"{usable} of {present} cores; sim.num_threads=0 uses them all")
    limit = os.environ.get("OMP_NUM_THREADS")
    if limit:
        yield Check("OMP_NUM_THREADS", "ok", f"{limit} (torch's threads; not the engine's)")


def _rendering() -> Iterator[Check]:
    """Render a small picture, in a separate process that a broken driver may crash."""
    command = [sys.executable, "-c", _RENDER]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    except subprocess.TimeoutExpired:
        yield Check("rendering", "warn", "no picture within 60 s", _NO_PICTURE)
        return
    if done.returncode == 0:
        yield Check("rendering", "ok", done.stdout.strip())
    else:
        lines = done.stderr.strip().splitlines() or [f"exit code {done.returncode}"]
        yield Check("rendering", "warn", lines[-1], _NO_PICTURE)


def render_once() -> None:
    """Render one small picture and print which renderer made it; raise if rendering fails."""
    import mujoco

    from embodichain.lab.sim.drawing.offscreen import OffscreenRenderer
    from embodichain.lab.sim.drawing.states import DataState
    from embodichain.lab.sim.drawing.views import Viewpoint

    model = mujoco.MjModel.from_xml_string(_BALL)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    renderer = OffscreenRenderer(model)
    if "color" not in renderer.outputs:
        raise RuntimeError("no OpenGL: depth and masks are drawn with rays, colours are not")
    viewpoint = Viewpoint.look_at((0.4, -0.4, 0.4), (0.0, 0.0, 0.0))
    picture = renderer.pictures(DataState(data), viewpoint, (64, 48))
    if picture.max() == picture.min():
        raise RuntimeError(f"the {renderer.kind} renderer draws an empty picture")
    sys.stdout.write(f"{renderer.kind} renderer: {renderer.about}")


def _display() -> Iterator[Check]:
    display = os.environ.get("WAYLAND_DISPLAY") or os.environ.get("DISPLAY")
    if display:
        yield Check("display", "ok", f"{display}: viewer=native opens a window")
    else:
        yield Check("display", "missing", "none: viewer=native warns and runs without a window")


def _disk() -> Iterator[Check]:
    folder = Path("outputs").resolve()
    existing = next(path for path in (folder, *folder.parents) if path.exists())
    free_gb = shutil.disk_usage(existing).free / 1e9
    space = f"{free_gb:.1f} GB free for {folder}"
    if free_gb > _LOW_DISK_GB:
        yield Check("disk", "ok", space)
    else:
        advice = "logs of many environments are large: record=none, or room"
        yield Check("disk", "warn", space, advice)
    if not os.access(existing, os.W_OK):
        yield Check("outputs", "warn", f"{existing} cannot be written", "run elsewhere")


def _extras() -> Iterator[Check]:
    users = _users_of_packages()
    for extra, (purpose, *packages) in EXTRAS.items():
        requirement = f"embodichain[{extra}]"
        about = ", ".join([purpose, *users.pop(requirement, [])])
        yield _check_packages(extra, packages, about, requirement)
    for requirement, things in users.items():  # of what packages outside register
        name = re.split(r"[^\w.-]", requirement)[0]
        yield _check_packages(name, [name], ", ".join(things), requirement)
    for package, purpose in OTHERS.items():
        yield _check_packages(package, [package], purpose, package)


def _users_of_packages() -> dict[str, list[str]]:
    """What pip installs -> how configs and options name the registered things that need it."""
    from embodichain.config.keys.launchers import LAUNCHERS
    from embodichain.config.keys.learners import LEARNERS
    from embodichain.lab.sim.drawing.renderer_register import RENDERERS
    from embodichain.lab.sim.engine.engine_register import ENGINES
    from embodichain.recording.export.format_register import EPISODE_FORMATS, FORMATS

    registers: dict[str, list[Register[Any]]] = {
        "sim.engine=": [ENGINES],
        "EMBODICHAIN_RENDERER=": [RENDERERS],
        "algo=": [LEARNERS],
        "hydra/launcher=": [LAUNCHERS],
    }
    try:
        process.check_mujoco_gl()
    except ConfigError:  # reported above; formats import MuJoCo
        pass
    else:
        registers["--format "] = [FORMATS, EPISODE_FORMATS]
    users: dict[str, list[str]] = {}
    for key, group in registers.items():
        for register in group:
            for name, thing in register.items():
                things = users.setdefault(thing.requires, [])
                if f"{key}{name}" not in things:
                    things.append(f"{key}{name}")
    users.pop("", None)
    return users


def _check_packages(name: str, packages: Sequence[str], purpose: str, requirement: str) -> Check:
    """Check that optional packages are installed.

    Args:
        name: Name of the check.
        packages: The packages.
        purpose: What they are for.
        requirement: What pip installs if one is missing.
    """
    versions, missing = _installed(packages)
    installed = ", ".join(f"{package} {version}" for package, version in versions.items())
    if not missing:
        return Check(name, "ok", installed, purpose=purpose)
    result = f"not installed: {', '.join(missing)}"
    if installed:
        result += f" (there: {installed})"
    advice = f"{purpose}: pip install {_quote(requirement)}"
    return Check(name, "missing", result, advice, purpose)


def _quote(requirement: str) -> str:
    """A requirement for a shell; in quotes where one could read more into it."""
    if re.fullmatch(r"[\w.-]+", requirement):
        return requirement
    return f"'{requirement}'"


def _cuda() -> Check:
    from embodichain.lab.sim.engine.warp.warp_support import cuda_devices, why_missing

    reason = why_missing("cuda")
    if reason:
        return Check("CUDA", "missing", reason, "device=cuda needs both: see docs/gpu.md")
    return Check("CUDA", "ok", ", ".join(cuda_devices()))


def _randomness() -> Iterator[Check]:
    """Classes and terms that draw from a global generator, so that results depend on num_envs."""
    try:
        process.check_mujoco_gl()
    except ConfigError as error:  # then tasks cannot be imported
        yield Check("MUJOCO_GL", "fail", error.problems[0].message, "unset MUJOCO_GL")
        return
    from embodichain.cli.results.global_random import global_draws, registered_code

    advice = "use env.rand or env.randn: the same numbers whatever num_envs is"
    has_draws = False
    for name, code in registered_code():
        for draw in global_draws(code):
            has_draws = True
            yield Check(name, "warn", f"draws from a global generator: {draw}", advice)
    if not has_draws:
        yield Check("random numbers", "ok", "no registered class or term uses a global generator")
