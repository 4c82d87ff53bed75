"""Physics options of the scene, and which options of a robot's file they replace.

On attach MuJoCo keeps the parent's options and says so for some of them only; here every option and
flag is compared, and the child's are set to the scene's before attaching.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from embodichain.lab.sim.cfg import SimulationManagerCfg
from embodichain.utils.errors import ConfigError, Problem

__all__ = ["apply_options", "replace_options"]

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


def apply_options(spec: mujoco.MjSpec, cfg: SimulationManagerCfg) -> None:
    """Set a scene's physics options.

    Auto-reset is off: it would put a diverged simulation back to qpos0 in the middle of a step.

    Raises:
        ConfigError: If the timestep is not positive.
    """
    if not cfg.physics_dt > 0:
        raise ConfigError([Problem("physics_dt", f"must be positive, got {cfg.physics_dt}")])
    physics, option = cfg.physics_config, spec.option
    option.timestep = float(cfg.physics_dt)
    option.gravity = [float(g) for g in physics.gravity]
    option.integrator = int(_INTEGRATORS[physics.integrator])
    option.solver = int(_SOLVERS[physics.solver])
    option.iterations = int(physics.iterations)
    option.cone = int(_CONES[physics.cone])
    option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)


def replace_options(child: mujoco.MjSpec, scene: mujoco.MjSpec) -> list[str]:
    """Give a child the scene's options.

    Returns:
        ``name: value in the file -> value of the scene`` for each option that the file sets to
        something other than MuJoCo's default and the scene does not share.
    """
    default = mujoco.MjSpec().option
    replaced: list[str] = []
    for name in _names(default):
        old, new = getattr(child.option, name), getattr(scene.option, name)
        if name in _FLAGS:
            theirs = int(old) & ~int(new)
            if theirs:
                replaced.append(f"{name} {_flags(name, theirs)} -> off")
        elif not np.array_equal(old, new) and not np.array_equal(old, getattr(default, name)):
            replaced.append(f"{name} {_show(name, old)} -> {_show(name, new)}")
        setattr(child.option, name, new)
    return replaced


def _names(option: Any) -> list[str]:
    return [name for name in dir(option) if not name.startswith("_")]


def _show(name: str, value: Any) -> str:
    if name in _ENUMS:
        return str(_ENUMS[name](int(value)).name.split("_")[-1].lower())
    array = np.asarray(value, np.float64).reshape(-1)
    return " ".join(f"{x:g}" for x in array)


def _flags(name: str, bits: int) -> str:
    known = [flag for flag in _FLAGS[name].__members__.values() if int(flag) & bits]
    names = [flag.name.split("_")[-1].lower() for flag in known if _one_bit(int(flag))]
    return ", ".join(names) or hex(bits)


def _one_bit(value: int) -> bool:
    return value > 0 and value & (value - 1) == 0
