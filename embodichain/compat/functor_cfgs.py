"""Configs of functors with EmbodiChain's fields and defaults, for MDPs that are declared in Python.

They are our terms' configs; what differs is said field by field. `EmbodiedEnvCfg` reads them.
"""

from __future__ import annotations

import dataclasses
from typing import Any, Literal

from embodichain.lab.gym.envs import cfg
from embodichain.utils.configclass import configclass

__all__ = [
    "ActionTermCfg",
    "DatasetFunctorCfg",
    "EventCfg",
    "FunctorCfg",
    "ObservationCfg",
    "RewardCfg",
]


@configclass
class FunctorCfg(cfg.TermCfg):
    """A functor: `func` is one of `managers.events` and so on, or a function of your own."""

    extra: dict[str, Any] = dataclasses.field(default_factory=dict, kw_only=True)
    """No effect."""


@configclass
class EventCfg(cfg.EventCfg):
    """Something that happens to the scene: ``f(env, env_ids, **params)``."""

    extra: dict[str, Any] = dataclasses.field(default_factory=dict, kw_only=True)
    """No effect."""


@configclass
class ObservationCfg(cfg.ObservationCfg):
    """A piece of the observation; `mode` is ``modify`` unless it says ``add``, as there."""

    mode: Literal["add", "modify"] = "modify"
    extra: dict[str, Any] = dataclasses.field(default_factory=dict, kw_only=True)
    """No effect."""


@configclass
class RewardCfg(cfg.RewardCfg):
    """A term of the reward: ``f(env, obs, action, info, **params)``."""

    extra: dict[str, Any] = dataclasses.field(default_factory=dict, kw_only=True)
    """No effect."""


@configclass
class ActionTermCfg(cfg.ActionTermCfg):
    """How a slice of the action moves the robot."""

    mode: Literal["pre", "post"] = dataclasses.field(default="pre", kw_only=True)
    """No effect: actions are read before physics."""
    extra: dict[str, Any] = dataclasses.field(default_factory=dict, kw_only=True)
    """No effect."""


@configclass
class DatasetFunctorCfg(FunctorCfg):
    """Accepted and left out with a note: a run's log becomes a data set, `embodichain export`."""

    mode: Literal["save"] = dataclasses.field(default="save", kw_only=True)
    save_failed_episodes: bool = dataclasses.field(default=False, kw_only=True)
