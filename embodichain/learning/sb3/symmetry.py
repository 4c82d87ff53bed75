"""Policies that have the symmetry of their task exactly: `SymmetricActorCriticPolicy`.

With M the reflection of observations and actions that a task's `symmetry` declares, the mean
action is pi(x) = (f(x) + M f(M x)) / 2 and the value (g(x) + g(M x)) / 2 for networks f and g, so
that pi(M x) = M pi(x): a step teaches its mirror image too (Abdolhosseini et al., "On Learning
Symmetric Locomotion", 2019, "network" method with an average).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.distributions import DiagGaussianDistribution, Distribution
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.torch_layers import MlpExtractor
from torch import Tensor

from embodichain.lab.gym.envs.cfg import SymmetryCfg
from embodichain.lab.sim.compiler.names import match_every
from embodichain.lab.sim.sensors.ray_patterns import pattern_rays
from embodichain.lab.sim.sensors.ray_sensors import HeightScanSensorCfg
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean, listing

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv

__all__ = ["Columns", "Mirror", "MirroredMeanStd", "SymmetricActorCriticPolicy"]

_SCAN = "scan"
Rules = Mapping[str, Any]


@dataclass(frozen=True)
class Columns:
    """A reflection of vectors: column i of the image is `sign[i]` times column `index[i]`.

    Attributes:
        index: (K,) int64.
        sign: (K,) float32, -1 or 1.
    """

    index: NDArray[np.int64]
    sign: NDArray[np.float32]

    def __call__(self, rows: NDArray[Any]) -> NDArray[Any]:
        """Return the mirror images of vectors (..., K)."""
        image: NDArray[Any] = rows[..., self.index] * self.sign.astype(rows.dtype)
        return image


@dataclass(frozen=True)
class Mirror:
    """The reflection of a task's observations and actions.

    Attributes:
        observations: Of the flat vector of an observation group, (K,).
        actions: Of the action, (A,).
    """

    observations: Columns
    actions: Columns

    @classmethod
    def of(cls, env: BaseEnv, group: str) -> Mirror:
        """Compile the `symmetry` of an environment's config.

        Args:
            env: The environment.
            group: The observation group.

        Raises:
            ConfigError: If the task has no symmetry, or it does not fit joints, observations or
                actions; lists every mistake.
        """
        cfg = env.cfg.symmetry
        if cfg is None:
            message = "the task declares no symmetry: see task.symmetry"
            raise ConfigError([Problem("algo.symmetric", message)])
        joints, problems = _joints(cfg, env)
        columns = env.observation_manager.columns(group)
        widths = {name: s.stop - s.start for name, s in env.action_manager.slices.items()}
        scans, wrong = _scans(cfg, env)
        problems += wrong
        named = {name: scans.get(name, joints) for name in columns}
        seen, wrong = _compile(cfg.observations, columns, named, "observation")
        problems += wrong
        done, wrong = _compile(cfg.actions, widths, dict.fromkeys(widths, joints), "action")
        problems += wrong
        if problems:
            raise ConfigError([problem.below("task.symmetry") for problem in problems])
        return cls(seen, done)

    def to_list(self) -> list[list[float]]:
        """Return it as plain numbers: indices and signs of observations, then of actions."""
        both = self.observations, self.actions
        return [part.tolist() for columns in both for part in (columns.index, columns.sign)]

    @classmethod
    def from_list(cls, numbers: Sequence[Sequence[float]]) -> Mirror:
        """Return the mirror of a `to_list`."""
        parts = [np.array(part) for part in numbers]
        columns = [
            Columns(index.astype(np.int64), sign.astype(np.float32))
            for index, sign in zip(parts[::2], parts[1::2], strict=True)
        ]
        return cls(*columns)


def _joints(cfg: SymmetryCfg, env: BaseEnv) -> tuple[Columns, list[Problem]]:
    """The reflection of one value for each active joint of the robot, and every mistake."""
    robots = env.sim.get_robot_uid_list()
    uid = cfg.robot if cfg.robot is not None else next(iter(robots), "")
    robot: Any = env.sim.get_robot(uid) if uid in robots else None
    empty = Columns(np.zeros(0, np.int64), np.zeros(0, np.float32))
    if robot is None:
        message = f"no robot is called {uid!r}; there are: {', '.join(robots)}"
        return empty, [Problem("robot", message, did_you_mean(uid, robots).strip())]
    names = [robot.joint_names[i] for i in robot.active_joint_ids]
    index, sign = np.arange(len(names)), np.ones(len(names), np.float32)
    problems: list[Problem] = []
    for pattern, image in cfg.swap.items():
        found, wrong = match_every(pattern, names, "joint", f"swap.{pattern}")
        problems += wrong
        for i in found:
            try:
                other = re.sub(pattern, image, names[i], count=1)
            except (re.error, IndexError) as error:
                problems.append(Problem(f"swap.{pattern}", f"malformed {image!r}: {error}"))
                break
            if other not in names:
                message = f"{names[i]!r} has no counterpart {other!r}; there are: "
                hint = did_you_mean(other, names).strip()
                problems.append(Problem(f"swap.{pattern}", message + listing(names, other), hint))
                break
            j = names.index(other)
            taken = [k for k in (i, j) if index[k] != k]
            if taken or i == j:
                message = f"{names[i]!r} and {other!r} are no new pair"
                problems.append(Problem(f"swap.{pattern}", message))
                break
            index[i], index[j] = j, i
    patterns = [cfg.opposite] if isinstance(cfg.opposite, str) else cfg.opposite or []
    for pattern in patterns:
        found, wrong = match_every(pattern, names, "joint", "opposite")
        problems += wrong
        sign[list(found)] = -1.0
    uneven = [names[i] for i in range(len(names)) if sign[i] != sign[index[i]]]
    if uneven:
        message = f"one joint of a pair is opposite, the other is not: {', '.join(uneven)}"
        problems.append(Problem("opposite", message))
    return Columns(index, sign), problems


def _scans(cfg: SymmetryCfg, env: BaseEnv) -> tuple[dict[str, Columns], list[Problem]]:
    """Observation -> the reflection of its height scan, and every mistake."""
    found: dict[str, Columns] = {}
    problems: list[Problem] = []
    for name, rule in cfg.observations.items():
        term = env.cfg.observations.get(name)
        if rule != _SCAN or term is None:
            continue
        sensor = env.cfg.sensors.get(str(term.params.get("sensor")))
        message = ""
        if not isinstance(sensor, HeightScanSensorCfg):
            message = "scan is for observations of a height scan (sensor_type height_scan)"
        elif sensor.alignment == "world":
            message = "a height scan with alignment world does not turn with the robot"
        elif not _is_even(sensor):
            message = "its sensor is not symmetric: pos[1], quat[1], quat[3] and "
            message += "pattern.grid.direction[1] have to be 0"
        starts = np.zeros((1, 3))
        if message:
            problems.append(Problem(f"observations.{name}", message))
        elif isinstance(sensor, HeightScanSensorCfg):
            starts, _ = pattern_rays(sensor.pattern)
        rows = len(np.unique(starts[:, 1]))  # along x, the first at the lowest y
        index = np.arange(len(starts)).reshape(rows, -1)[::-1].ravel()
        found[name] = Columns(index, np.ones(len(starts), np.float32))
    return found, problems


def _is_even(sensor: HeightScanSensorCfg) -> bool:
    """Whether the rays of a height scan are their own mirror images."""
    grid = sensor.pattern.grid
    across = [sensor.pos[1], sensor.quat[1], sensor.quat[3]]
    return not any(across) and (grid is None or not grid.direction[1])


def _compile(
    rules: Rules, widths: Mapping[str, int], named: Mapping[str, Columns], what: str
) -> tuple[Columns, list[Problem]]:
    """Join the reflections of consecutive terms of some widths; also return every mistake.

    Args:
        rules: Term -> its rule.
        widths: Term -> its number of columns.
        named: Term -> its reflection where the rule is not a list of signs.
        what: What a term is called in messages.
    """
    problems = [
        Problem(f"{what}s.{name}", f"no {what} is called {name!r}", did_you_mean(name, widths))
        for name in rules
        if name not in widths
    ]
    index, sign, start = [np.zeros(0, np.int64)], [np.zeros(0, np.float32)], 0
    for name, width in widths.items():
        path, rule = f"{what}s.{name}", rules.get(name)
        part = named[name]
        if rule is None:
            kinds = "joints, scan," if what == "observation" else "joints,"
            message = f"missing: {kinds} or a sign (1 or -1) for each of its columns"
            problems.append(Problem(path, f"{message}, which are {width}"))
        elif not isinstance(rule, str):
            part = Columns(np.arange(len(rule)), np.array(rule, np.float32))
        size = len(part.sign)
        if rule is not None and (not size or width % size):
            message = f"{rule} has {size} columns, the {what} has {width}"
            problems.append(Problem(path, message))
        elif rule is not None:
            for at in range(start, start + width, size):  # several: a history
                index.append(part.index + at)
                sign.append(part.sign)
        start += width
    return Columns(np.concatenate(index), np.concatenate(sign)), problems


class MirroredMeanStd(RunningMeanStd):
    """Mean and variance of vectors and their mirror images, for `VecNormalize`.

    Normalized observations then have the symmetry of those that are not.

    Args:
        mirror: The reflection.
    """

    def __init__(self, mirror: Mirror) -> None:
        self._columns = mirror.observations
        super().__init__(shape=self._columns.sign.shape)

    def update_from_moments(
        self, batch_mean: NDArray[Any], batch_var: NDArray[Any], batch_count: float
    ) -> None:
        """Count the moments of a batch, and those of its mirror image."""
        image, index = self._columns(batch_mean), self._columns.index
        variance = 0.5 * (batch_var + batch_var[index]) + (0.5 * (batch_mean - image)) ** 2
        super().update_from_moments(0.5 * (batch_mean + image), variance, batch_count)


class _MirroredExtractor(MlpExtractor):
    """The networks' latents of observations and of their mirror images.

    The actor's are side by side, (B, 2 F), and the critic's are averaged, (B, F): its last layer
    is linear.
    """

    obs_index: Tensor
    obs_sign: Tensor

    def __init__(self, mirror: Mirror, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        columns = mirror.observations
        self.register_buffer("obs_index", torch.from_numpy(columns.index), persistent=False)
        self.register_buffer("obs_sign", torch.from_numpy(columns.sign), persistent=False)

    def _both(self, features: Tensor) -> Tensor:
        return torch.cat([features, features[:, self.obs_index] * self.obs_sign])

    def forward(self, features: Tensor) -> tuple[Tensor, Tensor]:
        """Return the latents of actor and critic."""
        both = self._both(features)
        return self._actor(both), self._critic(both)

    def forward_actor(self, features: Tensor) -> Tensor:
        """Return the latents of the actor, (B, 2 F)."""
        return self._actor(self._both(features))

    def forward_critic(self, features: Tensor) -> Tensor:
        """Return the latents of the critic, (B, F)."""
        return self._critic(self._both(features))

    def _actor(self, both: Tensor) -> Tensor:
        return torch.cat(self.policy_net(both).chunk(2), dim=1)

    def _critic(self, both: Tensor) -> Tensor:
        latent, image = self.value_net(both).chunk(2)
        average: Tensor = 0.5 * (latent + image)
        return average


class SymmetricActorCriticPolicy(ActorCriticPolicy):
    """``MlpPolicy`` of PPO, A2C and TRPO whose mean action and value have a task's symmetry.

    Args:
        *args: As for `ActorCriticPolicy`.
        mirror: `Mirror.to_list` of the task's symmetry.
        **kwargs: As for `ActorCriticPolicy`.
    """

    act_index: Tensor
    act_sign: Tensor

    def __init__(self, *args: Any, mirror: Sequence[Sequence[float]], **kwargs: Any) -> None:
        # Before the networks are built, which is done by the constructor of Stable-Baselines3.
        self._mirror = Mirror.from_list(mirror)
        self._numbers = [list(part) for part in mirror]
        super().__init__(*args, **kwargs)
        columns = self._mirror.actions
        self.register_buffer("act_index", torch.from_numpy(columns.index), persistent=False)
        self.register_buffer("act_sign", torch.from_numpy(columns.sign), persistent=False)

    def _get_constructor_parameters(self) -> dict[str, Any]:
        return {**super()._get_constructor_parameters(), "mirror": self._numbers}

    def _build_mlp_extractor(self) -> None:
        self.mlp_extractor = _MirroredExtractor(
            self._mirror,
            self.features_dim,
            net_arch=self.net_arch,
            activation_fn=self.activation_fn,
            device=self.device,
        )

    def _get_action_dist_from_latent(self, latent_pi: Tensor) -> Distribution:
        latent, image = latent_pi.chunk(2, dim=1)
        reflected = self.action_net(image)[:, self.act_index] * self.act_sign
        mean = 0.5 * (self.action_net(latent) + reflected)
        spread = 0.5 * (self.log_std + self.log_std[self.act_index])
        if not isinstance(self.action_dist, DiagGaussianDistribution):
            raise TypeError(f"a symmetric policy draws from a Gaussian, not {self.action_dist}")
        return self.action_dist.proba_distribution(mean, spread)
