"""PPO of rsl_rl on tensors of the environment: `RslRlVecEnv`, and `RslRlPpo` for `train`.

Only this module imports rsl_rl (extra `rsl-rl`).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import torch
from rsl_rl.algorithms import PPO
from rsl_rl.env import VecEnv
from rsl_rl.models import MLPModel
from rsl_rl.storage import RolloutStorage
from tensordict import TensorDict
from torch import Tensor

from embodichain.config.keys.tensor_algorithms import PUBLISHED_STEPS, RslRlPpoCfg
from embodichain.learning.tensors.tensor_env import GROUP, Groups, TensorEnv, TensorStep

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv

__all__ = ["RslRlPpo", "RslRlVecEnv"]


class RslRlVecEnv(VecEnv):  # type: ignore[misc]
    """An environment of rsl_rl, for its own runners.

    Observations are a TensorDict with an entry (N, K) for each group: ``policy`` and the groups of
    the critic, which a runner's ``obs_groups`` names. Actions are (N, A) in [-1, 1]. The extras
    have ``time_outs`` (N,), and under ``log`` the mean over environments of each reward term and
    metric, of which a runner logs the mean over steps. The environment is reset when it is first
    observed.

    Args:
        env: A batched environment (wrapped or not) with ``autoreset_mode`` SAME_STEP.
        critic_groups: Observation groups of the critic; empty: ``policy``.

    Attributes:
        num_envs: N.
        num_actions: A.
        max_episode_length: Control steps after which an episode is cut off.
        device: Where the tensors are.
        cfg: The environment's config.

    Raises:
        ConfigError: If a group is empty or has images, or the action space has no finite bounds.
    """

    def __init__(self, env: gym.Env[Any, Any], critic_groups: Iterable[str] = ()) -> None:
        self.env = TensorEnv(env, critic_groups)
        self.num_envs = self.env.num_envs
        self.device = self.env.device
        (self.num_actions,) = self.env.action_space.shape
        self.max_episode_length = self.env.base.max_episode_steps
        self.cfg = self.env.base.cfg
        self._groups: Groups | None = None

    @property
    def episode_length_buf(self) -> Tensor:
        """(N,) control steps of the current episodes; a copy.

        Setting it lets episodes end earlier, as a runner does that begins with
        ``learn(N, init_at_random_ep_len=True)``. A fresh environment is reset first.

        Raises:
            ValueError: If it is not (N,), or a number is negative.
        """
        return self.env.base.elapsed_steps

    @episode_length_buf.setter
    def episode_length_buf(self, steps: Tensor) -> None:
        self.get_observations()
        self.env.base.elapsed_steps = steps

    @property
    def unwrapped(self) -> BaseEnv:
        """The environment without wrappers."""
        return self.env.base

    def reset(self) -> tuple[TensorDict, dict[str, Any]]:
        """Reset all environments; return the observations and no extras."""
        self._groups = self.env.reset()
        return observations(self._groups), {}

    def seed(self, seed: int = -1) -> int:
        """Reset all environments with a seed (-1 draws one), as Isaac Lab's; return it."""
        if seed < 0:
            seed = int(torch.randint(2**31, ()))
        self._groups = self.env.reset(seed=seed)
        return seed

    def close(self) -> None:
        """Close the environment."""
        self.env.env.close()

    def get_observations(self) -> TensorDict:
        """Return the current observations."""
        if self._groups is None:
            self._groups = self.env.reset()
        return observations(self._groups)

    def step(self, actions: Tensor) -> tuple[TensorDict, Tensor, Tensor, dict[str, Any]]:
        """Step all environments; return observations, rewards (N,), dones (N,) and extras."""
        step = self.env.step(actions)
        self._groups = step.groups
        extras: dict[str, Any] = {"time_outs": step.time_out}
        values = {f"Reward/{name}": value for name, value in step.info["rewards"].items()}
        values |= {f"Metrics/{name}": value for name, value in step.info["metrics"].items()}
        if values:
            rows = torch.stack([value.to(torch.float32) for value in values.values()])
            extras["log"] = dict(zip(values, rows.mean(dim=1), strict=True))
        return observations(step.groups), step.reward, step.done, extras


class RslRlPpo:
    """A `Learner` with PPO of rsl_rl.

    For an episode that is cut off, rsl_rl adds the value of the observation before its last step.

    Args:
        cfg: The settings.
        env: The environment to learn in.
    """

    def __init__(self, cfg: RslRlPpoCfg, env: TensorEnv) -> None:
        self.steps = cfg.num_steps_per_env or PUBLISHED_STEPS
        device = str(env.device)
        (num_actions,) = env.action_space.shape
        # rsl_rl reads the sizes of networks and storage from an observation.
        example = observations(
            {
                name: torch.zeros(env.num_envs, *space.shape).to(env.device)
                for name, space in env.spaces.items()
            }
        )
        obs_groups = {"actor": [GROUP], "critic": list(env.critic_groups)}
        actor = MLPModel(
            example,
            obs_groups,
            "actor",
            num_actions,
            hidden_dims=cfg.hidden_dims,
            activation=cfg.activation,
            obs_normalization=cfg.obs_normalization,
            distribution_cfg={"class_name": "GaussianDistribution", "init_std": cfg.init_std},
        )
        critic = MLPModel(
            example,
            obs_groups,
            "critic",
            1,
            hidden_dims=cfg.hidden_dims,
            activation=cfg.activation,
            obs_normalization=cfg.obs_normalization,
        )
        storage = RolloutStorage("rl", env.num_envs, self.steps, example, [num_actions], device)
        self._ppo = PPO(
            actor.to(device),
            critic.to(device),
            storage,
            device=device,
            schedule="fixed" if cfg.desired_kl is None else "adaptive",
            desired_kl=cfg.desired_kl,
            **cfg.arguments(),
        )
        self._ppo.train_mode()

    def act(self, groups: Groups) -> Tensor:
        """Return actions (N, A), drawn for exploration."""
        return self._ppo.act(observations(groups))

    def record(self, step: TensorStep) -> None:
        """Store what the last actions led to."""
        extras = {"time_outs": step.time_out}
        self._ppo.process_env_step(observations(step.groups), step.reward, step.done, extras)

    def update(self, groups: Groups) -> dict[str, float]:
        """Learn from the stored steps; `groups` is the current observation."""
        with torch.no_grad():
            self._ppo.compute_returns(observations(groups))
        numbers = {f"{name}_loss": value for name, value in self._ppo.update().items()}
        numbers["learning_rate"] = self._ppo.learning_rate
        numbers["std"] = float(self._ppo.actor.output_std.detach().mean())
        return numbers

    def actor(self) -> torch.nn.Module:
        """Return a copy of the network: observations (N, K) -> mean actions (N, A)."""
        return self._ppo.actor.as_jit()

    def parameters(self) -> list[Tensor]:
        """Return the parameters of actor and critic."""
        return [*self._ppo.actor.parameters(), *self._ppo.critic.parameters()]

    def state_dict(self) -> dict[str, Any]:
        """Return networks, normalization and optimizer as plain values."""
        return self._ppo.save()

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Continue from a `state_dict`."""
        self._ppo.load(saved, None, True)


def observations(groups: Groups) -> TensorDict:
    """Return observation groups as rsl_rl takes them, without copies."""
    first = next(iter(groups.values()))
    return TensorDict(dict(groups), batch_size=first.shape[:1], device=first.device)
