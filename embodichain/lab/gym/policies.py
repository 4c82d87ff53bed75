"""Policies without learning: zero, random, random_around_home, hold, expert; and users' own.

Learned policies are files, which `resolve_policy` reads with a function of `embodichain.learning`.
Random ones draw from the environment's streams: the actions of environment *i* do not depend on the
number of environments.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, cast, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.managers.param_types import NonNegative
from embodichain.lab.gym.envs.managers.terms.check import check_params
from embodichain.lab.gym.envs.managers.terms.registry import (
    call_mistake,
    describe_term,
    import_object,
)
from embodichain.utils.arrays import tensor_of
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean

if TYPE_CHECKING:
    import torch

    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.lab.sim.objects.robot import Robot
    from embodichain.lab.sim.types import EnvObs
    from embodichain.utils.array_types import EnvIds

__all__ = [
    "POLICIES",
    "PRETRAINED",
    "PlannedPolicy",
    "Policy",
    "hold",
    "random",
    "random_around_home",
    "resolve_policy",
    "zero",
]

STREAM = "policy"
"""The random stream that policies draw from."""
F64 = NDArray[np.float64]


class Policy(Protocol):
    """A policy: called once per control step, and reset when environments begin an episode."""

    def __call__(self, obs: EnvObs, env: BaseEnv) -> torch.Tensor:
        """Return (N, A) float32 actions for an observation."""

    def reset(self, env_ids: EnvIds | None) -> None:
        """Clear the state of the episodes of these environments; (n,) int64, or None for all."""


@runtime_checkable
class PlannedPolicy(Policy, Protocol):
    """A policy with an end: it reports when everything is done, and what has failed."""

    @property
    def done(self) -> NDArray[np.bool_]:
        """(N,) whether nothing is left to do in the episode of each environment."""

    @property
    def failures(self) -> Sequence[str | None]:
        """For each environment what has failed in its episode, in one line; None if nothing has."""


def zero(obs: EnvObs, env: BaseEnv) -> torch.Tensor:
    """Every action is 0, or the bound nearest to it."""
    low, high = _bounds(env)
    return _tile(np.clip(np.zeros_like(low), low, high), env)


def random(obs: EnvObs, env: BaseEnv) -> torch.Tensor:
    """Uniform over the action space, drawn at every step.

    Raises:
        ConfigError: If the action space has no finite bounds.
    """
    low, high = _bounds(env)
    if not (np.isfinite(low).all() and np.isfinite(high).all()):
        message = "random needs an action space with finite bounds; try zero or hold"
        raise ConfigError([Problem("policy", message)])
    return env.rand(STREAM, low.shape, low, high)


def random_around_home(obs: EnvObs, env: BaseEnv, range: NonNegative = 0.1) -> torch.Tensor:
    """The action of the initial state plus uniform noise drawn at every step, within bounds.

    Args:
        obs: Unused.
        env: The environment.
        range: Largest noise in units of the action: rad for absolute joint positions.

    Raises:
        ConfigError: If the actions of the environment are not joint positions.
    """
    low, high = _bounds(env)
    home = _home(env)
    lowest = np.clip(home - range, low, high)
    highest = np.clip(home + range, low, high)
    return env.rand(STREAM, low.shape, lowest, highest)


def hold(obs: EnvObs, env: BaseEnv) -> torch.Tensor:
    """The action that keeps the targets of the drives.

    Raises:
        ConfigError: If the actions of the environment are not joint positions.
    """
    if len(env.action_manager):
        return tensor_of(env.action_manager.hold().astype(np.float32))
    if env.single_action_space.shape == (0,):  # nothing is driven
        return _tile(np.zeros(0), env)
    return _joint_robot(env).body_data.target_qpos[:, env.active_joint_ids]


POLICIES: dict[str, Callable[..., Any] | str] = {
    "expert": "embodichain.lab.gym.expert.policy:Expert",
    "hold": hold,
    "random": random,
    "random_around_home": random_around_home,
    "teleop": "embodichain.lab.gym.teleop:Teleop",
    "zero": zero,
}
"""The policies that a config names; strings are imported when one is used."""


def resolve_policy(
    policy: str | Mapping[str, Any] | Callable[..., Any],
    *,
    load_file: Callable[[Path], Policy] | None = None,
) -> Policy:
    """Make a policy from the `policy` of a config.

    Args:
        policy: A name, ``{func: NAME, params: {...}}``, ``package.module:function``, a path, or
            (Python only) a callable. A class is constructed with the params and then called.
        load_file: Reads a learned policy from a file or a run's folder; a string that names an
            existing path, has a "/" or ends in ``.zip`` is given to it, and so are ``last`` and
            ``pretrained``.

    Returns:
        A policy with `__call__` and `reset`.

    Raises:
        ConfigError: If there is no such policy, or its parameters are wrong.
    """
    params: dict[str, Any] = {}
    func: Any = policy
    if isinstance(policy, Mapping):
        unknown = sorted(set(policy) - {"func", "params"})
        if unknown or "func" not in policy:
            message = f"needs func and perhaps params, got {sorted(policy)}"
            raise ConfigError([Problem("policy", message)])
        params = dict(policy.get("params") or {})
        func = policy["func"]
    if isinstance(func, str):
        if _is_path(func):
            if load_file is None:
                message = f"{func!r} is a file: only `embodichain.learning` reads learned policies"
                raise ConfigError([Problem("policy", message)])
            return load_file(Path(func))
        func = _find_function(func)
    if not callable(func):
        raise ConfigError([Problem("policy", f"{func!r} is not callable")])
    return _bind(func, params)


PRETRAINED = "pretrained"
"""The name of the trained policy that ships for a task (`embodichain.data.pretrained`)."""
_LEARNED = ("last", PRETRAINED)
"""Names of files: of the newest training, and of the shipped policy."""


def _is_path(text: str) -> bool:
    """Whether the name of a policy is that of a file, or stands for one."""
    if text in POLICIES or ":" in text:
        return False
    return text in _LEARNED or "/" in text or text.endswith(".zip") or Path(text).exists()


def _find_function(name: str) -> Any:
    """The policy with a name, or the object that ``package.module:function`` names.

    Raises:
        ConfigError: If there is none, or it cannot be imported.
    """
    policy = POLICIES.get(name, name)
    if not isinstance(policy, str):
        return policy
    if ":" in policy:
        try:
            return import_object(policy)
        except ConfigError as error:
            raise ConfigError([Problem("policy", str(error))]) from error
    names = (*POLICIES, *_LEARNED)
    allowed = ", ".join(names)
    message = f"unknown policy {name!r}; allowed: {allowed}, package.module:function, or a path"
    raise ConfigError([Problem("policy", message, did_you_mean(name, names).strip())])


def _bind(func: Callable[..., Any], params: dict[str, Any]) -> Policy:
    """Check and bind parameters; a class is constructed with them."""
    try:
        spec = describe_term("policy", func)
    except ValueError as error:
        raise ConfigError([Problem("policy", str(error))]) from error
    if spec.is_class and not _has_call(func):
        # Before it is made: to make an object of any class may do anything, as `subprocess.Popen`.
        raise ConfigError([Problem("policy", f"class {spec.name!r} must define __call__")])
    mistake = call_mistake(spec, "policy") if spec.is_class else None
    if mistake is not None:
        raise ConfigError([Problem("policy", mistake)])
    values, problems = check_params(spec, params, "policy.params")
    if problems:
        raise ConfigError(problems)
    arguments = spec.arguments(values)
    policy: Any = func
    if spec.is_class:
        policy = func(**arguments)
    elif arguments:
        policy = partial(func, **arguments)
    if hasattr(policy, "reset"):
        return cast(Policy, policy)
    return _StatelessPolicy(policy)


def _has_call(cls: Any) -> bool:
    """Whether objects of a class can be called."""
    return any("__call__" in vars(base) for base in cls.__mro__)


class _StatelessPolicy:
    """A function (or an object without `reset`) as a policy."""

    def __init__(self, func: Callable[..., Any]) -> None:
        self._func = func

    def __call__(self, obs: EnvObs, env: BaseEnv) -> torch.Tensor:
        return self._func(obs, env)

    def reset(self, env_ids: EnvIds | None) -> None:
        """Do nothing: there is no state."""


def _bounds(env: BaseEnv) -> tuple[F64, F64]:
    """(A,) bounds of one environment's actions; -1 and 1 where an action has none.

    Raises:
        ConfigError: If the action space is not a Box.
    """
    space: Any = env.single_action_space
    if not hasattr(space, "low"):
        message = f"the built-in policies need a Box as action space, got {space}"
        raise ConfigError([Problem("policy", message)])
    low = np.asarray(space.low, np.float64)
    high = np.asarray(space.high, np.float64)
    return np.where(np.isinf(low), -1.0, low), np.where(np.isinf(high), 1.0, high)


def _home(env: BaseEnv) -> F64:
    """(A,) the action of the initial state."""
    if len(env.action_manager):
        return env.action_manager.home()
    if env.single_action_space.shape == (0,):
        return np.zeros(0)
    return np.asarray(_joint_robot(env).parsed.init_qpos, np.float64)[env.active_joint_ids]


def _joint_robot(env: BaseEnv) -> Robot:
    """The robot of an environment without action terms, if an action is as wide as its joints.

    Raises:
        ConfigError: If not: then the meaning of an action is unknown.
    """
    shape = env.single_action_space.shape
    if env.robot is None or shape != (len(env.active_joint_ids),):
        message = f"this environment does not say what its actions {shape} mean; try zero or random"
        raise ConfigError([Problem("policy", message)])
    return env.robot


def _tile(row: F64, env: BaseEnv) -> torch.Tensor:
    """(N, A) float32 the same action for every environment."""
    rows = tensor_of(np.tile(row.astype(np.float32), (env.num_envs, 1)))
    return rows.to(env.device)
