"""Proximal policy optimization in one file, as CleanRL has it, over Gymnasium's vector interface.

The calls are those of `ppo_continuous_action.py` of CleanRL 2.0.0b1: the spaces' shapes, `reset`
with a seed, `step` with numpy actions, flags joined to dones. Only what makes the environment
differs: `make_vec` with Gymnasium's vector wrappers, or `make` in a `SyncVectorEnv`.
"""

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium.wrappers import vector
from torch import nn
from torch.distributions import Normal

import embodichain  # noqa: F401  (registers the tasks)

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]

GAMMA, LAMBDA, CLIP = 0.99, 0.95, 0.2


def batched(task, count):
    """One batch, and the vector form of CleanRL's wrappers around it."""
    envs = gym.make_vec(f"embodichain/{task}-v0", num_envs=count)
    envs = vector.RecordEpisodeStatistics(envs)
    envs = vector.ClipAction(envs)
    envs = vector.NormalizeObservation(envs)
    envs = vector.TransformObservation(envs, lambda obs: np.clip(obs, -10, 10))
    envs = vector.NormalizeReward(envs, gamma=GAMMA)
    return vector.TransformReward(envs, lambda reward: np.clip(reward, -10, 10))


def several(task, count):
    """An environment for each, in CleanRL's wrappers."""

    def one():
        env = gym.wrappers.FlattenObservation(gym.make(f"embodichain/{task}-v0"))
        env = gym.wrappers.ClipAction(gym.wrappers.RecordEpisodeStatistics(env))
        env = gym.wrappers.NormalizeObservation(env)
        space = env.observation_space
        env = gym.wrappers.TransformObservation(env, lambda obs: np.clip(obs, -10, 10), space)
        env = gym.wrappers.NormalizeReward(env, gamma=GAMMA)
        return gym.wrappers.TransformReward(env, lambda reward: np.clip(reward, -10, 10))

    return gym.vector.SyncVectorEnv([one] * count)


def network(inputs, outputs):
    return nn.Sequential(nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, outputs))


class Agent(nn.Module):
    def __init__(self, envs):
        super().__init__()
        width = int(np.prod(envs.single_observation_space.shape))
        self.value = network(width, 1)
        self.mean = network(width, int(np.prod(envs.single_action_space.shape)))
        self.log_std = nn.Parameter(torch.full(envs.single_action_space.shape, -0.5))

    def policy(self, obs):
        return Normal(self.mean(obs), self.log_std.exp())


def rollout(envs, agent, obs, done, steps, returns):
    """Steps, and what each saw: lists of tensors (N, ...)."""
    seen = {key: [] for key in ("obs", "done", "action", "log_prob", "value", "reward")}
    for _ in range(steps):
        with torch.no_grad():
            policy = agent.policy(obs)
            action = policy.sample()
            row = (obs, done, action, policy.log_prob(action).sum(1), agent.value(obs)[:, 0])
        new, reward, terminated, truncated, info = envs.step(action.numpy())
        ended = info.get("_episode", np.zeros(len(reward), bool))
        returns += info["episode"]["r"][ended].tolist() if ended.any() else []
        for key, value in zip(seen, (*row, torch.Tensor(reward)), strict=True):
            seen[key].append(value)
        obs = torch.Tensor(new)
        done = torch.Tensor(np.logical_or(terminated, truncated))
    return seen, obs, done


def advantages(seen, last_value, last_done):
    found, ahead = [], torch.zeros_like(last_value)
    values, dones = [*seen["value"], last_value], [*seen["done"], last_done]
    for t in reversed(range(len(seen["reward"]))):
        alive = 1 - dones[t + 1]
        error = seen["reward"][t] + GAMMA * values[t + 1] * alive - values[t]
        ahead = error + GAMMA * LAMBDA * alive * ahead
        found.insert(0, ahead)
    return torch.cat(found)


def learn(envs, iterations, steps, epochs=4, minibatches=4):
    """Train; returns the returns of the episodes in the order in which they ended, and losses."""
    torch.manual_seed(0)
    shuffled = np.random.default_rng(0)
    agent = Agent(envs)
    optimizer = torch.optim.Adam(agent.parameters(), lr=2e-3, eps=1e-5)
    returns, losses = [], []
    obs, _ = envs.reset(seed=1)
    obs, done = torch.Tensor(obs), torch.zeros(envs.num_envs)
    for _ in range(iterations):
        seen, obs, done = rollout(envs, agent, obs, done, steps, returns)
        with torch.no_grad():
            gained = advantages(seen, agent.value(obs)[:, 0], done)
        batch = {key: torch.cat(value) for key, value in seen.items()}
        target = gained + batch["value"]
        for _ in range(epochs):
            for rows in np.array_split(shuffled.permutation(len(gained)), minibatches):
                part = batch["obs"][rows]
                ratio = agent.policy(part).log_prob(batch["action"][rows]).sum(1)
                ratio = (ratio - batch["log_prob"][rows]).exp()
                gain = (gained[rows] - gained[rows].mean()) / (gained[rows].std() + 1e-8)
                objective = torch.min(gain * ratio, gain * ratio.clamp(1 - CLIP, 1 + CLIP)).mean()
                loss = 0.5 * (agent.value(part)[:, 0] - target[rows]).square().mean() - objective
                optimizer.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
                optimizer.step()
                losses.append(loss.item())
    return returns, losses


def test_it_learns_on_the_batch():
    envs = batched("cart_pole", 16)
    try:
        returns, losses = learn(envs, iterations=12, steps=64)
    finally:
        envs.close()
    assert np.isfinite(losses).all() and len(returns) > 40
    third = len(returns) // 3
    assert np.mean(returns[-third:]) > 1.5 * np.mean(returns[:third])


def test_it_runs_on_environments_of_their_own():
    envs = several("reach", 2)
    try:
        returns, losses = learn(envs, iterations=2, steps=64, epochs=1)
    finally:
        envs.close()
    assert np.isfinite(losses).all() and len(returns) == 2
