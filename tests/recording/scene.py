"""A small environment on the real engine, for logs with everything in them.

It does what `BaseEnv` does as far as a recorder can see: actions, interval events that draw, resets
with randomized masses that settle, divergence. Actions and events depend on nothing but seeds.
"""

from types import SimpleNamespace

import mujoco
import numpy as np
import torch

from embodichain.lab.gym.envs.observers import EventRecord, StepRecord
from embodichain.lab.sim.engine.cpu.cpu_engine import CpuEngine

XML = """
<mujoco model="scene">
  <option timestep="0.005" integrator="implicitfast"><flag autoreset="disable"/></option>
  <asset>
    <mesh name="wedge" vertex="0 0 0  .1 0 0  0 .1 0  0 0 .1"/>
    <material name="red" rgba=".8 .1 .1 1"/>
  </asset>
  <worldbody>
    <geom name="default_plane" type="plane" size="0 0 .1"/>
    <body name="arm/base" mocap="true" pos="0 0 .5">
      <geom type="cylinder" size=".06 .05" contype="0" conaffinity="0"/>
      <body name="arm/upper">
        <joint name="arm/shoulder" axis="0 1 0" damping="5"/>
        <geom type="capsule" size=".04" fromto="0 0 0 .3 0 0" material="red"/>
        <body name="arm/fore" pos=".3 0 0">
          <joint name="arm/elbow" axis="0 1 0" damping="5"/>
          <geom type="capsule" size=".03" fromto="0 0 0 .25 0 0"/>
          <geom name="arm/tip" type="mesh" mesh="wedge" pos=".25 0 0" contype="0" conaffinity="0"/>
        </body>
      </body>
    </body>
    <body name="cube" pos=".45 0 .05">
      <freejoint name="cube/free"/>
      <geom name="cube/geom" type="box" size=".05 .05 .05" mass=".2" rgba="0 0 1 1"/>
    </body>
    <body name="goal" mocap="true" pos=".4 .2 .3">
      <geom type="sphere" size=".02" contype="0" conaffinity="0" rgba="0 1 0 .5"/>
    </body>
    <body name="hidden" pos="0 0 2"><geom type="box" size=".1 .1 .1" group="3"/></body>
  </worldbody>
  <actuator>
    <position joint="arm/shoulder" kp="200"/>
    <position joint="arm/elbow" kp="100"/>
  </actuator>
</mujoco>
"""

MODEL = mujoco.MjSpec.from_string(XML).compile()


class SmallEnv:
    """N environments of `XML`; `settle` physics steps run inside every reset."""

    def __init__(self, num_envs=3, seed=0, settle=0, length=7, push=False, threads=1, model=MODEL):
        self.num_envs, self.seed_value = num_envs, seed
        self.physics_dt, self.sim_steps_per_control = 0.005, 4
        self.physics_steps_per_call = 4
        self.step_dt = self.physics_dt * self.sim_steps_per_control
        self.settle, self.length, self.push = settle, length, push
        engine = CpuEngine(model, num_envs, num_threads=threads)
        side = int(np.ceil(np.sqrt(num_envs)))
        offsets = [[i % side * 5.0, i // side * 5.0, 0.0] for i in range(num_envs)]
        scene = SimpleNamespace(model=model, spec=mujoco.MjSpec.from_string(XML))
        self.sim = SimpleNamespace(engine=engine, scene=scene, arena_offsets=torch.tensor(offsets))
        engine.listeners.append(self)
        self.observers = []
        self.termination_manager = SimpleNamespace(values={})
        self.judges_success = True
        self.rngs = [np.random.default_rng((seed, i)) for i in range(num_envs)]
        self.elapsed = np.zeros(num_envs, np.int64)
        self.episodes = np.full(num_envs, -1, np.int64)
        self.count = 0

    def add_observer(self, observer):
        self.observers.append(observer)

    def on_write(self, write):
        for o in self.observers:
            o.on_write(self, write)

    def on_physics(self, event):
        for o in self.observers:
            o.on_physics(self, event)

    def _draw(self, ids, *shape):
        return np.stack([self.rngs[i].uniform(-1, 1, shape) for i in ids])

    def reset(self, ids=None):
        ids = np.arange(self.num_envs) if ids is None else ids
        engine = self.sim.engine
        engine.reset(ids)
        scale = 1.0 + 0.5 * self._draw(ids, 1)
        cube = mujoco.mj_name2id(engine.model, mujoco.mjtObj.mjOBJ_BODY, "cube")
        mass = np.array([cube])
        engine.write_model("body_mass", scale * engine.model.body_mass[cube], ids, mass)
        engine.set_const(ids)
        self._event("mass", "reset", ids, {"scale": scale})
        engine.write("qpos", 0.3 * self._draw(ids, 2), ids, np.array([0, 1]))
        if self.settle:
            engine.step(self.settle, ids)
        engine.forward(ids)
        self.elapsed[ids] = 0
        self.episodes[ids] += 1
        for o in self.observers:
            o.on_reset(self, ids)

    def _event(self, term, mode, ids, drawn):
        for o in self.observers:
            o.on_event(self, EventRecord(term, mode, ids, drawn))

    def step(self):
        engine, everyone = self.sim.engine, np.arange(self.num_envs)
        action = 0.8 * self._draw(everyone, 2)
        engine.write("ctrl", action)
        if self.push and self.count == 3:
            engine.write("xfrc_applied", 3.0, np.array([1]), np.arange(30, 33))
        self.step_physics()
        goal = 0.1 * self._draw(everyone, 3)
        engine.write("mocap_pos", goal, None, slice(3, 6))
        self._event("move_goal", "interval", None, {"position": goal})
        self.elapsed += 1
        reward = -np.abs(engine.state("qpos")[:, :2]).sum(1).astype(np.float32)
        diverged = engine.take_diverged()
        truncated = self.elapsed >= self.length + everyone % 3
        terminated = np.zeros(self.num_envs, bool) if diverged is None else diverged
        info = {
            "elapsed_steps": torch.from_numpy(self.elapsed.copy()),
            "rewards": {
                "near goal": torch.from_numpy(reward),
                "effort": torch.zeros(self.num_envs),
            },
            "metrics": {"success": torch.ones(self.num_envs)},
            "diverged": terminated,
        }
        episodes = self.episodes.copy()
        done = np.flatnonzero(terminated | truncated)
        if len(done):
            self.reset(done)
        self.count += 1
        record = StepRecord(self.count, action, reward, terminated, truncated, info, {}, episodes)
        for o in self.observers:
            o.on_step(self, record)

    def step_physics(self):
        """Advance physics by one control step."""
        self.sim.engine.step(self.sim_steps_per_control)

    def close(self):
        for o in self.observers:
            o.on_close(self)
