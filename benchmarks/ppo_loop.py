"""PPO as one file, after CleanRL's manner: the environment's own tensors, no Stable-Baselines3.

What somebody would write who wants nothing between learner and simulation. The algorithm and its
numbers are those of Stable-Baselines3's PPO: separate networks of two tanh layers with orthogonal
weights, Gaussian actions with one standard deviation each, advantages normalized in a minibatch,
no clipping of values, and the value of the last observation where an episode is cut off.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from torch import nn

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv

EPISODES = 200
"""Episodes that the success rate looks back."""


@dataclass(frozen=True)
class Settings:
    """What PPO is told, by Stable-Baselines3's names."""

    n_steps: int
    batch_size: int
    n_epochs: int
    learning_rate: float = 1e-3
    gamma: float = 0.9
    gae_lambda: float = 0.95
    clip_range: float = 0.2
    vf_coef: float = 0.5
    max_grad_norm: float = 0.5
    log_std_init: float = -0.7

    def shape(self) -> dict[str, int]:
        """What arms differ in, for tables."""
        return {name: getattr(self, name) for name in ("n_steps", "batch_size", "n_epochs")}


class Agent(nn.Module):
    """Mean, standard deviation and value of an observation."""

    def __init__(self, observed: int, acted: int, log_std: float) -> None:
        super().__init__()
        self.actor = _network(observed, acted, 0.01)
        self.critic = _network(observed, 1, 1.0)
        self.log_std = nn.Parameter(torch.full((acted,), log_std))

    def policy(self, obs: torch.Tensor) -> torch.distributions.Normal:
        """Of the actions."""
        mean = self.actor(obs)
        return torch.distributions.Normal(mean, self.log_std.exp().expand_as(mean))

    def value(self, obs: torch.Tensor) -> torch.Tensor:
        """(B,) expected return."""
        found: torch.Tensor = self.critic(obs).flatten()
        return found


def _network(inputs: int, outputs: int, gain: float) -> nn.Sequential:
    layers = [nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh()]
    layers.append(nn.Linear(64, outputs))
    for layer in layers:
        if isinstance(layer, nn.Linear):
            nn.init.orthogonal_(layer.weight, gain if layer is layers[-1] else 2**0.5)
            nn.init.zeros_(layer.bias)
    return nn.Sequential(*layers)


class PpoLoop:
    """Learns on a batched environment, a rollout and its update at a time.

    Args:
        env: The environment; its actions lie in [-1, 1].
        settings: PPO's.
        seed: Of weights, actions and minibatches, and of the environment.
    """

    def __init__(self, env: BaseEnv, settings: Settings, seed: int) -> None:
        self.env, self.settings = env, settings
        torch.manual_seed(seed)
        obs, _ = env.reset(seed=seed)
        self._obs = env.observation_manager.flatten(obs)
        count, width = self._obs.shape
        acted = len(env.single_action_space.low)
        self.agent = Agent(width, acted, settings.log_std_init)
        self._adam = torch.optim.Adam(self.agent.parameters(), settings.learning_rate, eps=1e-5)
        steps = settings.n_steps
        self._seen = torch.zeros(steps, count, width)
        self._actions = torch.zeros(steps, count, acted)
        self._log_probs, self._rewards, self._values, self._over = torch.zeros(4, steps, count)
        self.successes: deque[bool] = deque(maxlen=EPISODES)

    def learn(self, rollouts: int, stop: Callable[[], bool] = lambda: False) -> int:
        """Roll out and update; returns how often it did before `stop`."""
        for number in range(rollouts):
            self._collect()
            self._update(self._advantages())
            if stop():
                return number + 1
        return rollouts

    @torch.no_grad()
    def _collect(self) -> None:
        agent, env, flatten = self.agent, self.env, self.env.observation_manager.flatten
        for step in range(self.settings.n_steps):
            policy = agent.policy(self._obs)
            action = policy.sample()
            self._seen[step] = self._obs
            self._actions[step] = action
            self._log_probs[step] = policy.log_prob(action).sum(1)
            self._values[step] = agent.value(self._obs)
            obs, reward, terminated, truncated, info = env.step(action.clamp(-1.0, 1.0))
            over = terminated | truncated
            if over.any():
                cut = truncated & ~terminated
                last = agent.value(flatten(info["final_obs"])[cut])
                reward[cut] += self.settings.gamma * last
                self.successes.extend(
                    info["final_info"]["metrics"]["success"][over].bool().tolist()
                )
            self._rewards[step] = reward
            self._over[step] = over
            self._obs = flatten(obs)

    @torch.no_grad()
    def _advantages(self) -> torch.Tensor:
        """(T, N) generalized advantage estimates."""
        settings = self.settings
        found = torch.zeros_like(self._rewards)
        value, ahead = self.agent.value(self._obs), torch.zeros(self._obs.shape[0])
        for step in reversed(range(settings.n_steps)):
            goes_on = 1.0 - self._over[step]
            delta = self._rewards[step] + settings.gamma * value * goes_on - self._values[step]
            ahead = delta + settings.gamma * settings.gae_lambda * goes_on * ahead
            found[step], value = ahead, self._values[step]
        return found

    def _update(self, advantages: torch.Tensor) -> None:
        settings, agent = self.settings, self.agent
        seen, actions = self._seen.flatten(0, 1), self._actions.flatten(0, 1)
        old, targets = self._log_probs.flatten(), (advantages + self._values).flatten()
        flat = advantages.flatten()
        for _ in range(settings.n_epochs):
            for rows in torch.randperm(len(flat)).split(settings.batch_size):
                policy = agent.policy(seen[rows])
                ratio = (policy.log_prob(actions[rows]).sum(1) - old[rows]).exp()
                gain = flat[rows]
                gain = (gain - gain.mean()) / (gain.std() + 1e-8)
                clipped = ratio.clamp(1 - settings.clip_range, 1 + settings.clip_range)
                value_loss = nn.functional.mse_loss(agent.value(seen[rows]), targets[rows])
                loss = (
                    settings.vf_coef * value_loss - torch.min(gain * ratio, gain * clipped).mean()
                )
                self._adam.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(agent.parameters(), settings.max_grad_norm)
                self._adam.step()
