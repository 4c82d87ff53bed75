"""Configs of terms with EmbodiChain's names, fields and defaults; `EmbodiedEnvCfg` reads them."""

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
class _Extra:
    extra: dict[str, Any] = dataclasses.field(default_factory=dict, kw_only=True)
    """No effect."""


@configclass
class FunctorCfg(_Extra, cfg.TermCfg):
    """A functor: `func` is one of `managers.events` and so on, or a user's function."""


@configclass
class EventCfg(_Extra, cfg.EventCfg):
    """An event: ``f(env, env_ids, **params)``."""


@configclass
class ObservationCfg(_Extra, cfg.ObservationCfg):
    """An entry of the observation; `mode` is ``modify`` by default, as in EmbodiChain."""

    mode: Literal["add", "modify"] = "modify"


@configclass
class RewardCfg(_Extra, cfg.RewardCfg):
    """A reward: ``f(env, obs, action, info, **params)``."""


@configclass
class ActionTermCfg(_Extra, cfg.ActionTermCfg):
    """A term that receives a slice of the action."""

    mode: Literal["pre", "post"] = dataclasses.field(default="pre", kw_only=True)
    """No effect: actions are read before physics."""


@configclass
class DatasetFunctorCfg(FunctorCfg):
    """Accepted and left out with a note: a run's log becomes a data set, `embodichain export`."""

    mode: Literal["save"] = dataclasses.field(default="save", kw_only=True)
    save_failed_episodes: bool = dataclasses.field(default=False, kw_only=True)
