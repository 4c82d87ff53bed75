"""`step_speed --device`, on Warp's CPU device."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks import arms, warp_speed
from embodichain.lab.sim.engine.warp import warp_worlds
from embodichain.lab.sim.engine.warp.warp_support import cuda_devices

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]

REPO = Path(__file__).parents[2]
NAMES = ["cart_pole", "cart_pole, bare", "cart_pole + MCAP"]
SMALL = ["--rounds=1", "--sizes", "2", "--seconds=0", "--episode=3", "--tasks", "cart_pole"]


def step_speed(*arguments):
    command = [sys.executable, "-m", "benchmarks.step_speed", *SMALL, *arguments]
    return subprocess.run(command, cwd=REPO, capture_output=True, text=True, timeout=250)


def test_a_task_beside_its_bare_physics(tmp_path):
    out = tmp_path / "raw.json"
    sizes = ["--set", "sim.warp.nconmax=16", "sim.warp.njmax=16"]
    done = step_speed("--device", "cpu", *sizes, "--log", "--out", str(out))
    assert done.returncode == 0, done.stderr
    facts = json.loads(out.read_text())
    assert [r["name"] for r in facts["results"]] == NAMES
    assert all(r["num_envs"] == 2 and r["speeds"][0] > 0 for r in facts["results"])
    assert "| cart_pole | 2 |" in done.stdout and facts["device"] in done.stdout


def test_bare_physics_are_those_of_the_environment(monkeypatch):
    built = []

    class Worlds(warp_worlds.WarpWorlds):
        def __init__(self, *args):
            super().__init__(*args)
            built.append(self)

    env = arms.make("cart_pole", 2, "sim.engine=warp", seed=0)
    env.reset()
    # CUDA's worlds, of which this counts the calls.
    monkeypatch.setattr(warp_worlds, "WarpWorlds", Worlds)
    arm = warp_speed.bare("cart_pole", env)
    arm.prepare()
    arm.step(0)
    arm.finish()
    state, host = env.sim.engine.state, env.arrays.host
    before = host(state("qpos")).copy()
    env.sim.engine.step(env.sim_steps_per_control)
    np.testing.assert_array_equal(built[0].download("qpos"), host(state("qpos")))
    assert (host(state("qpos")) != before).any()
    env.close()


@pytest.mark.skipif(bool(cuda_devices()), reason="there is a CUDA device")
def test_without_a_card():
    done = step_speed("--device", "cuda")
    assert done.returncode == 1 and not done.stdout
    assert "--device cuda: there is no CUDA device here" in done.stderr
