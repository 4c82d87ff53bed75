"""What pictures cost: `python -m benchmarks.render`.

Counted is the CPU time of the process, all threads, beside a bare loop of `mujoco.Renderer` over
the same states in the same process, in turns; its shadows, reflections and multisampling are off.
Both have their kinematics already; what those cost is among the parts.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Callable
from itertools import cycle
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from benchmarks.machine import table, write_json

if TYPE_CHECKING:
    from embodichain.lab.sim.drawing.views import View
    from embodichain.lab.sim.engine.cpu.cpu_engine import CpuEngine

TASKS = ("reach", "push_cube", "lift_cube", "quadruped_velocity")
NUM_ENVS, PIXELS = (1, 16, 64), (64, 128)
OUTPUTS = (("color",), ("color", "depth", "mask"))
FILM, FILM_ENVS = (640, 480), (1, 8)
ROUNDS, STEPS, SECONDS = 7, 10, 0.15
PARTS = ("kinematics", "upload", "draw", "read", "convert")
OFF = (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION)


def main() -> None:
    """Measure every task in a process of its own, and print tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tasks", nargs="+", default=list(TASKS))
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--out", type=Path, help="JSON file for the figures")
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.child:
        print(json.dumps(measure(options.tasks[0], options.rounds)))
        return
    facts = {"tasks": {task: _apart(task, options.rounds) for task in options.tasks}}
    print(report(facts))
    if options.out:
        write_json(options.out, facts)


def measure(task: str, rounds: int) -> dict[str, Any]:
    """All figures of a task: ms of CPU a picture, and MiB."""
    from embodichain.lab.sim.drawing.layered.batch_renderer import BatchRenderer

    engines = {count: _engine(task, count) for count in NUM_ENVS}
    plain = _Plain(engines[16])
    before = _resident()
    marks = _Marks()
    renderer = BatchRenderer(engines[1].model, marks)
    found: dict[str, Any] = {"small": [], "film": []}
    for count, engine in engines.items():
        for pixels in PIXELS:
            for outputs in OUTPUTS:
                view = _view(engine, pixels, pixels, outputs, "fast")
                ours, mujocos = _in_turns(
                    rounds,
                    (lambda e=engine, v=view: renderer.draw(e, [v]), count),
                    (lambda p=pixels, o=outputs: plain.draw(p, p, o), len(plain.states)),
                )
                parts = marks.parts(renderer, engine, view) if len(outputs) == 1 else {}
                found["small"].append(
                    [count, pixels, len(outputs), median(ours), median(mujocos), parts]
                )
    found["memory"] = (_resident() - before) / 2**20
    view, moments = _view(engines[16], *FILM, ("color",), "full"), cycle(range(16))
    for count in FILM_ENVS:

        def film(count: int = count) -> None:
            rows = (np.arange(count) + next(moments)) % 16  # other ones each time, as in a film
            renderer.draw(engines[16], [view], rows)

        found["film"].append([count, median(_in_turns(rounds, (film, count))[0])])
    renderer.close()
    return found


def _engine(task: str, count: int) -> CpuEngine:
    """An engine whose environments have made a few random control steps of a task."""
    import torch

    from benchmarks import arms
    from embodichain.lab.sim.engine.cpu.cpu_engine import CpuEngine

    env = arms.make(task, count)
    env.reset(seed=0)
    low, high = (np.clip(x, -1, 1) for x in (env.action_space.low, env.action_space.high))
    draw = np.random.default_rng(0).uniform(low / 2, high / 2, (STEPS, *low.shape))
    for action in draw.astype(np.float32):
        env.step(torch.from_numpy(action))
    engine = CpuEngine(env.sim.engine.model, count)
    engine.rows[:] = env.sim.engine.rows
    engine.forward()
    env.close()
    return engine


def _view(engine: CpuEngine, width: int, height: int, outputs: Any, look: Any) -> View:
    from embodichain.lab.sim.drawing.views import view_of

    return view_of(engine, 0, width, height, outputs=outputs, look=look)


class _Plain:
    """A bare loop over states with `mujoco.Renderer`."""

    def __init__(self, engine: CpuEngine) -> None:
        from embodichain.lab.sim.drawing.gl import context_class

        mujoco.rendering.classic.gl_context.GLContext = context_class()
        model = engine.model
        model.vis.quality.offsamples = 0
        size = max(PIXELS)
        model.vis.global_.offwidth = model.vis.global_.offheight = size
        self.states = [engine.data_of(env) for env in range(8)]
        self._renderers = {pixels: mujoco.Renderer(model, pixels, pixels) for pixels in PIXELS}

    def draw(self, width: int, height: int, outputs: tuple[str, ...]) -> None:
        """Draw every state."""
        del height
        renderer = self._renderers[width]
        renderer._gl_context.make_current()  # ours has another
        for state in self.states:
            for output in outputs:
                if output == "depth":
                    renderer.enable_depth_rendering()
                elif output == "mask":
                    renderer.enable_segmentation_rendering()
                renderer.update_scene(state, camera=0)
                renderer.scene.flags[[int(flag) for flag in OFF]] = 0
                renderer.render()
                renderer.disable_depth_rendering()
                renderer.disable_segmentation_rendering()


class _Marks:
    """CPU time of the parts of a call."""

    def __init__(self) -> None:
        self._spent: dict[str, float] = {}
        self._last = 0.0
        self._on = False

    def __call__(self, name: str) -> None:
        if self._on:
            from OpenGL import GL

            GL.glFinish()
            now = time.process_time()
            self._spent[name] = self._spent.get(name, 0.0) + now - self._last
            self._last = now

    def parts(self, renderer: Any, engine: CpuEngine, view: View) -> dict[str, float]:
        """Ms a picture of each part."""
        self._spent, self._on, calls = {}, True, 0
        qpos = engine.state("qpos").copy()
        while sum(self._spent.values()) < SECONDS:
            engine.write("qpos", qpos)
            self._last = time.process_time()
            engine.derived("geom_xpos")
            self("kinematics")
            color = renderer.draw(engine, [view])[0]["color"]
            np.ascontiguousarray(color[..., :3].transpose(0, 3, 1, 2))
            self("convert")
            calls += 1
        self._on = False
        pictures = calls * engine.num_envs
        return {name: 1e3 * self._spent[name] / pictures for name in PARTS}


def _in_turns(rounds: int, *arms: tuple[Callable[[], object], int]) -> list[list[float]]:
    """Ms of CPU a picture in each round, of each arm: a function and how many pictures it makes."""
    found: list[list[float]] = [[] for _ in arms]
    for call, _ in arms:
        call()  # what is made once does not count
    for _ in range(rounds):
        for (call, pictures), values in zip(arms, found, strict=True):
            begun, calls = time.process_time(), 0
            while time.process_time() - begun < SECONDS:
                call()
                calls += 1
            values.append(1e3 * (time.process_time() - begun) / calls / pictures)
    return found


def _resident() -> int:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return 4096 * pages


def report(facts: dict[str, Any]) -> str:
    """Markdown tables: small pictures beside the bare loop, their parts, and frames of films."""
    rows, parts, films = [], [], []
    for task, one in facts["tasks"].items():
        for count, pixels, outputs, ours, mujocos, of_parts in one["small"]:
            size = f"{pixels} x {pixels}"
            what = "color" if outputs == 1 else "color, depth, mask"
            cells = [f"{ours:.2f}", f"{1e3 / ours:.0f}", f"{mujocos:.2f}"]
            rows.append([task, count, size, what, *cells, f"**{mujocos / ours:.1f}**"])
            if of_parts and count in (1, 64):
                shares = [f"{of_parts[name]:.3f}" for name in PARTS]
                parts.append([task, count, size, *shares])
        cells = [f"{ms:.0f}" for _, ms in one["film"]]
        films.append([task, *cells, f"{one['memory']:.0f}"])
    heads = [
        "task",
        "N",
        "size",
        "outputs",
        "ms",
        "pictures/s",
        "`mujoco.Renderer`, ms",
        "faster by",
    ]
    film_heads = [f"{n} at once, ms" for n in FILM_ENVS]
    return "\n\n".join(
        [
            "Pictures in fast look, ms of CPU each:",
            table(heads, rows),
            "Their parts, ms of CPU a picture (kinematics: of MuJoCo; convert: to channels first):",
            table(["task", "N", "size", *PARTS], parts),
            f"A frame of a film, {FILM[0]} x {FILM[1]} in full look, and MiB for all of the above:",
            table(["task", *film_heads, "MiB"], films),
        ]
    )


def _apart(task: str, rounds: int) -> dict[str, Any]:
    command = [sys.executable, "-m", "benchmarks.render", "--child", "--tasks", task]
    command += ["--rounds", str(rounds)]
    child = subprocess.run(command, capture_output=True, text=True, check=False)
    if child.returncode:
        raise RuntimeError(child.stderr)
    found: dict[str, Any] = json.loads(child.stdout.splitlines()[-1])
    return found


if __name__ == "__main__":
    main()
