"""`reach` as anyone would write it for Stable-Baselines3: one `gymnasium.Env` over one MjData.

`DummyVecEnv` runs N of it. It computes what the YAML task computes (tests/benchmarks compares them
step by step); imports nothing of embodichain. The compiled model is embodichain's. The sibling for
stepping alone is `plain_reach.py`.
"""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import mujoco
import numpy as np
from numpy.typing import NDArray

MAX_EPISODE_STEPS = 100
NEAR = 0.05
"""Metres; nearer is a success."""
SPREAD = 0.2
"""Metres on each axis that a goal is drawn within, around the tool."""

F32 = NDArray[np.float32]


class PlainTask(gym.Env[F32, F32]):
    """One arm that learns to bring its tool to a goal.

    Args:
        model: The compiled scene; environments share it.
        initial: (S,) integration state that episodes start from.
        nstep: Physics steps a control step.
    """

    metadata: dict[str, Any] = {"render_modes": []}

    def __init__(self, model: mujoco.MjModel, initial: NDArray[np.float64], nstep: int) -> None:
        self.model, self.initial, self.nstep = model, initial, nstep
        self.data = mujoco.MjData(model)
        self.goal = int(model.body("goal").mocapid[0])
        self.tool = int(model.body("robot/ee_link").id)
        self._restore()
        self.home = self.data.qpos.copy()
        self.action_space = gym.spaces.Box(-1.0, 1.0, (model.nu,), np.float32)
        size = model.nq + model.nv + 3 + model.nu
        self.observation_space = gym.spaces.Box(-np.inf, np.inf, (size,), np.float32)
        self.last_action = np.zeros(model.nu)
        self.steps = 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[F32, dict[str, Any]]:
        """Put the arm into its initial configuration, and the goal near its tool."""
        super().reset(seed=seed)
        self._restore()
        drawn = self.np_random.uniform(-SPREAD, SPREAD, 3)
        self.data.mocap_pos[self.goal] = self.data.xpos[self.tool] + drawn
        self.last_action = np.zeros(self.model.nu)
        self.steps = 0
        return self._observe(self._to_goal()), {}

    def step(self, action: F32) -> tuple[F32, float, bool, bool, dict[str, Any]]:
        """Follow joint targets around the initial configuration for one control step."""
        self.last_action = action
        self.data.ctrl[:] = self.home + 0.6 * np.clip(action, -1.0, 1.0)
        mujoco.mj_step(self.model, self.data, nstep=self.nstep)
        mujoco.mj_kinematics(self.model, self.data)  # poses after a step are those before it
        to_goal = self._to_goal()
        distance = float(np.sqrt(to_goal @ to_goal))
        near = distance < NEAR
        self.steps += 1
        reward = 0.5 * near - distance
        over = self.steps >= MAX_EPISODE_STEPS
        return self._observe(to_goal), reward, False, over, {"is_success": near}

    def _restore(self) -> None:
        mujoco.mj_resetData(self.model, self.data)
        mujoco.mj_setState(self.model, self.data, self.initial, mujoco.mjtState.mjSTATE_INTEGRATION)
        mujoco.mj_forward(self.model, self.data)

    def _to_goal(self) -> NDArray[np.float64]:
        found: NDArray[np.float64] = self.data.mocap_pos[self.goal] - self.data.xpos[self.tool]
        return found

    def _observe(self, to_goal: NDArray[np.float64]) -> F32:
        data = self.data
        parts = data.qpos - self.home, 0.1 * data.qvel, to_goal, self.last_action
        return np.concatenate(parts, dtype=np.float32, casting="same_kind")
