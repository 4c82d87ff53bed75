"""Environments that are built and closed, and resets, keep the memory of a process flat."""

import gc
import json
import subprocess
import sys
import weakref

import pytest
from mujoco.batch import Batch

import embodichain

pytestmark = pytest.mark.slow

SCRIPT = """
import ctypes, gc, json, os
from embodichain.config import make_env, resolve

def used():
    with open("/proc/self/statm") as pages:
        return int(pages.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")

def trimmed():
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)
    return used()

sizes = [f"{camera}.{side}" for camera in ("front", "side") for side in ("width", "height")]
small = [f"task.sensors.{size}=16" for size in sizes]
resolved = resolve(["task=reach_vision", "num_envs=4", "seed=1", *small])

def build():
    env = make_env(resolved)
    env.reset()
    env.step(env.action_space.sample())
    return env

def build_and_close(times):
    for _ in range(times):
        build().close()

build_and_close(10)
first = trimmed()
build_and_close(40)
found = {"kept": trimmed() - first}
env = build()
env.reset()
first = used()
for _ in range(300):
    env.reset()
found["resets"] = used() - first
env.close()
print(json.dumps(found))
"""


def test_environments_and_resets_leave_no_memory():
    """An environment of `reach_vision` takes some 30 MB."""
    command = [sys.executable, "-c", SCRIPT]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=280)
    found = json.loads(done.stdout.splitlines()[-1])
    assert found["kept"] < 25e6, found
    assert found["resets"] < 10e6, found


@pytest.mark.parametrize("task", ["cart_pole", "push_cube"])
def test_closing_frees_the_simulation_at_once(task):
    """Without waiting for the collector, although the environment is part of cycles."""
    gc.disable()
    try:
        env = embodichain.make(task, num_envs=2, overrides=["seed=1"])
        env.reset()
        env.step(env.action_space.sample())
        engine = weakref.ref(env.sim.engine)
        env.close()
        assert engine() is None
    finally:
        gc.enable()


def test_an_engine_that_is_still_referred_to_frees_its_simulations():
    """As events do that store it, until the collector comes."""
    gc.collect()

    def batches() -> int:
        return sum(type(found) is Batch for found in gc.get_objects())

    before = batches()
    env = embodichain.make("cart_pole", num_envs=2, overrides=["seed=1"])
    env.reset()
    engine = env.sim.engine
    assert batches() == before + 1
    env.close()
    assert batches() == before
    with pytest.raises(AttributeError, match="the simulation was destroyed"):
        engine.step(1)
