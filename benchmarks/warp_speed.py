"""`step_speed --device cuda`: environments on MuJoCo Warp beside their own bare physics.

Bare physics are the same number of worlds of the task's compiled model, whose physics steps of one
control step are captured as one graph and replayed. Both take turns in one process.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

from benchmarks import arms
from benchmarks.arms import Arm
from benchmarks.machine import table
from benchmarks.rounds import Result, measure
from embodichain.lab.sim.engine.warp.warp_support import start_warp, why_missing

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv

SIZES = (4096,)
TASKS = ("cart_pole", "reach", "push_cube", "quadruped_velocity")


def measured(
    device: str,
    tasks: Sequence[str],
    sizes: Sequence[int],
    overrides: Sequence[str],
    rounds: int,
    seconds: float,
    episode: int,
    log: bool = False,
) -> dict[str, Any]:
    """Measure every task and size, one after the other.

    Args:
        device: ``cuda``, ``cuda:N`` or, to try it, ``cpu``.
        tasks: Options of the group `task`.
        sizes: Numbers of environments.
        overrides: Further lines of the environments' config.
        rounds: How often each arm has its turn.
        seconds: About how long a turn is.
        episode: Control steps that a turn is a multiple of.
        log: Whether to measure environments with a log, too.

    Raises:
        SystemExit: If there is no such device.
    """
    reason = why_missing(device)
    if reason:
        raise SystemExit(f"--device {device}: {reason}")
    results = []
    for task in tasks:
        for size in sizes:
            with ExitStack() as stack:
                lines = ["sim.engine=warp", f"device={device}", *overrides]
                env = arms.make(task, size, *lines, seed=arms.SEED)
                built = [arms.environment(env, task, _floor(task), _wait), bare(task, env)]
                stack.callback(env.close)
                if log:
                    logged = arms.make(task, size, *lines, seed=arms.SEED)
                    temporary = tempfile.TemporaryDirectory(prefix="warp_speed-")
                    folder = Path(stack.enter_context(temporary))
                    stack.callback(logged.close)
                    name = f"{task} + MCAP"
                    built.append(arms.recorded(logged, name, _floor(task), folder))
                results += [r.facts() for r in measure(built, rounds, seconds, episode)]
    return {"device": start_warp().get_device(device).name, "results": results}


def bare(task: str, env: BaseEnv) -> Arm:
    """Captured physics of an environment's model; a turn begins with the environment's states."""
    import warp

    from embodichain.lab.sim.engine.warp.warp_worlds import WarpWorlds

    engine, nstep = env.sim.engine, env.sim_steps_per_control
    device = str(env.sim.sim_config.sim_device)
    sizes = engine.worlds.nconmax, engine.worlds.njmax
    worlds = WarpWorlds(engine.model, env.num_envs, device, *sizes)
    worlds.upload(_rows(engine))
    worlds.step(nstep)  # compiles the kernels
    with warp.ScopedCapture(device=device) as capture:
        worlds.step(nstep)
    return Arm(
        _floor(task),
        env.num_envs,
        _floor(task),
        lambda step: warp.capture_launch(capture.graph),
        lambda: worlds.upload(_rows(engine)),
        _wait,
    )


def _rows(engine: Any) -> Any:
    """States of all environments on the host, (N, nstate)."""
    return engine.host_rows() if hasattr(engine, "host_rows") else engine.rows


def _floor(task: str) -> str:
    return f"{task}, bare"


def _wait() -> None:
    """Wait for all that was launched."""
    start_warp().synchronize()


def report(facts: dict[str, Any]) -> str:
    """A Markdown table: ratios to bare physics."""
    fields = Result.__dataclass_fields__
    results = [Result(**{name: found[name] for name in fields}) for found in facts["results"]]
    floors = {(r.name, r.num_envs): r for r in results if r.name == r.floor}
    rows = []
    for result in results:
        if result.name == result.floor:
            continue
        ratios = f"[{min(result.ratios):.3f} to {max(result.ratios):.3f}]"
        rows.append(
            [
                result.name,
                result.num_envs,
                _speed(floors[result.floor, result.num_envs]),
                _speed(result),
                f"**{result.ratio:.3f}** {ratios}",
            ]
        )
    heads = ["task", "N", "bare physics", "environment", "**ratio** [lowest to highest]"]
    return f"{facts['device']}. Million control steps/s of all environments (ms each):\n\n" + table(
        heads, rows
    )


def _speed(result: Result) -> str:
    ms = result.num_envs * 1e3 / median(result.speeds)
    return f"{result.speed / 1e6:.4f} ({ms:.3f})"
