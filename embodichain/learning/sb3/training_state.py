"""The state of a training besides its networks, so that a resumed training gives the same numbers.

It is captured and restored on rollout boundaries, without pickle (`plain_state`); so is the replay
buffer of off-policy algorithms, in a separate file.
"""

from __future__ import annotations

import io
import random
import zipfile
from collections import deque
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.noise import OrnsteinUhlenbeckActionNoise, VectorizedActionNoise
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.save_util import load_from_zip_file, recursive_setattr
from stable_baselines3.common.vec_env import VecEnv

from embodichain.learning.checkpoints.plain_state import read_tree, write_tree
from embodichain.learning.checkpoints.zip_limits import check_unpacked
from embodichain.learning.sb3.vec_env import SB3VecEnv
from embodichain.utils.errors import ConfigError, Problem

__all__ = [
    "buffer_of",
    "buffer_path",
    "capture",
    "full_size",
    "load_buffer",
    "load_parameters",
    "restore",
    "restore_exploration",
    "restore_generators",
    "save_buffer",
]

_COUNTERS = ("num_timesteps", "_n_updates", "_episode_num", "_n_calls", "_next_play")
_LAST = ("_last_obs", "_last_episode_starts", "_last_original_obs")
_MEMORY = "_last_lstm_states"
_BUFFERS = ("ep_info_buffer", "ep_success_buffer")
_REPLAY = ".replay.npz"
_WEIGHTS = ".pth"
_ARRAYS = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")
_EXPLORATION = ("exploration_mat", "exploration_matrices")


def capture(model: BaseAlgorithm, vec_env: SB3VecEnv, *, rolling: bool) -> dict[str, Any]:
    """Return a copy, as plain values and arrays, of environment state, counters and generators.

    Args:
        model: The model, on a rollout boundary.
        vec_env: Its environment, without wrappers.
        rolling: Whether a rollout has begun and has drawn its exploration.
    """
    return {
        "env": vec_env.base.state_dict(),
        "vec_env": vec_env.state_dict(),
        "counters": {name: getattr(model, name) for name in _COUNTERS if hasattr(model, name)},
        "last": {name: _copy(getattr(model, name)) for name in _LAST},
        "memory": _recurrent_states(model),
        "buffers": {name: list(getattr(model, name)) for name in _BUFFERS},
        "exploration": _exploration(model) if rolling else {},
        "noise": [noise.noise_prev.copy() for noise in _stateful_noises(model)],
        "generators": {
            "python": random.getstate(),
            "numpy": np.random.get_state(),  # noqa: NPY002  Stable-Baselines3 draws from it
            "torch": torch.get_rng_state(),
            "actions": model.action_space.np_random.bit_generator.state,
        },
    }


def restore(model: BaseAlgorithm, vec_env: SB3VecEnv, saved: dict[str, Any]) -> None:
    """Restore everything but the generators into a new model and a new environment.

    Args:
        model: A model with the same algorithm, arguments and number of environments.
        vec_env: Its environment, without wrappers.
        saved: The result of `capture`.
    """
    env: VecEnv | None = model.env
    if env is None:
        raise ValueError("a model without environment cannot continue")
    env.reset()  # creates lazily built state, which is overwritten below
    vec_env.base.load_state_dict(saved["env"])
    vec_env.load_state_dict(saved["vec_env"])
    for name, value in (saved["counters"] | saved["last"]).items():
        setattr(model, name, value)
    if saved.get("memory") is not None:
        model.__dict__[_MEMORY] = type(model.__dict__[_MEMORY])(*saved["memory"])
    for name in _BUFFERS:
        setattr(model, name, deque(saved["buffers"][name], maxlen=model._stats_window_size))


def restore_generators(model: BaseAlgorithm, saved: dict[str, Any]) -> None:
    """Restore the generators used by learning; call it last, as any draw would change them."""
    generators = saved["generators"]
    random.setstate(generators["python"])
    np.random.set_state(generators["numpy"])  # noqa: NPY002
    torch.set_rng_state(generators["torch"])
    model.action_space.np_random.bit_generator.state = generators["actions"]


def restore_exploration(model: BaseAlgorithm, saved: dict[str, Any]) -> None:
    """Restore the state of action noise, which Stable-Baselines3 clears at the start of learning.

    Restores also the draws of state-dependent exploration for the current rollout (`use_sde`).
    """
    for noise, value in zip(_stateful_noises(model), saved.get("noise", ()), strict=False):
        noise.noise_prev = value
    distribution = _distribution(model)
    for name, value in saved["exploration"].items():
        setattr(distribution, name, value)


def load_parameters(model: BaseAlgorithm, path: Path, key: str = "resume") -> None:
    """Load networks and optimizers from a checkpoint, without running code of the file.

    Args:
        model: The model, with networks of the same shapes.
        path: The checkpoint.
        key: Config key to name in errors.

    Raises:
        ConfigError: The checkpoint is damaged, has more than weights, or has another network.
    """
    try:
        check_unpacked(path)
        _, params, variables = load_from_zip_file(path, device="cpu", load_data=False)
    except Exception as error:  # torch's readers may raise any exception
        code = _code_in_weights(path)
        if code:
            message = f"{path} cannot be loaded: its weights would run {', '.join(code)}"
            raise ConfigError([Problem(key, message)]) from error
        raise _load_error(f"{path} cannot be loaded", error, key) from error
    try:
        model.set_parameters(params, exact_match=True, device="cpu")
        for name, value in (variables or {}).items():
            if value is not None:
                recursive_setattr(model, f"{name}.data", value.data)
    except (ValueError, KeyError, RuntimeError, AttributeError) as error:
        message = f"{path} does not fit the network of the run's config"
        raise _load_error(message, error, key) from error


def _code_in_weights(path: Path) -> list[str]:
    """Return functions and classes that files of weights name, and torch does not allow there."""
    names: list[str] = []
    with suppress(Exception), zipfile.ZipFile(path) as archive:  # it may be damaged in any way
        check_unpacked(path)
        for file_name in archive.namelist():
            if file_name.endswith(_WEIGHTS):
                stream = io.BytesIO(archive.read(file_name))
                names += torch.serialization.get_unsafe_globals_in_checkpoint(stream)
    return list(dict.fromkeys(names))


def _load_error(message: str, error: Exception, key: str) -> ConfigError:
    """Return an error with the first two lines of what torch says."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    why = " ".join(lines[:2]) or type(error).__name__
    return ConfigError([Problem(key, f"{message}: {why}")])


def _exploration(model: BaseAlgorithm) -> dict[str, torch.Tensor]:
    """Return copies of the draws of state-dependent exploration (`use_sde`)."""
    distribution = _distribution(model)
    draws: dict[str, torch.Tensor] = {}
    for name in _EXPLORATION:
        value = getattr(distribution, name, None)
        if isinstance(value, torch.Tensor):
            draws[name] = value.detach().clone()
    return draws


def _distribution(model: BaseAlgorithm) -> Any:
    """Return the action distribution of the policy or its actor; None if it has none."""
    owner = getattr(model.policy, "actor", model.policy)
    return getattr(owner, "action_dist", None)


def _recurrent_states(model: BaseAlgorithm) -> tuple[Any, ...] | None:
    """Return copies of the states of a recurrent policy and its critic in current episodes."""
    states = getattr(model, _MEMORY, None)
    if states is None:
        return None
    return tuple(tuple(state.detach().clone() for state in pair) for pair in states)


def _stateful_noises(model: BaseAlgorithm) -> list[OrnsteinUhlenbeckActionNoise]:
    """Return action noise with a state, one for each environment."""
    noise = getattr(model, "action_noise", None)
    noises = noise.noises if isinstance(noise, VectorizedActionNoise) else [noise]
    return [noise for noise in noises if isinstance(noise, OrnsteinUhlenbeckActionNoise)]


def _copy(value: Any) -> Any:
    return None if value is None else value.copy()


def buffer_path(checkpoint: Path) -> Path:
    """Return the file with the replay buffer of ``NAME.zip``: ``NAME.replay.npz`` beside it."""
    return checkpoint.with_name(checkpoint.stem + _REPLAY)


def buffer_of(model: BaseAlgorithm) -> ReplayBuffer | None:
    """Return a model's replay buffer; None for algorithms that have none."""
    return model.replay_buffer if isinstance(model, OffPolicyAlgorithm) else None


def full_size(buffer: ReplayBuffer) -> int:
    """Return the size of the buffer's file in bytes when the buffer is full."""
    return sum(array.nbytes for array in _arrays(buffer).values())


def save_buffer(path: Path, buffer: ReplayBuffer, env_steps: int) -> None:
    """Write the steps in a buffer atomically.

    Args:
        path: The file, see `buffer_path`.
        buffer: The buffer.
        env_steps: Environment steps of its training, to recognize another checkpoint's buffer.

    Raises:
        OSError: The file cannot be written (the disk is full); no partial file remains.
    """
    rows = buffer.buffer_size
    if not buffer.full:
        # One more row: with optimize_memory_usage it contains the last observation.
        rows = min(buffer.pos + 1, rows)
    tree = {
        "env_steps": env_steps,
        "pos": buffer.pos,
        "full": bool(buffer.full),
        "arrays": {name: array[:rows] for name, array in _arrays(buffer).items()},
    }
    write_tree(path, tree)


def load_buffer(path: Path, buffer: ReplayBuffer, env_steps: int) -> None:
    """Fill a new buffer from a file of `save_buffer`; runs no code of the file.

    Raises:
        ConfigError: The file is missing, damaged, of another checkpoint, or does not fit.
    """
    tree = read_tree(path)
    saved_steps = tree.get("env_steps")
    if saved_steps != env_steps:
        raise _buffer_error(path, f"it is of {saved_steps} steps, the checkpoint of {env_steps}")
    saved_arrays = tree.get("arrays", {})
    arrays = _arrays(buffer)
    for name, array in arrays.items():
        saved = saved_arrays.get(name)
        if not isinstance(saved, np.ndarray) or len(saved) > len(array):
            raise _buffer_error(path, f"its {name} do not fit in algo.buffer_size")
        if saved.shape[1:] != array.shape[1:] or saved.dtype != array.dtype:
            saved_type = f"{saved.dtype} {saved.shape[1:]}"
            needed_type = f"{array.dtype} {array.shape[1:]}"
            why = f"its {name} are {saved_type}, this training has {needed_type}"
            raise _buffer_error(path, why)
    # Only now: a buffer that does not fit leaves this one as it is.
    for name, array in arrays.items():
        array[: len(saved_arrays[name])] = saved_arrays[name]
    buffer.pos = tree["pos"]
    buffer.full = tree["full"]


def _arrays(buffer: ReplayBuffer) -> dict[str, NDArray[Any]]:
    """Return the arrays of a buffer by name; those of a dict of observations as ``NAME/KEY``."""
    arrays: dict[str, NDArray[Any]] = {}
    for name in _ARRAYS:
        value: Any = getattr(buffer, name, None)
        if isinstance(value, dict):
            arrays |= {f"{name}/{key}": array for key, array in value.items()}
        elif value is not None:
            arrays[name] = value
    return arrays


def _buffer_error(path: Path, why: str) -> ConfigError:
    return ConfigError([Problem("resume", f"{path} is not this training's replay buffer: {why}")])
