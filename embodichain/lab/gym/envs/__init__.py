"""Environments: `BaseEnv`, its config, its observers; managers and terms are in subpackages."""

from __future__ import annotations

from typing import TYPE_CHECKING

import lazy_loader

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv, EmbodiedEnv
    from embodichain.lab.gym.envs.cfg import EnvCfg
    from embodichain.lab.gym.envs.observers import EventRecord, StepObserver, StepRecord

__getattr__, __dir__, _ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "base_env": ["BaseEnv", "EmbodiedEnv"],
        "cfg": ["EnvCfg"],
        "observers": ["EventRecord", "StepObserver", "StepRecord"],
    },
)

__all__ = [
    "BaseEnv",
    "EmbodiedEnv",
    "EnvCfg",
    "EventRecord",
    "StepObserver",
    "StepRecord",
]
