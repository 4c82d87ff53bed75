"""`load_policy`: a trained checkpoint as something that acts in an environment.

Policies without learning are in `embodichain.lab.gym.policies`.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from stable_baselines3.common.base_class import BaseAlgorithm

from embodichain.learning.algorithms import algorithm_class
from embodichain.learning.checkpoint import find_checkpoint, read_note
from embodichain.learning.spaces import ActionScale, flat_observation, observation_box
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.lab.sim.engine.base import EnvIndex
    from embodichain.lab.sim.types import EnvObs

__all__ = ["LearnedPolicy", "load_policy"]


def load_policy(
    path: str | Path, env: BaseEnv | None = None, *, deterministic: bool = True
) -> LearnedPolicy:
    """Load a policy that `embodichain train`, or Stable-Baselines3 on an `SB3VecEnv`, has saved.

    Loading runs code from the file: Stable-Baselines3 stores Python objects in it with
    cloudpickle. **Load only files that you trust**, as you would run only programs that you trust.

    Args:
        path: A zip file, or a run folder with ``checkpoints/final.zip``.
        env: Where it will act; given, that it fits is checked now instead of at the first action.
        deterministic: The mean action; otherwise actions are drawn from torch's global generator.

    Returns:
        The policy: ``policy(obs, env) -> (N, A)``.

    Raises:
        ConfigError: If there is no such file, if it is no policy, or if it does not fit.
    """
    file = find_checkpoint(path)
    note = read_note(file)
    algorithm = algorithm_class(str(note.get("algo")))
    try:
        # Without its seed, and aside: nothing that runs in this process draws other numbers.
        with torch.random.fork_rng(devices=()):
            model = algorithm.load(file, device="cpu", custom_objects={"seed": None})
    except Exception as error:  # a damaged pickle may raise anything
        message = f"{file} cannot be loaded: {type(error).__name__}: {error}"
        raise ConfigError([Problem("policy", message)]) from error
    policy = LearnedPolicy(model, str(note.get("group", "policy")), str(file), deterministic)
    if env is not None:
        policy.check(env)
    return policy


class LearnedPolicy:
    """A model of Stable-Baselines3 that acts in batched environments.

    Args:
        model: The model.
        group: The observation group it was trained on.
        name: What messages call it.
        deterministic: Whether it takes the mean action.
    """

    def __init__(
        self, model: BaseAlgorithm, group: str, name: str = "policy", deterministic: bool = True
    ) -> None:
        self.model = model
        self.group = group
        self.name = name
        self.deterministic = deterministic
        self._env: BaseEnv | None = None
        self._scale: ActionScale | None = None

    def check(self, env: BaseEnv) -> ActionScale:
        """Check that the policy fits an environment.

        Raises:
            ConfigError: If observation or action have another width than in training.
        """
        scale = ActionScale(env.single_action_space)
        pairs = (
            ("observations", self.model.observation_space, observation_box(env, self.group)),
            ("actions", self.model.action_space, scale.space),
        )
        problems = [
            Problem("policy", f"{self.name} has {what} {have.shape}, this task has {want.shape}")
            for what, have, want in pairs
            if have.shape != want.shape
        ]
        if problems:
            raise ConfigError(problems)
        self._env, self._scale = env, scale
        return scale

    def __call__(self, obs: EnvObs, env: BaseEnv) -> torch.Tensor:
        """Return (N, A) float32 actions for an observation.

        Raises:
            ConfigError: At the first call in an environment, if the policy does not fit it.
        """
        scale = self._scale if env is self._env else None
        if scale is None:
            scale = self.check(env)
        flat: Any = flat_observation(env, obs, self.group)
        actions, _ = self.model.predict(flat, deterministic=self.deterministic)
        return torch.from_numpy(scale(actions)).to(env.device)

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Nothing is kept from step to step."""
