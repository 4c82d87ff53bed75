"""random_reach as anyone would write it: one `gymnasium.Env` over one MjModel and MjData.

The peers (SyncVectorEnv, SubprocVecEnv...) run N of it. Imports nothing of embodichain and no
torch, so that worker processes start as light as they can. The compiled model is embodichain's.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import mujoco
import numpy as np
from numpy.typing import NDArray

MAX_EPISODE_STEPS = 100


class PlainReach(gym.Env[NDArray[np.float32], NDArray[np.float32]]):
    """One arm, one cube that jumps in every step.

    The observation is what the YAML task observes: qpos, qvel and effort of the joints, and the
    cube's pose; float32, flat. The reward is 0, and an episode ends after 100 steps.

    Args:
        folder: Where `write_scene` wrote the scene.
        nstep: Physics steps a control step.
    """

    metadata: dict[str, Any] = {"render_modes": []}

    def __init__(self, folder: str, nstep: int) -> None:
        self.model = mujoco.MjModel.from_binary_path(f"{folder}/model.mjb")
        self.data = mujoco.MjData(self.model)
        self.initial = np.load(f"{folder}/row.npy")
        self.nstep = nstep
        # The arm's base is a mocap body as well; the cube is the other one.
        self.cube = int(self.model.body("cube").mocapid[0])
        low, high = self.model.jnt_range.T.astype(np.float32)
        self.action_space = gym.spaces.Box(low, high, dtype=np.float32)
        size = self.model.nq + 2 * self.model.nv + 7
        self.observation_space = gym.spaces.Box(-np.inf, np.inf, (size,), np.float32)
        self.steps = 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Put the arm into its initial configuration."""
        super().reset(seed=seed)
        mujoco.mj_resetData(self.model, self.data)
        mujoco.mj_setState(self.model, self.data, self.initial, mujoco.mjtState.mjSTATE_INTEGRATION)
        mujoco.mj_forward(self.model, self.data)
        self.steps = 0
        return self._observe(), {}

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Follow joint targets for one control step; then the cube jumps."""
        self.data.ctrl[:] = action
        mujoco.mj_step(self.model, self.data, nstep=self.nstep)
        self.data.mocap_pos[self.cube] = self.np_random.uniform(-0.25, 0.25, 3)
        self.steps += 1
        return self._observe(), 0.0, False, self.steps >= MAX_EPISODE_STEPS, {}

    def _observe(self) -> NDArray[np.float32]:
        data = self.data
        parts = data.qpos, data.qvel, data.qfrc_actuator
        cube = data.mocap_pos[self.cube], data.mocap_quat[self.cube]
        return np.concatenate((*parts, *cube), dtype=np.float32, casting="same_kind")


def write_scene(folder: Path, model: mujoco.MjModel, row: NDArray[np.float64]) -> None:
    """Write what `PlainReach` loads: the compiled model and the initial integration state."""
    mujoco.mj_saveModel(model, str(folder / "model.mjb"), None)
    np.save(folder / "row.npy", row)


def factories(folder: Path, nstep: int, count: int) -> list[Any]:
    """`count` functions that build one environment each, picklable."""
    return [partial(PlainReach, str(folder), nstep) for _ in range(count)]
