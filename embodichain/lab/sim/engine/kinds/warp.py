"""MuJoCo Warp on a GPU, or slowly on the CPU."""

from __future__ import annotations

from typing import TYPE_CHECKING

from embodichain.lab.sim.engine.engine_register import EngineSetup, engine
from embodichain.lab.sim.engine.warp.warp_support import unsupported, why_missing

if TYPE_CHECKING:
    from embodichain.lab.sim.engine.warp.device_engine import DeviceEngine
    from embodichain.lab.sim.engine.warp.warp_engine import WarpEngine

__all__ = ["start_warp_engine"]


@engine(
    "warp",
    devices=("cuda", "cpu"),
    log_names=r"mujoco_warp \d[\w.+-]*",
    requires="embodichain[gpu]",
    why_missing=why_missing,
    unsupported=unsupported,
)
def start_warp_engine(setup: EngineSetup) -> WarpEngine | DeviceEngine:
    """Start a `DeviceEngine` for arrays on the device, else a `WarpEngine`."""
    from embodichain.lab.sim.engine.warp.device_engine import DeviceEngine
    from embodichain.lab.sim.engine.warp.warp_engine import WarpEngine

    kind = DeviceEngine if setup.arrays_on_device else WarpEngine
    return kind(
        setup.model,
        setup.num_envs,
        num_threads=setup.num_threads,
        device=setup.device,
        nconmax=setup.nconmax,
        njmax=setup.njmax,
    )
