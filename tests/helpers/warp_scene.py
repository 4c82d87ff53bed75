"""A small scene for engines on MuJoCo Warp: an arm that a motor holds, a ball, a mocap body.

Tests share it, so that few kernels are compiled where Warp's cache is empty.
"""

import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.engine.api import Engine

__all__ = ["DEVICE", "RANDOMIZED", "SCENE", "N", "close", "scatter"]

SCENE = """
<mujoco>
  <option timestep="0.004" integrator="implicitfast"><flag autoreset="disable"/></option>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 .1"/>
    <geom name="post" type="sphere" size=".2" pos="1.5 0 .25"/>
    <body name="arm" pos="0 0 1">
      <joint name="shoulder" axis="0 1 0" damping=".2" range="-2 2" limited="true"/>
      <geom name="upper" type="capsule" fromto="0 0 0 .4 0 0" size=".05" mass="1"/>
      <body name="fore" pos=".4 0 0">
        <joint name="elbow" axis="0 1 0" damping=".2" armature=".01"/>
        <geom name="lower" type="capsule" fromto="0 0 0 .4 0 0" size=".04" mass=".6"/>
        <site name="tip" pos=".4 0 0"/>
      </body>
    </body>
    <body name="ball" pos="0 .8 .098">
      <freejoint/>
      <geom name="ball" type="sphere" size=".1" mass=".5"/>
    </body>
    <body name="goal" mocap="true" pos="1 1 1">
      <geom type="sphere" size=".02" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
  <actuator>
    <position name="a" joint="shoulder" kp="40" kv="2" forcerange="-15 15"/>
    <position name="b" joint="elbow" kp="20" kv="1"/>
  </actuator>
  <sensor>
    <accelerometer site="tip"/>
    <framepos objtype="site" objname="tip"/>
    <contact name="touch" geom1="ball" geom2="floor" data="found force" num="1"/>
  </sensor>
</mujoco>
"""
N = 4
DEVICE = os.environ.get("EMBODICHAIN_TEST_WARP_DEVICE", "cpu")
OF = "params: {of: {uid: cart_pole}"
RANDOMIZED = (
    *(f"device={DEVICE}", "sim.engine=warp", "sim.num_threads=1", "seed=3"),
    *("sim.warp.nconmax=16", "sim.warp.njmax=16", "task.max_episode_steps=7"),
    "+task.events.mass={func: randomize, mode: reset, "
    f"{OF}, mass: [0.8, 1.2], operation: scale}}}}",
    "+task.events.fall={func: randomize, mode: reset, params: {gravity: [[0, 0, -1], [0, 0, 1]]}}",
    "+task.events.damping={func: randomize, mode: interval, interval_step: 5, "
    f"{OF}, joint_damping: [0.1, 0.4]}}}}",
)
"""Lines of a `cart_pole` whose model fields are drawn at resets and at intervals."""


def scatter(*engines: Engine, seed: int = 0) -> None:
    """Put the same states, representable in float32, into all engines."""
    rng = np.random.default_rng(seed)
    row = engines[0].rows[0].copy()
    qpos = np.tile(row[engines[0].component("qpos")], (N, 1))
    qpos[:, :2] = rng.uniform(-1, 1, (N, 2))
    qpos[:, 2:4] += rng.uniform(-0.1, 0.1, (N, 2))
    qvel = rng.uniform(-0.5, 0.5, (N, 8))
    ctrl = rng.uniform(-1, 1, (N, 2))
    for engine in engines:
        for name, values in (("qpos", qpos), ("qvel", qvel), ("ctrl", ctrl)):
            engine.write(name, values.astype(np.float32))


def close(warp: NDArray[Any], cpu: NDArray[Any], relative: float) -> None:
    """Compare numbers, with a tolerance relative to the largest."""
    np.testing.assert_allclose(warp, cpu, rtol=0, atol=relative * max(1.0, np.abs(cpu).max()))
