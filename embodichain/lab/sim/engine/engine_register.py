"""The register of engines, which `sim.engine` names: `ENGINES`, `engine`.

An engine is a function that starts one for a scene, registered where it is defined; what it returns
is an `api.Engine`. Configs are checked without starting one, so that the module should import
neither MuJoCo nor torch; the function may::

    @engine("counting", is_exact=True)
    def start_counting(setup: EngineSetup) -> Counting:
        return Counting(ENGINES["mujoco"].start(setup))

A package outside names its module with an entry point of the group ``embodichain.engines``, called
as the engine.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, Protocol, TypeVar

from embodichain.utils.errors import Problem
from embodichain.utils.register import Register

if TYPE_CHECKING:
    import mujoco

    from embodichain.lab.sim.engine.api import Engine

__all__ = [
    "ENGINES",
    "EngineKind",
    "EngineSetup",
    "StartEngine",
    "engine",
    "find_recorded",
    "recorded_name",
    "split_recorded",
]

Device = Literal["cpu", "cuda"]
_KINDS = "embodichain.lab.sim.engine.kinds"
_OF = " of "
"""Between an engine and the package that it is from, in a log."""


@dataclass(frozen=True)
class EngineSetup:
    """What an engine is started for.

    Attributes:
        model: The compiled scene; the engine copies what it changes.
        num_envs: N.
        device: ``cpu``, ``cuda`` or ``cuda:N``, one of the engine's `devices`.
        num_threads: Physics threads; 0 is every core that the process may use.
        persistent: Whether each environment has an MjData of its own; None is the engine's choice.
        arrays_on_device: Whether arrays are on the device, in float32; only for ``warp``.
        nconmax: `sim.warp.nconmax`; only for ``warp``, as the next.
        njmax: `sim.warp.njmax`.
    """

    model: mujoco.MjModel
    num_envs: int
    device: str = "cpu"
    num_threads: int = 0
    persistent: bool | None = None
    arrays_on_device: bool = False
    nconmax: int | None = None
    njmax: int | None = None


class StartEngine(Protocol):
    """Starts an engine."""

    def __call__(self, setup: EngineSetup) -> Engine:
        """Return an engine of N simulations in the model's reset state.

        Raises:
            ConfigError: If it cannot compute the scene, or there is no memory for it.
        """


def _nothing_missing(device: str) -> str:
    """An engine that needs nothing but its package."""
    return ""


def _all_supported(model: mujoco.MjModel) -> list[Problem]:
    """An engine that computes whatever MuJoCo compiles."""
    return []


@dataclass(frozen=True)
class EngineKind:
    """An engine, as `sim.engine` names it.

    Attributes:
        start: Starts it.
        log_names: Regular expression of the names (`Engine.name`) that it has in logs.
        devices: Where it can run; the first is what a message proposes.
        is_exact: Whether `mujoco.batch` computes the same results to the bit. Then logs are
            verified to the bit and may have keyframes instead of all states; else results of
            physics are compared within a tolerance.
        requires: What pip installs for the packages that it needs.
        why_missing: Returns why it cannot run on a device here, and what helps; empty if it can.
        unsupported: Returns everything in a compiled scene that it cannot compute, with paths of
            the root config.
    """

    start: StartEngine
    log_names: str
    devices: tuple[Device, ...] = ("cpu",)
    is_exact: bool = False
    requires: str = ""
    why_missing: Callable[[str], str] = _nothing_missing
    unsupported: Callable[[mujoco.MjModel], list[Problem]] = _all_supported


Start = TypeVar("Start", bound=StartEngine)

ENGINES: Register[EngineKind] = Register(
    "engine",
    group="embodichain.engines",
    modules=(f"{_KINDS}.mujoco", f"{_KINDS}.warp"),
)
"""``sim.engine`` -> the engine; modules and entry points are called as the engines."""


def engine(
    name: str,
    *,
    devices: Sequence[Device] = ("cpu",),
    is_exact: bool = False,
    log_names: str = "",
    requires: str = "",
    why_missing: Callable[[str], str] = _nothing_missing,
    unsupported: Callable[[mujoco.MjModel], list[Problem]] = _all_supported,
) -> Callable[[Start], Start]:
    """Register a function ``start(setup)`` as an engine; other arguments as of `EngineKind`.

    Args:
        name: What `sim.engine` takes; also the name of its module and its entry point.
        devices: Where it can run.
        is_exact: Whether `mujoco.batch` computes the same results to the bit.
        log_names: Regular expression of the names that it has in logs; empty is `name`, alone or
            before its version: ``counting 1.0``.
        requires: What pip installs for the packages that it needs.
        why_missing: Returns why it cannot run on a device here; empty if it can.
        unsupported: Returns what it cannot compute of a compiled scene.

    Returns:
        A decorator that returns its argument.

    Raises:
        ValueError: If another function has the name.
    """

    def decorate(start: Start) -> Start:
        kind = EngineKind(
            start=start,
            log_names=log_names or rf"{re.escape(name)}( [\w.+-]+)?",
            devices=tuple(devices),
            is_exact=is_exact,
            requires=requires,
            why_missing=why_missing,
            unsupported=unsupported,
        )
        ENGINES.add(name, describes=start)(kind)
        return start

    return decorate


def recorded_name(engine: Engine) -> str:
    """Return what a log says of the engine that computed it.

    It is the engine's name, and for an engine of another package that package:
    ``counting 1.0 of my-package``.
    """
    package = ""
    for name, kind in ENGINES.items():
        if re.fullmatch(kind.log_names, engine.name):
            package = ENGINES.package(name)
            break
    return f"{engine.name}{_OF}{package}" if package else engine.name


def split_recorded(recorded: str) -> tuple[str, str]:
    """Return the name of a log's engine, and the package that it is from or an empty text."""
    name, _, package = recorded.partition(_OF)
    return name, package


def find_recorded(recorded: str) -> EngineKind | None:
    """Return the engine that a log names, or None if it is not registered here."""
    name, package = split_recorded(recorded)
    for registered, kind in ENGINES.items():
        if re.fullmatch(kind.log_names, name) and ENGINES.package(registered) == package:
            return kind
    return None
