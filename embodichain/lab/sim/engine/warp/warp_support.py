"""What MuJoCo Warp needs on this machine (`why_missing`), and lacks of a model (`unsupported`).

Nothing is imported from Warp before a function is called.
"""

from __future__ import annotations

import ctypes
import re
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import lazy_loader

from embodichain.utils.errors import Problem
from embodichain.utils.suggest import listing

if TYPE_CHECKING:
    import mujoco
else:
    mujoco = lazy_loader.load("mujoco")

__all__ = ["cuda_devices", "start_warp", "unsupported", "why_missing"]

_INSTALL = "pip install 'embodichain[gpu]'"
_PLAIN = "use sim.engine=mujoco"
_DRIVERS = {"linux": ("libcuda.so", "libcuda.so.1"), "win32": ("nvcuda.dll",)}
"""Platform -> names of the library of NVIDIA's driver."""


def start_warp() -> Any:
    """Import Warp without its banner and its line for each loaded kernel; returns the module."""
    import warp

    # A level set by the user is kept.
    if warp.config.log_level == warp.LOG_INFO:
        warp.config.log_level = warp.LOG_ERROR
    warp.init()
    return warp


def why_missing(device: str) -> str:
    """Why MuJoCo Warp cannot run on a device here, and what helps; empty if it can.

    Args:
        device: ``cpu``, ``cuda`` or ``cuda:N``.
    """
    lacking = [name for name in ("warp", "mujoco_warp") if find_spec(name) is None]
    if lacking:
        return f"MuJoCo Warp is not installed ({', '.join(lacking)}): {_INSTALL}"
    number = re.fullmatch(r"cuda(?::(\d+))?", device)
    if number is None:
        return ""
    devices = cuda_devices()
    if not devices:
        return "there is no CUDA device here (sim.engine=warp device=cpu runs, slowly, without)"
    if int(number[1] or 0) >= len(devices):
        return f"there is no such CUDA device here; there are: {', '.join(devices)}"
    return ""


def cuda_devices() -> list[str]:
    """The CUDA devices that Warp finds: ``cuda:0 NVIDIA ...``. Warp must be installed.

    Without a driver Warp is not started: it would write a warning to stderr, which none of its
    options turns off.
    """
    if not _has_cuda_driver():
        return []
    return [f"{device.alias} {device.name}" for device in start_warp().get_cuda_devices()]


def _has_cuda_driver() -> bool:
    """Whether the library of NVIDIA's driver can be loaded, by the names that Warp tries."""
    for name in _DRIVERS.get(sys.platform, ()):
        try:
            ctypes.CDLL(name)
        except OSError:
            continue
        return True
    return False


def unsupported(model: mujoco.MjModel) -> list[Problem]:
    """Everything in a model that MuJoCo Warp cannot compute, or that it could not continue from.

    Args:
        model: The compiled scene.

    Returns:
        A problem for each, with what to change; paths are of the root config.
    """
    from mujoco_warp import (
        BiasType,
        ConeType,
        DisableBit,
        DynType,
        EnableBit,
        GainType,
        IntegratorType,
        SolverType,
        TrnType,
    )
    from mujoco_warp._src.types import EqType, GeomType, SensorType, WrapType

    of_elements = (
        ("actuator", "trntype", TrnType, "mjtTrn"),
        ("actuator", "dyntype", DynType, "mjtDyn"),
        ("actuator", "gaintype", GainType, "mjtGain"),
        ("actuator", "biastype", BiasType, "mjtBias"),
        ("eq", "type", EqType, "mjtEq"),
        ("geom", "type", GeomType, "mjtGeom"),
        ("sensor", "type", SensorType, "mjtSensor"),
        ("wrap", "type", WrapType, "mjtWrap"),
    )
    problems = []
    for element, kind, known, enum in of_elements:
        allowed = {int(value) for value in known}
        values = getattr(model, f"{element}_{kind}")
        for i, value in enumerate(values.tolist()):
            if value not in allowed:
                name = _name(model, element, i)
                message = f"MuJoCo Warp has no {_word(enum, value)} ({element} {name}): {_PLAIN}"
                problems.append(Problem("sim.engine", message))
    option = model.opt
    for key, known, enum in (
        ("solver", SolverType, "mjtSolver"),
        ("integrator", IntegratorType, "mjtIntegrator"),
        ("cone", ConeType, "mjtCone"),
    ):
        value = int(getattr(option, key))
        if value not in {int(found) for found in known}:
            words = [found.name.lower() for found in known]
            message = f"MuJoCo Warp has no {_word(enum, value)}; it has {listing(words, '')}"
            problems.append(Problem(f"task.physics.{key}", message))
    for flags, known, enum in (
        (option.disableflags & ~_AUTORESET, DisableBit, "mjtDisableBit"),
        (option.enableflags, EnableBit, "mjtEnableBit"),
    ):
        for bit in _bits(int(flags) & ~sum(int(found) for found in known)):
            message = f"MuJoCo Warp has no flag {_word(enum, bit)}, which a file sets: {_PLAIN}"
            problems.append(Problem("sim.engine", message))
    problems += [Problem("sim.engine", f"{reason}: {_PLAIN}") for reason in _left_out(model)]
    return problems


_AUTORESET = 1 << 16
"""`mjDSBL_AUTORESET`: scenes always set it, and Warp never resets."""
_DENSE_NV = 60


def _left_out(model: mujoco.MjModel) -> Iterator[str]:
    """What the enumerations of elements do not show."""
    if model.opt.enableflags & int(mujoco.mjtEnableBit.mjENBL_SLEEP):
        yield "bodies that sleep are not continued from a recorded state"
    if model.nplugin:
        yield "MuJoCo Warp has no plugins"
    if model.nflex:
        yield "deformable bodies (flex) were not tried on MuJoCo Warp"
    if model.opt.noslip_iterations and model.opt.integrator == int(
        mujoco.mjtIntegrator.mjINT_DISCRETE
    ):
        yield "MuJoCo Warp has no noslip solver for the discrete integrator"
    if model.opt.jacobian == mujoco.mjtJacobian.mjJAC_DENSE and model.nv > _DENSE_NV:
        yield f"MuJoCo Warp has dense Jacobians for {_DENSE_NV} degrees of freedom at most"


def _bits(flags: int) -> Iterator[int]:
    while flags:
        lowest = flags & -flags
        yield lowest
        flags &= ~lowest


def _word(enum: str, value: int) -> str:
    """MuJoCo's name of a value: ``mjDYN_PID``."""
    names: dict[str, Any] = getattr(mujoco, enum).__members__
    return next((name for name, found in names.items() if int(found) == value), f"{enum} {value}")


def _name(model: mujoco.MjModel, element: str, i: int) -> str:
    kinds = {"eq": "equality"}
    if element == "wrap":
        return f"number {i}"
    return repr(getattr(model, kinds.get(element, element))(i).name or i)
