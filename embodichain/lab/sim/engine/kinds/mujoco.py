"""`mujoco.batch` on the cores of the CPU; logs of it are verified to the bit."""

from __future__ import annotations

from typing import TYPE_CHECKING

from embodichain.lab.sim.engine.engine_register import EngineSetup, engine

if TYPE_CHECKING:
    from embodichain.lab.sim.engine.cpu.cpu_engine import CpuEngine

__all__ = ["start_mujoco"]


@engine("mujoco", log_names="mujoco", is_exact=True)
def start_mujoco(setup: EngineSetup) -> CpuEngine:
    """Start a `CpuEngine`, if there is memory for it."""
    from embodichain.lab.sim.engine.cpu.cpu_engine import CpuEngine
    from embodichain.lab.sim.engine.room import bytes_of
    from embodichain.utils.system.memory import require_memory_for

    env_bytes = bytes_of(setup.model, setup.persistent)
    require_memory_for(setup.num_envs, env_bytes, "environments of this scene", "num_envs")
    return CpuEngine(
        setup.model,
        setup.num_envs,
        num_threads=setup.num_threads,
        persistent=setup.persistent,
    )
