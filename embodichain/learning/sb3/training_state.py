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
        "counters": {n: getattr(model, n) for n in _COUNTERS if hasattr(model, n)},
        "last": {name: _copy(getattr(model, name)) for name in _LAST},
        "memory": _memory(model),
        "buffers": {name: list(getattr(model, name)) for name in _BUFFERS},
        "exploration": _exploration(model) if rolling else {},
        "noise": [noise.noise_prev.copy() for noise in _noises(model)],
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
    for noise, value in zip(_noises(model), saved.get("noise", ()), strict=False):
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
        raise _wrong(f"{path} cannot be loaded", error, key) from error
    try:
        model.set_parameters(params, exact_match=True, device="cpu")
        for name, value in (variables or {}).items():
            if value is not None:
                recursive_setattr(model, f"{name}.data", value.data)
    except (ValueError, KeyError, RuntimeError, AttributeError) as error:
        what = f"{path} does not fit the network of the run's config"
        raise _wrong(what, error, key) from error


def _code_in_weights(path: Path) -> list[str]:
    """Functions and classes that files of weights name, and that torch does not allow in them."""
    found: list[str] = []
    with suppress(Exception), zipfile.ZipFile(path) as archive:  # it may be damaged in any way
        check_unpacked(path)
        for name in archive.namelist():
            if name.endswith(_WEIGHTS):
                stream = io.BytesIO(archive.read(name))
                found += torch.serialization.get_unsafe_globals_in_checkpoint(stream)
    return list(dict.fromkeys(found))


def _wrong(what: str, error: Exception, key: str = "resume") -> ConfigError:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    why = " ".join(lines[:2]) or type(error).__name__
    return ConfigError([Problem(key, f"{what}: {why}")])


def _exploration(model: BaseAlgorithm) -> dict[str, torch.Tensor]:
    distribution = _distribution(model)
    found = {name: getattr(distribution, name, None) for name in _EXPLORATION}
    return {n: v.detach().clone() for n, v in found.items() if isinstance(v, torch.Tensor)}


def _distribution(model: BaseAlgorithm) -> Any:
    """The distribution of the policy or its actor, with draws of state-dependent exploration."""
    owner = getattr(model.policy, "actor", model.policy)
    return getattr(owner, "action_dist", None)


def _memory(model: BaseAlgorithm) -> tuple[Any, ...] | None:
    """A copy of the states of a recurrent policy and its critic in the current episodes."""
    states = getattr(model, _MEMORY, None)
    if states is None:
        return None
    return tuple(tuple(part.detach().clone() for part in pair) for pair in states)


def _noises(model: BaseAlgorithm) -> list[OrnsteinUhlenbeckActionNoise]:
    """Action noise with state, one for each environment."""
    noise = getattr(model, "action_noise", None)
    parts = noise.noises if isinstance(noise, VectorizedActionNoise) else [noise]
    return [part for part in parts if isinstance(part, OrnsteinUhlenbeckActionNoise)]


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
    # One more row: with optimize_memory_usage it contains the last observation.
    rows = buffer.buffer_size if buffer.full else min(buffer.pos + 1, buffer.buffer_size)
    arrays = {name: array[:rows] for name, array in _arrays(buffer).items()}
    kept = {"env_steps": env_steps, "pos": buffer.pos, "full": bool(buffer.full), "arrays": arrays}
    write_tree(path, kept)


def load_buffer(path: Path, buffer: ReplayBuffer, env_steps: int) -> None:
    """Fill a new buffer from a file of `save_buffer`; runs no code of the file.

    Raises:
        ConfigError: The file is missing, damaged, of another checkpoint, or does not fit.
    """
    kept = read_tree(path)
    if kept.get("env_steps") != env_steps:
        raise _wrong_buffer(
            path, f"it is of {kept.get('env_steps')} steps, the checkpoint of {env_steps}"
        )
    arrays, wanted = kept.get("arrays", {}), _arrays(buffer)
    for name, target in wanted.items():
        found = arrays.get(name)
        if not isinstance(found, np.ndarray) or len(found) > len(target):
            raise _wrong_buffer(path, f"its {name} do not fit in algo.buffer_size")
        if found.shape[1:] != target.shape[1:] or found.dtype != target.dtype:
            have, want = f"{found.dtype} {found.shape[1:]}", f"{target.dtype} {target.shape[1:]}"
            raise _wrong_buffer(path, f"its {name} are {have}, this training has {want}")
    for name, target in wanted.items():
        target[: len(arrays[name])] = arrays[name]
    buffer.pos, buffer.full = kept["pos"], kept["full"]


def _arrays(buffer: ReplayBuffer) -> dict[str, NDArray[Any]]:
    found: dict[str, Any] = {name: getattr(buffer, name, None) for name in _ARRAYS}
    arrays: dict[str, NDArray[Any]] = {}
    for name, value in found.items():
        if isinstance(value, dict):  # of a dict of observations
            arrays |= {f"{name}/{key}": array for key, array in value.items()}
        elif value is not None:
            arrays[name] = value
    return arrays


def _wrong_buffer(path: Path, why: str) -> ConfigError:
    return ConfigError([Problem("resume", f"{path} is not this training's replay buffer: {why}")])
