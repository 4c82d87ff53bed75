"""PPO of skrl on tensors of the environment: `SkrlEnv`, and `SkrlPpo` for `train`.

Only this module imports skrl (extra `skrl`).
"""

from __future__ import annotations

import copy
from collections.abc import Iterable
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from skrl.agents.torch.ppo import PPO
from skrl.envs.wrappers.torch import Wrapper
from skrl.memories.torch import RandomMemory
from skrl.models.torch import DeterministicMixin, GaussianMixin, Model
from skrl.resources.preprocessors.torch import RunningStandardScaler
from skrl.resources.schedulers.torch import KLAdaptiveLR
from torch import Tensor, nn

from embodichain.config.keys.tensor_algorithms import PUBLISHED_STEPS, SkrlPpoCfg
from embodichain.learning.tensors.tensor_env import GROUP, Groups, TensorEnv, TensorStep

__all__ = ["SkrlEnv", "SkrlPpo"]

_ACTIVATIONS = {
    "elu": nn.ELU,
    "gelu": nn.GELU,
    "relu": nn.ReLU,
    "selu": nn.SELU,
    "sigmoid": nn.Sigmoid,
    "tanh": nn.Tanh,
}


class SkrlEnv(Wrapper, gym.Env[Any, Any]):  # type: ignore[misc]
    """An environment of skrl, for its own trainers; skrl's `wrap_env` takes it too.

    `wrap_env` takes it for an environment of Gymnasium and asks `unwrapped` for the state, which is
    therefore this environment itself; the batch is `tensors.base`.

    Observations are the group ``policy``, (N, K); the state is the critic's groups side by side,
    (N, S), if they are others. Actions are (N, A) in [-1, 1]; rewards and flags are (N, 1).

    Args:
        env: A batched environment (wrapped or not) with ``autoreset_mode`` SAME_STEP.
        critic_groups: Observation groups of the critic; empty: ``policy``, and there is no state.

    Raises:
        ConfigError: If a group is empty or has images, or the action space has no finite bounds.
    """

    def __init__(self, env: gym.Env[Any, Any], critic_groups: Iterable[str] = ()) -> None:
        Wrapper.__init__(self, env)
        self.tensors = TensorEnv(env, critic_groups)
        # Gymnasium's class has its own of these, so that skrl would not look for them in `env`.
        self.metadata = env.metadata
        self.render_mode = env.render_mode
        self.spec = env.spec
        self._groups: Groups = {}

    @property
    def observation_space(self) -> spaces.Box:  # type: ignore[override]
        """The observation of one environment, (K,)."""
        return self.tensors.spaces[GROUP]

    @property
    def state_space(self) -> spaces.Box | None:
        """The state of one environment, (S,); None if the critic reads the observation."""
        return state_space(self.tensors)

    @property
    def action_space(self) -> spaces.Box:  # type: ignore[override]
        """The actions of one environment, (A,) in [-1, 1]."""
        return self.tensors.action_space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Tensor, dict[str, Any]]:
        """Reset every environment; return observations (N, K) and an empty info.

        Args:
            seed: As in `BaseEnv.reset`.
            options: As in `BaseEnv.reset`.
        """
        obs, _ = self.tensors.env.reset(seed=seed, options=options)
        self._groups = self.tensors.groups(obs)
        return self._groups[GROUP], {}

    def step(  # type: ignore[override]  # Gymnasium's is of one environment
        self, actions: Tensor | NDArray[Any]
    ) -> tuple[Tensor, Tensor, Tensor, Tensor, dict[str, Any]]:
        """Step all environments; return observations, rewards, terminated, truncated and info.

        Args:
            actions: (N, A) in [-1, 1]; of a single environment (A,) too, as `wrap_env` gives them.
        """
        batch = torch.as_tensor(actions, dtype=torch.float32, device=self.device)
        if batch.ndim == 1 and self.num_envs == 1:
            batch = batch[None]
        step = self.tensors.step(batch)
        self._groups = step.groups
        return (
            step.groups[GROUP],
            step.reward[:, None],
            step.terminated[:, None],
            step.time_out[:, None],
            step.info,
        )

    def state(self) -> Tensor | None:
        """Return the critic's groups (N, S) of the current observation; None if it has none."""
        return state_of(self.tensors, self._groups)

    def render(self, *args: Any, **kwargs: Any) -> Any:
        """Return a picture of environment 0; None unless ``render_mode`` is ``rgb_array``."""
        if self.tensors.base.render_mode is None:  # skrl's trainers ask in each step
            return None
        return self.tensors.base.render()

    def close(self) -> None:
        """Close the environment."""
        self.tensors.env.close()


def state_of(env: TensorEnv, groups: Groups) -> Tensor | None:
    """Return the critic's groups side by side, (N, S); None if it reads the observation."""
    if env.critic_groups == (GROUP,):
        return None
    return torch.cat([groups[name] for name in env.critic_groups], dim=1)


def state_space(env: TensorEnv) -> spaces.Box | None:
    """Return the space of `state_of` for one environment."""
    if env.critic_groups == (GROUP,):
        return None
    width = sum(env.spaces[name].shape[0] for name in env.critic_groups)
    return spaces.Box(-np.inf, np.inf, (width,), np.float32)


class SkrlPpo:
    """A `Learner` with PPO of skrl.

    Args:
        cfg: The settings.
        env: The environment to learn in.
    """

    def __init__(self, cfg: SkrlPpoCfg, env: TensorEnv) -> None:
        self._env = env
        self.steps = cfg.rollouts or PUBLISHED_STEPS
        self._bootstraps = cfg.time_limit_bootstrap
        spaces_and_device: dict[str, Any] = {
            "observation_space": env.spaces[GROUP],
            "state_space": state_space(env),
            "action_space": env.action_space,
            "device": env.device,
        }
        # Policy, then value: the order in which their weights are drawn.
        self._policy = _Policy(cfg, spaces_and_device)
        value = _Value(cfg, spaces_and_device)
        self._agent = PPO(
            models={"policy": self._policy, "value": value},
            memory=RandomMemory(memory_size=self.steps, num_envs=env.num_envs, device=env.device),
            cfg=_agent_cfg(cfg, env, self.steps),
            **spaces_and_device,
        )
        self._agent.init()
        self._agent.enable_training_mode(True)
        self._last_groups: Groups = {}
        self._actions = torch.zeros(0)

    def act(self, groups: Groups) -> Tensor:
        """Return actions (N, A), drawn for exploration."""
        self._last_groups = groups
        state = state_of(self._env, groups)
        self._actions, _ = self._agent.act(groups[GROUP], state, timestep=0, timesteps=0)
        return self._actions

    def record(self, step: TensorStep) -> None:
        """Store what the last actions led to."""
        # Without a value at the limit, an episode that is cut off ends there: skrl's returns would
        # go on into the next episode, as they only stop where one terminated.
        terminated = step.terminated if self._bootstraps else step.done
        self._agent.record_transition(
            observations=self._last_groups[GROUP],
            states=state_of(self._env, self._last_groups),
            actions=self._actions,
            rewards=step.reward[:, None].clone(),  # skrl adds the value of what was cut off to it
            next_observations=step.final[GROUP],
            next_states=state_of(self._env, step.final),
            terminated=terminated[:, None],
            truncated=step.time_out[:, None],
            infos=step.info,
            timestep=0,
            timesteps=0,
        )

    def update(self, groups: Groups) -> dict[str, float]:
        """Learn from the stored steps."""
        agent = self._agent
        agent.enable_models_training_mode(True)
        agent.update(timestep=0, timesteps=0)
        agent.enable_models_training_mode(False)
        numbers: dict[str, float] = {}
        for name, values in agent.tracking_data.items():
            numbers[_column(name)] = float(values[-1])
        agent.tracking_data.clear()
        return numbers

    def actor(self) -> nn.Module:
        """Return a copy of the network: observations (N, K) -> mean actions (N, A)."""
        scaler = self._agent.checkpoint_modules.get("observation_preprocessor")
        if scaler is None:
            return copy.deepcopy(nn.Sequential(self._policy.net))
        return copy.deepcopy(nn.Sequential(scaler, self._policy.net))

    def parameters(self) -> list[Tensor]:
        """Return the parameters of policy and value."""
        parameters: list[Tensor] = []
        for model in self._agent.models.values():
            parameters += model.parameters()
        return parameters

    def state_dict(self) -> dict[str, Any]:
        """Return networks, normalization and optimizer as plain values."""
        modules = self._agent.checkpoint_modules
        return {name: module.state_dict() for name, module in modules.items()}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Continue from a `state_dict`."""
        for name, module in self._agent.checkpoint_modules.items():
            module.load_state_dict(saved[name])


def _agent_cfg(cfg: SkrlPpoCfg, env: TensorEnv, steps: int) -> dict[str, Any]:
    """Return the settings of skrl's agent: those with its names, then those with rsl_rl's."""
    agent_cfg: dict[str, Any] = {
        **cfg.arguments(),
        "rollouts": steps,
        "experiment": {"write_interval": 0, "checkpoint_interval": 0},
    }
    if cfg.desired_kl is not None:
        agent_cfg["learning_rate_scheduler"] = KLAdaptiveLR
        agent_cfg["learning_rate_scheduler_kwargs"] = {"kl_threshold": cfg.desired_kl}
    if cfg.obs_normalization:
        for name, space in (("observation", env.spaces[GROUP]), ("state", state_space(env))):
            if space is None:
                continue
            agent_cfg[f"{name}_preprocessor"] = RunningStandardScaler
            agent_cfg[f"{name}_preprocessor_kwargs"] = {"size": space, "device": env.device}
    return agent_cfg


class _Policy(GaussianMixin, Model):  # type: ignore[misc]
    def __init__(self, cfg: SkrlPpoCfg, spaces_and_device: dict[str, Any]) -> None:
        Model.__init__(self, **spaces_and_device)
        GaussianMixin.__init__(self)
        self.net = _layers(cfg, self.num_observations, self.num_actions)
        log_std = torch.full((self.num_actions,), float(np.log(cfg.init_std)))
        self.log_std = nn.Parameter(log_std)

    def compute(self, inputs: dict[str, Any], role: str = "") -> tuple[Tensor, dict[str, Any]]:
        return self.net(inputs["observations"]), {"log_std": self.log_std}


class _Value(DeterministicMixin, Model):  # type: ignore[misc]
    def __init__(self, cfg: SkrlPpoCfg, spaces_and_device: dict[str, Any]) -> None:
        Model.__init__(self, **spaces_and_device)
        DeterministicMixin.__init__(self)
        self._key = "observations" if self.state_space is None else "states"
        self.net = _layers(cfg, self.num_states or self.num_observations, 1)

    def compute(self, inputs: dict[str, Any], role: str = "") -> tuple[Tensor, dict[str, Any]]:
        return self.net(inputs[self._key]), {}


def _layers(cfg: SkrlPpoCfg, inputs: int, outputs: int) -> nn.Sequential:
    widths = [inputs, *cfg.hidden_dims]
    layers: list[nn.Module] = []
    for before, after in zip(widths, widths[1:], strict=False):
        layers.append(nn.Linear(before, after))
        layers.append(_ACTIVATIONS[cfg.activation]())
    return nn.Sequential(*layers, nn.Linear(widths[-1], outputs))


def _column(name: str) -> str:
    """Return ``policy_loss`` for ``Loss / Policy loss``; ``std`` has the name that rsl_rl has."""
    column = name.rpartition("/")[2].strip().lower().replace(" ", "_")
    if column == "standard_deviation":
        return "std"
    return column
