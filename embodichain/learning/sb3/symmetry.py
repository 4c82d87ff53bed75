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
    """A reflection of vectors: column i of the mirror image is `sign[i]` times column `index[i]`.

    Attributes:
        index: (K,) int64.
        sign: (K,) float32, -1 or 1.
    """

    index: NDArray[np.int64]
    sign: NDArray[np.float32]

    def __call__(self, rows: NDArray[Any]) -> NDArray[Any]:
        """Return the mirror images of vectors (..., K)."""
        return rows[..., self.index] * self.sign.astype(rows.dtype)


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
        joints, problems = _reflect_joints(cfg, env)
        scans, scan_problems = _reflect_scans(cfg, env)
        problems += scan_problems
        observation_widths = env.observation_manager.columns(group)
        observations, observation_problems = _join_terms(
            cfg.observations,
            widths=observation_widths,
            named={name: scans.get(name, joints) for name in observation_widths},
            kind="observation",
        )
        problems += observation_problems
        action_slices = env.action_manager.slices
        actions, action_problems = _join_terms(
            cfg.actions,
            widths={name: columns.stop - columns.start for name, columns in action_slices.items()},
            named=dict.fromkeys(action_slices, joints),
            kind="action",
        )
        problems += action_problems
        if problems:
            raise ConfigError([problem.below("task.symmetry") for problem in problems])
        return cls(observations, actions)

    def to_list(self) -> list[list[float]]:
        """Return it as plain numbers: indices and signs of observations, then of actions."""
        return [
            self.observations.index.tolist(),
            self.observations.sign.tolist(),
            self.actions.index.tolist(),
            self.actions.sign.tolist(),
        ]

    @classmethod
    def from_list(cls, numbers: Sequence[Sequence[float]]) -> Mirror:
        """Return the mirror of a `to_list`."""
        observation_index, observation_sign, action_index, action_sign = numbers
        return cls(
            observations=Columns(
                np.array(observation_index).astype(np.int64),
                np.array(observation_sign).astype(np.float32),
            ),
            actions=Columns(
                np.array(action_index).astype(np.int64),
                np.array(action_sign).astype(np.float32),
            ),
        )


def _unchanged(width: int) -> Columns:
    """Return the reflection that leaves vectors of a width as they are."""
    return Columns(np.arange(width), np.ones(width, np.float32))


def _reflect_joints(cfg: SymmetryCfg, env: BaseEnv) -> tuple[Columns, list[Problem]]:
    """Return the reflection of one value for each active joint of the robot, and every mistake."""
    robots = env.sim.get_robot_uid_list()
    uid = cfg.robot if cfg.robot is not None else next(iter(robots), "")
    robot: Any = env.sim.get_robot(uid) if uid in robots else None
    if robot is None:
        message = f"no robot is called {uid!r}; there are: {', '.join(robots)}"
        problem = Problem("robot", message, did_you_mean(uid, robots).strip())
        return _unchanged(0), [problem]
    names = [robot.joint_names[i] for i in robot.active_joint_ids]
    columns = _unchanged(len(names))
    problems: list[Problem] = []
    for pattern, image in cfg.swap.items():
        problems += _swap_joints(columns.index, names, pattern, image)
    patterns = [cfg.opposite] if isinstance(cfg.opposite, str) else cfg.opposite or []
    for pattern in patterns:
        opposite_joints, pattern_problems = match_every(pattern, names, "joint", "opposite")
        problems += pattern_problems
        columns.sign[list(opposite_joints)] = -1.0
    has_same_sign = columns.sign == columns.sign[columns.index]
    uneven = [name for name, is_same in zip(names, has_same_sign, strict=True) if not is_same]
    if uneven:
        message = f"one joint of a pair is opposite, the other is not: {', '.join(uneven)}"
        problems.append(Problem("opposite", message))
    return columns, problems


def _swap_joints(
    index: NDArray[np.int64], names: list[str], pattern: str, image: str
) -> list[Problem]:
    """Swap the joints of a pattern with their counterparts; return every mistake.

    Args:
        index: (J,) for each joint, the one that takes its place; updated in place.
        names: (J,) the joints.
        pattern: A regular expression for joints on one side.
        image: The name of the counterpart, with groups of the pattern.
    """
    path = f"swap.{pattern}"
    matching_joints, problems = match_every(pattern, names, "joint", path)
    problems = list(problems)
    for joint in matching_joints:
        name = names[joint]
        try:
            counterpart = re.sub(pattern, image, name, count=1)
        except (re.error, IndexError) as error:
            return [*problems, Problem(path, f"malformed {image!r}: {error}")]
        if counterpart not in names:
            message = f"{name!r} has no counterpart {counterpart!r}; there are: "
            message += listing(names, counterpart)
            hint = did_you_mean(counterpart, names).strip()
            return [*problems, Problem(path, message, hint)]
        other = names.index(counterpart)
        is_swapped = index[joint] != joint or index[other] != other
        if is_swapped or joint == other:
            message = f"{name!r} and {counterpart!r} are not a new pair"
            return [*problems, Problem(path, message)]
        index[joint] = other
        index[other] = joint
    return problems


def _reflect_scans(cfg: SymmetryCfg, env: BaseEnv) -> tuple[dict[str, Columns], list[Problem]]:
    """Return observation -> the reflection of its height scan, and every mistake."""
    scans: dict[str, Columns] = {}
    problems: list[Problem] = []
    for name, rule in cfg.observations.items():
        term = env.cfg.observations.get(name)
        if rule != _SCAN or term is None:
            continue
        sensor = env.cfg.sensors.get(str(term.params.get("sensor")))
        why = _why_not_reflected(sensor)
        if why:
            problems.append(Problem(f"observations.{name}", why))
            scans[name] = _unchanged(1)  # of a width that divides any other
        elif isinstance(sensor, HeightScanSensorCfg):
            scans[name] = _reflect_scan(sensor)
    return scans, problems


def _why_not_reflected(sensor: Any) -> str:
    """Return why a sensor is not a height scan with a mirror image; empty if it is."""
    if not isinstance(sensor, HeightScanSensorCfg):
        return "scan is for observations of a height scan (sensor_type height_scan)"
    if sensor.alignment == "world":
        return "a height scan with alignment world does not turn with the robot"
    grid = sensor.pattern.grid
    is_off_plane = any([sensor.pos[1], sensor.quat[1], sensor.quat[3]])
    if is_off_plane or (grid is not None and grid.direction[1]):
        message = "its sensor is not symmetric: pos[1], quat[1], quat[3] and "
        return message + "pattern.grid.direction[1] have to be 0"
    return ""


def _reflect_scan(sensor: HeightScanSensorCfg) -> Columns:
    """Return the reflection of a symmetric height scan, whose rows of rays change places."""
    starts, _ = pattern_rays(sensor.pattern)
    rows = len(np.unique(starts[:, 1]))  # along x, the first at the lowest y
    index = np.arange(len(starts)).reshape(rows, -1)[::-1].ravel()
    return Columns(index, np.ones(len(starts), np.float32))


def _join_terms(
    rules: Rules, *, widths: Mapping[str, int], named: Mapping[str, Columns], kind: str
) -> tuple[Columns, list[Problem]]:
    """Join the reflections of consecutive terms; also return every mistake.

    Args:
        rules: Term -> its rule.
        widths: Term -> its number of columns.
        named: Term -> its reflection where the rule is not a list of signs.
        kind: What a term is called in messages.
    """
    problems = [
        Problem(f"{kind}s.{name}", f"no {kind} is called {name!r}", did_you_mean(name, widths))
        for name in rules
        if name not in widths
    ]
    index = [np.zeros(0, np.int64)]
    sign = [np.zeros(0, np.float32)]
    start = 0
    for name, width in widths.items():
        path = f"{kind}s.{name}"
        rule = rules.get(name)
        stop = start + width
        if rule is None:
            words = "joints, scan," if kind == "observation" else "joints,"
            message = f"missing: {words} or a sign (1 or -1) for each of its columns"
            problems.append(Problem(path, f"{message}, which are {width}"))
        else:
            columns = named[name]
            if not isinstance(rule, str):
                columns = Columns(np.arange(len(rule)), np.array(rule, np.float32))
            size = len(columns.sign)
            if size == 0 or width % size:
                message = f"{rule} has {size} columns, the {kind} has {width}"
                problems.append(Problem(path, message))
            else:
                # A history of several steps has the columns several times.
                for first in range(start, stop, size):
                    index.append(columns.index + first)
                    sign.append(columns.sign)
        start = stop
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
        image_mean = self._columns(batch_mean)
        image_var = batch_var[self._columns.index]  # a sign does not change a variance
        mean = 0.5 * (batch_mean + image_mean)
        variance = 0.5 * (batch_var + image_var) + (0.5 * (batch_mean - image_mean)) ** 2
        super().update_from_moments(mean, variance, batch_count)


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
        return 0.5 * (latent + image)


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
