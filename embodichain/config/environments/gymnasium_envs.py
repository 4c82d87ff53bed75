"""Gymnasium's ``embodichain/NAME-v0``: `make` builds one environment, `make_vec` a batch."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AutoresetMode, VectorEnv

from embodichain.config.environments.factory import make
from embodichain.config.gymnasium_ids import task_id
from embodichain.lab.gym.envs.base_env import BaseEnv
from embodichain.lab.gym.envs.cfg import NO_LIMIT
from embodichain.lab.gym.envs.step.episodes import parse_mode
from embodichain.lab.gym.single import SingleEnv
from embodichain.lab.gym.vector import NumpyVectorEnv
from embodichain.utils.errors import ConfigError

__all__ = ["TaskEnv", "make_task_vec"]


_HOST = "sim.warp.arrays=host"
"""Numpy's arrays are on the host."""


class TaskEnv(SingleEnv):
    """One environment of a YAML task, with numpy arrays and no batch dimension.

    Gymnasium's ``max_episode_steps`` adds a limit to that of the task; for a longer limit than the
    task's use ``overrides=["task.max_episode_steps=N"]``.

    Args:
        task: An option of the group `task`: ``reach``.
        overrides: As of `embodichain.make`.
        flatten: Whether observations are the policy's flat vector; see `SingleEnv`.
        device: As of `embodichain.make`, like all further arguments.
        seed: The seed of every random stream.
        render_mode: ``rgb_array`` or None.
        run_dir: Folder for the states of environments that diverge.
        config_dir: A folder with the user's groups.
        **kwargs: Arguments of the class that the task names.

    Raises:
        ConfigError: Lists every mistake in the config; or the arguments are those of a batch.
        TypeError: If an argument is unknown.
    """

    def __init__(
        self,
        task: str,
        overrides: Sequence[str] = (),
        flatten: bool = True,
        *,
        device: str | None = None,
        seed: int | None = None,
        render_mode: Literal["rgb_array"] | None = None,
        run_dir: str | Path | None = None,
        config_dir: str | Path | None = None,
        **kwargs: Any,
    ) -> None:
        of_batches = [
            f"{key}={kwargs[key]!r}" for key in ("num_envs", "autoreset_mode") if key in kwargs
        ]
        of_batches += [line for line in overrides if line.lstrip("+").startswith("num_envs=")]
        if of_batches:
            wrong = ", ".join(of_batches)
            raise ConfigError(_BATCHES.format(wrong=wrong, id=task_id(task), task=task))
        env = make(
            task,
            1,
            [_HOST, *overrides],
            device=device,
            seed=seed,
            render_mode=render_mode,
            run_dir=run_dir,
            config_dir=config_dir,
            **kwargs,
        )
        super().__init__(env, flatten)
        self._spec: EnvSpec | None = None

    @property
    def spec(self) -> EnvSpec | None:
        """Gymnasium's spec with the task's ``max_episode_steps``, which wrappers read from it.

        The environment itself ends its episodes: Gymnasium adds no `TimeLimit` for it.
        """
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        self._spec = _with_limit(spec, self.env)


# `VectorEnv` is named again: skrl's `wrap_env` looks at the bases of this class alone.
class TaskVectorEnv(NumpyVectorEnv, VectorEnv):
    """A batch of environments of a YAML task, with the task's limit in its `spec`."""

    _spec: EnvSpec | None = None

    @property
    def spec(self) -> EnvSpec | None:
        """Gymnasium's spec with the task's ``max_episode_steps``."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        self._spec = _with_limit(spec, self.env)


def _with_limit(spec: EnvSpec | None, env: BaseEnv) -> EnvSpec | None:
    """A copy of a spec with the task's limit, if it has none and the task has one."""
    if spec is None or spec.max_episode_steps is not None or env.max_episode_steps == NO_LIMIT:
        return spec
    limited = copy.copy(spec)
    limited.max_episode_steps = env.max_episode_steps
    return limited


_BATCHES = (
    "gymnasium.make({id!r}) makes one environment, which takes no {wrong}; a batch is "
    "gymnasium.make_vec({id!r}, num_envs=N) with numpy arrays, or "
    "embodichain.make({task!r}, num_envs=N) with torch tensors"
)


def make_task_vec(
    task: str,
    num_envs: int = 1,
    overrides: Sequence[str] = (),
    autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    flatten: bool = True,
    max_episode_steps: int | None = None,
    *,
    device: str | None = None,
    seed: int | None = None,
    render_mode: Literal["rgb_array"] | None = None,
    run_dir: str | Path | None = None,
    config_dir: str | Path | None = None,
    **kwargs: Any,
) -> NumpyVectorEnv:
    """Make N environments of a YAML task as Gymnasium's numpy `VectorEnv`.

    Args:
        task: An option of the group `task`: ``reach``.
        num_envs: N.
        overrides: As of `embodichain.make`.
        autoreset_mode: NEXT_STEP, SAME_STEP or DISABLED; see `NumpyVectorEnv`.
        flatten: Whether observations are the policy's flat vector; see `NumpyVectorEnv`.
        max_episode_steps: Time limit in control steps; None is the task's.
        device: As of `embodichain.make`, like all further arguments.
        seed: The seed of every random stream.
        render_mode: ``rgb_array`` or None.
        run_dir: Folder for the states of environments that diverge.
        config_dir: A folder with the user's groups.
        **kwargs: Arguments of the class that the task names.

    Raises:
        ConfigError: Lists every mistake in the config.
        TypeError: If an argument is unknown.
    """
    mode = parse_mode(autoreset_mode)  # before building, so that an unknown mode is reported early
    lines = [_HOST, *overrides]
    if max_episode_steps is not None:
        lines.append(f"task.max_episode_steps={max_episode_steps}")
    env = make(
        task,
        num_envs,
        lines,
        device=device,
        seed=seed,
        render_mode=render_mode,
        run_dir=run_dir,
        config_dir=config_dir,
        **kwargs,
    )
    return TaskVectorEnv(env, mode, flatten)
