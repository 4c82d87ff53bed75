"""Gymnasium's and Stable-Baselines3's vector environments around `plain_reach.PlainReach`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.arms import CYCLE, SEED, Arm
from benchmarks.plain_reach import factories

MAX_WORKERS = 8
"""Above this many, a process or a Python loop per environment is not worth waiting for."""


def peer_arms(
    folder: Path, nstep: int, actions: list[NDArray[np.float32]], floor: str
) -> Iterator[Arm]:
    """The four vector environments that people have, of the size of the actions (N, A)."""
    from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv
    from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv

    count = len(actions[0])
    makers = factories(folder, nstep, count)
    # Worker processes are started afresh: a fork would copy the threads' locks of this process.
    mode = AutoresetMode.SAME_STEP
    gymnasium_envs = {
        "gymnasium SyncVectorEnv": SyncVectorEnv(makers, autoreset_mode=mode),
        "gymnasium AsyncVectorEnv": AsyncVectorEnv(
            makers, context="forkserver", autoreset_mode=mode
        ),
    }
    for name, env in gymnasium_envs.items():
        env.reset(seed=SEED)
        yield Arm(name, count, floor, _stepper(env, actions), close=env.close)
    sb3_envs = {
        "SB3 DummyVecEnv": DummyVecEnv(makers),
        "SB3 SubprocVecEnv": SubprocVecEnv(makers, start_method="forkserver"),
    }
    for name, vec in sb3_envs.items():
        vec.seed(SEED)
        vec.reset()
        yield Arm(name, count, floor, _stepper(vec, actions), close=vec.close)


def _stepper(env: object, actions: list[NDArray[np.float32]]):
    step_env = env.step  # type: ignore[attr-defined]
    return lambda step: step_env(actions[step % CYCLE])
