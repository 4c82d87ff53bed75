"""Replay buffers of off-policy algorithms as files beside checkpoints: arrays only, no pickle."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from embodichain.learning.plain_state import read_tree, write_tree
from embodichain.utils.errors import ConfigError, Problem

__all__ = ["buffer_of", "buffer_path", "full_size", "load_buffer", "save_buffer"]

SUFFIX = ".replay.npz"
_ARRAYS = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")


def buffer_path(checkpoint: Path) -> Path:
    """Return where the replay buffer of ``NAME.zip`` is: ``NAME.replay.npz`` beside it."""
    return checkpoint.with_name(checkpoint.stem + SUFFIX)


def buffer_of(model: BaseAlgorithm) -> ReplayBuffer | None:
    """Return a model's replay buffer; None for algorithms that have none."""
    return model.replay_buffer if isinstance(model, OffPolicyAlgorithm) else None


def full_size(buffer: ReplayBuffer) -> int:
    """Return how many bytes its file has once the buffer is full."""
    return sum(array.nbytes for array in _arrays(buffer).values())


def save_buffer(path: Path, buffer: ReplayBuffer, env_steps: int) -> None:
    """Write the steps that a buffer holds, as a whole or not at all.

    Args:
        path: Where to, see `buffer_path`.
        buffer: The buffer.
        env_steps: How many steps its training has, to tell it from another checkpoint's.

    Raises:
        OSError: It cannot be written (the disk is full); nothing is left behind.
    """
    # One row more: with optimize_memory_usage it is what was observed last.
    rows = buffer.buffer_size if buffer.full else min(buffer.pos + 1, buffer.buffer_size)
    arrays = {name: array[:rows] for name, array in _arrays(buffer).items()}
    kept = {"env_steps": env_steps, "pos": buffer.pos, "full": bool(buffer.full), "arrays": arrays}
    write_tree(path, kept)


def load_buffer(path: Path, buffer: ReplayBuffer, env_steps: int) -> None:
    """Fill a new buffer with what `save_buffer` wrote; runs nothing of the file.

    Raises:
        ConfigError: The file is missing or damaged, of another checkpoint, or does not fit.
    """
    kept = read_tree(path)
    if kept.get("env_steps") != env_steps:
        raise _wrong(path, f"it is of {kept.get('env_steps')} steps, the checkpoint of {env_steps}")
    arrays, wanted = kept.get("arrays", {}), _arrays(buffer)
    for name, target in wanted.items():
        found = arrays.get(name)
        if not isinstance(found, np.ndarray) or len(found) > len(target):
            raise _wrong(path, f"its {name} do not fit in algo.buffer_size")
        if found.shape[1:] != target.shape[1:] or found.dtype != target.dtype:
            have, want = f"{found.dtype} {found.shape[1:]}", f"{target.dtype} {target.shape[1:]}"
            raise _wrong(path, f"its {name} are {have}, this training has {want}")
    for name, target in wanted.items():
        target[: len(arrays[name])] = arrays[name]
    buffer.pos, buffer.full = kept["pos"], kept["full"]


def _arrays(buffer: ReplayBuffer) -> dict[str, NDArray[Any]]:
    found = {name: getattr(buffer, name, None) for name in _ARRAYS}
    return {name: array for name, array in found.items() if array is not None}


def _wrong(path: Path, why: str) -> ConfigError:
    return ConfigError([Problem("resume", f"{path} is not this training's replay buffer: {why}")])
