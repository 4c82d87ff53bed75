"""Physics options: those of the scene, and those of files, which the scene's replace."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from embodichain.lab.sim.cfg import SimulationManagerCfg
from embodichain.lab.sim.configs.physics_cfg import FlagsCfg, OptionsCfg, PhysicsCfg
from embodichain.utils.errors import ConfigError, Problem

__all__ = ["apply_options", "check_options", "replace_options"]

_INTEGRATORS = {
    "implicitfast": mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
    "implicit": mujoco.mjtIntegrator.mjINT_IMPLICIT,
    "Euler": mujoco.mjtIntegrator.mjINT_EULER,
    "RK4": mujoco.mjtIntegrator.mjINT_RK4,
}
_SOLVERS = {
    "Newton": mujoco.mjtSolver.mjSOL_NEWTON,
    "CG": mujoco.mjtSolver.mjSOL_CG,
    "PGS": mujoco.mjtSolver.mjSOL_PGS,
}
_CONES = {
    "pyramidal": mujoco.mjtCone.mjCONE_PYRAMIDAL,
    "elliptic": mujoco.mjtCone.mjCONE_ELLIPTIC,
}
_JACOBIANS = {
    "dense": mujoco.mjtJacobian.mjJAC_DENSE,
    "sparse": mujoco.mjtJacobian.mjJAC_SPARSE,
    "auto": mujoco.mjtJacobian.mjJAC_AUTO,
}
_ENUMS: dict[str, type[Any]] = {
    "integrator": mujoco.mjtIntegrator,
    "solver": mujoco.mjtSolver,
    "cone": mujoco.mjtCone,
    "jacobian": mujoco.mjtJacobian,
}
_FLAGS: dict[str, type[Any]] = {
    "disableflags": mujoco.mjtDisableBit,
    "enableflags": mujoco.mjtEnableBit,
}
_NEEDED = {
    "sleep_tolerance": "sleep",
    "o_margin": "override",
    "o_solref": "override",
    "o_solimp": "override",
    "o_friction": "override",
}
"""Options that act only with a flag -> the flag."""


# ------------------------------------------------------------------------------------ of the scene


def apply_options(spec: mujoco.MjSpec, cfg: SimulationManagerCfg) -> None:
    """Set a scene's physics options.

    Auto-reset is off: it would reset a diverged simulation to qpos0 within a step.

    Raises:
        ConfigError: If a value is wrong, or has no effect; paths begin with ``physics``.
    """
    if not cfg.physics_dt > 0:
        raise ConfigError([Problem("physics_dt", f"must be positive, got {cfg.physics_dt}")])
    physics = cfg.physics_config
    option = spec.option
    problems = check_options(physics)
    if problems:
        raise ConfigError(p.below("physics") for p in problems)
    option.timestep = float(cfg.physics_dt)
    option.gravity = [float(g) for g in physics.gravity]
    option.integrator = int(_INTEGRATORS[physics.integrator])
    option.solver = int(_SOLVERS[physics.solver])
    option.iterations = int(physics.iterations)
    option.cone = int(_CONES[physics.cone])
    option.impratio = float(physics.impratio)
    for name, value in _options(physics).items():
        if name == "flags":
            _apply_flags(option, value)
        elif name == "jacobian":
            option.jacobian = int(_JACOBIANS[value])
        else:
            _set(option, name, value)
    option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)


def _options(physics: OptionsCfg) -> dict[str, Any]:
    """The options of `OptionsCfg` that are not None."""
    names = [field.name for field in dataclasses.fields(OptionsCfg)]
    values = {name: getattr(physics, name) for name in names}
    return {name: value for name, value in values.items() if value is not None}


def _set(option: Any, name: str, value: Any) -> None:
    """Set a number; of a list that is shorter than the option, the rest stays."""
    current = getattr(option, name)
    if isinstance(current, np.ndarray):
        current[: len(value)] = value
    else:
        setattr(option, name, type(current)(value))


@dataclass(frozen=True)
class _Flag:
    """One flag of MuJoCo.

    Attributes:
        field: The option that has its bit: ``disableflags`` or ``enableflags``.
        name: Its name in MJCF.
        bit: Its bit.
    """

    field: str
    name: str
    bit: int


def _apply_flags(option: Any, cfg: FlagsCfg) -> None:
    for flag in _all_flags():
        setting = getattr(cfg, flag.name, None)
        if setting is None:
            continue
        bits = int(getattr(option, flag.field))
        # A bit of `disableflags` is set to switch its flag off.
        if (setting == "enable") == (flag.field == "enableflags"):
            bits |= flag.bit
        else:
            bits &= ~flag.bit
        setattr(option, flag.field, bits)


def _all_flags() -> list[_Flag]:
    """Return every flag of MuJoCo."""
    flags: list[_Flag] = []
    for field, enum in _FLAGS.items():
        for member, value in enum.__members__.items():
            is_count = member.startswith("mjN")  # mjNDISABLE is the number of flags
            if int(value).bit_count() == 1 and not is_count:
                flags.append(_Flag(field, member.split("_")[-1].lower(), int(value)))
    return flags


def check_options(physics: PhysicsCfg) -> list[Problem]:
    """Return every option that has no effect without another, with paths below ``physics``."""
    problems: list[Problem] = []
    options = _options(physics)
    flags = physics.flags or FlagsCfg()
    for name, flag in _NEEDED.items():
        if name in options and getattr(flags, flag) != "enable":
            message = f"has no effect without flags: {{{flag}: enable}}"
            problems.append(Problem(name, message))
    if "noslip_tolerance" in options and not options.get("noslip_iterations"):
        message = "has no effect without noslip_iterations"
        problems.append(Problem("noslip_tolerance", message))
    return problems


# --------------------------------------------------------------------------------------- of a file


def replace_options(
    child: mujoco.MjSpec, scene: mujoco.MjSpec, file: str, given: Collection[str]
) -> list[str]:
    """Replace a file's options by the scene's.

    Args:
        child: The file; its options become the scene's.
        scene: The scene.
        file: What the file is called in messages.
        given: Names of the options that the file gives, and ``flag.NAME`` of its flags.

    Returns:
        A message with ``name: value in the file -> value of the scene`` for each option that the
        file gives and that differs from the scene's; none if there is none.
    """
    default = mujoco.MjSpec().option
    replaced: list[str] = []
    for name in dir(default):
        if name.startswith("_"):
            continue
        old = getattr(child.option, name)
        new = getattr(scene.option, name)
        if name in _FLAGS:
            replaced += _replaced_flags(name, int(old), int(new), given)
        elif not np.array_equal(old, new):
            # A value that differs from MuJoCo's default was given, even if `given` lacks it.
            is_default = np.array_equal(old, getattr(default, name))
            if name in given or not is_default:
                replaced.append(f"{name} {_show(name, old)} -> {_show(name, new)}")
        setattr(child.option, name, new)
    if not replaced:
        return []
    return [f"{file}: the scene's physics replaces its options: {'; '.join(replaced)}"]


def _replaced_flags(field: str, old: int, new: int, given: Collection[str]) -> list[str]:
    """Return flags that a file sets and the scene does not, and those it gives and loses."""
    switched_off: list[str] = []
    switched_on: list[str] = []
    for flag in _all_flags():
        if flag.field != field:
            continue
        if old & ~new & flag.bit:
            switched_off.append(flag.name)
        if new & ~old & flag.bit and f"flag.{flag.name}" in given:
            switched_on.append(flag.name)
    messages: list[str] = []
    if switched_off:
        messages.append(f"{field} {', '.join(switched_off)} -> off")
    if switched_on:
        messages.append(f"{field} {', '.join(switched_on)} -> on")
    return messages


def _show(name: str, value: Any) -> str:
    if name in _ENUMS:
        return str(_ENUMS[name](int(value)).name.split("_")[-1].lower())
    array = np.asarray(value, np.float64).reshape(-1)
    return " ".join(f"{x:g}" for x in array)
