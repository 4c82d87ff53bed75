"""What a task is made of, as pure data: `EnvCfg` and the configs of its terms.

`EnvCfg` is what Python users fill and what `task` in YAML is checked against (`num_envs`, `seed`
and `sim_cfg` stand elsewhere there). No torch, no MuJoCo. Names and defaults of the first six
fields are EmbodiChain 0.2.1's; the vocabulary is documented in docs/task.md.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Annotated, Any, Literal

from pydantic import Field

from embodichain.lab.sim.cfg import (
    ArticulationCfg,
    LightCfg,
    RigidObjectCfg,
    RobotCfg,
    SimulationManagerCfg,
    Vec3,
)
from embodichain.utils.configclass import configclass

__all__ = [
    "ActionTermCfg",
    "EmbodiedEnvCfg",
    "EnvCfg",
    "EventCfg",
    "MetricCfg",
    "ObservationCfg",
    "PhysicsTaskCfg",
    "RewardCfg",
    "SceneEntityCfg",
    "SuggestedCfg",
    "TermCfg",
    "TerminationCfg",
]

Names = str | list[str] | None
"""One name or regex, several, or None for all."""


@configclass
class SceneEntityCfg:
    """Points at an entity and, optionally, at joints or links of it; regexes match in full.

    Resolved against the scene at build: what matches nothing is an error listing the candidates.
    The order is the declared one when `preserve_order`, else the entity's own.
    """

    uid: str = ""
    joint_names: Names = None
    link_names: Names = None
    body_names: Names = None
    control_parts: Names = None
    preserve_order: bool = False
    joint_ids: list[int] | None = None
    body_ids: list[int] | None = None


@configclass
class TermCfg:
    """A named function of a manager.

    `func` is a registered term's name, ``package.module:function``, or (Python only) a callable;
    `params` are checked against its signature.
    """

    func: str | Callable[..., Any] = ""
    params: dict[str, Any] = {}


@configclass
class EventCfg(TermCfg):
    """Something that happens to the scene: ``f(env, env_ids, **params) -> None``."""

    mode: Literal["startup", "reset", "interval"] = "reset"
    interval_step: Annotated[int, Field(ge=1)] = 10
    """Control steps between firings of an `interval` event; 1 is every step."""
    interval_range_s: Annotated[list[float], Field(min_length=2, max_length=2)] | None = None
    """[low, high] seconds between firings, drawn anew each time; wins over `interval_step`."""
    is_global: bool = False
    """Whether all environments share one timer (and `env_ids` is None)."""


@configclass
class ObservationCfg(TermCfg):
    """A piece of the observation: ``f(env, obs, **params) -> (N, ...)``.

    With `mode` ``modify``, ``f(env, data, **params)`` receives the entry `name` and returns its
    replacement.
    """

    mode: Literal["add", "modify"] = "add"
    name: str | None = None
    """Where it stands in the observation; "/" nests. None is the term's key."""
    group: str = "policy"
    noise: dict[str, Any] | None = None
    """Not available yet."""
    clip: Annotated[list[float], Field(min_length=2, max_length=2)] | None = None
    """[low, high], applied before `scale`."""
    scale: float | list[float] | None = None


@configclass
class ActionTermCfg(TermCfg):
    """How a slice of the action moves the robot: a class ``(env, **params)``."""


@configclass
class RewardCfg(TermCfg):
    """``f(env, obs, action, info, **params) -> (N,)``; counted as value x weight, never x dt."""

    mode: Literal["add", "replace"] = "add"
    weight: float = 1.0


@configclass
class TerminationCfg(TermCfg):
    """``f(env, obs, action, info, **params) -> (N,) bool``."""

    kind: Literal["success", "fail", "time_out"] = "fail"


@configclass
class MetricCfg(TermCfg):
    """``f(env, obs, action, info, **params) -> (N,)``, reduced over an episode."""

    reduce: Literal["last", "any", "all", "mean", "sum", "max", "min"] = "last"


@configclass
class PhysicsTaskCfg:
    """A task's own physics; None keeps `sim_cfg`'s value."""

    physics_dt: Annotated[float, Field(gt=0)] | None = None
    """Seconds a physics step."""
    gravity: Vec3 | None = None
    """m/s^2."""
    solver: Literal["Newton", "CG", "PGS"] | None = None
    iterations: Annotated[int, Field(ge=1)] | None = None
    integrator: Literal["implicitfast", "implicit", "Euler", "RK4"] | None = None
    cone: Literal["pyramidal", "elliptic"] | None = None


@configclass
class SuggestedCfg:
    """Values for root keys that the user left at null, for `run` and for `train`."""

    run: dict[str, Any] = {}
    train: dict[str, Any] = {}


@configclass
class EnvCfg:
    """One environment: how many, how it steps, and what the scene and the task declare."""

    num_envs: Annotated[int, Field(ge=1)] = 1
    sim_cfg: SimulationManagerCfg = SimulationManagerCfg()
    seed: int | None = None
    """Any integer; -1 draws one, None is 0 until `reset(seed=)` says otherwise."""
    sim_steps_per_control: Annotated[int, Field(ge=1)] = 4
    """Physics steps a control step (K)."""
    ignore_terminations: bool = False
    max_episode_steps: int = 300
    """Control steps; -1 is no limit."""
    # ours: the declared task. Maps are keyed by name; an entity's uid is its key.
    description: str = dataclasses.field(default="", kw_only=True)
    id: str | None = dataclasses.field(default=None, kw_only=True)
    """A registered Python class instead of the generic one."""
    physics: PhysicsTaskCfg | None = dataclasses.field(default=None, kw_only=True)
    decimation: Annotated[int, Field(ge=1)] | None = dataclasses.field(default=None, kw_only=True)
    """Another name of `sim_steps_per_control`; wins when given."""
    episode_length_s: Annotated[float, Field(gt=0)] | None = dataclasses.field(
        default=None, kw_only=True
    )
    """Another way to say `max_episode_steps`; wins when given."""
    robot: RobotCfg | None = dataclasses.field(default=None, kw_only=True)
    robots: dict[str, RobotCfg] = dataclasses.field(default_factory=dict, kw_only=True)
    objects: dict[str, RigidObjectCfg] = dataclasses.field(default_factory=dict, kw_only=True)
    articulations: dict[str, ArticulationCfg] = dataclasses.field(
        default_factory=dict, kw_only=True
    )
    lights: dict[str, LightCfg] = dataclasses.field(default_factory=dict, kw_only=True)
    sensors: dict[str, Any] = dataclasses.field(default_factory=dict, kw_only=True)
    """Not available yet: anything here is an error that says so."""
    actions: dict[str, ActionTermCfg] = dataclasses.field(default_factory=dict, kw_only=True)
    events: dict[str, EventCfg] = dataclasses.field(default_factory=dict, kw_only=True)
    commands: dict[str, Any] = dataclasses.field(default_factory=dict, kw_only=True)
    """Not available yet: anything here is an error that says so."""
    observations: dict[str, ObservationCfg] = dataclasses.field(default_factory=dict, kw_only=True)
    rewards: dict[str, RewardCfg] = dataclasses.field(default_factory=dict, kw_only=True)
    terminations: dict[str, TerminationCfg] = dataclasses.field(default_factory=dict, kw_only=True)
    metrics: dict[str, MetricCfg] = dataclasses.field(default_factory=dict, kw_only=True)
    curriculum: dict[str, Any] = dataclasses.field(default_factory=dict, kw_only=True)
    """Not available yet: anything here is an error that says so."""
    extensions: dict[str, Any] = dataclasses.field(default_factory=dict, kw_only=True)
    """Become attributes of the environment."""
    suggested: SuggestedCfg = dataclasses.field(default_factory=SuggestedCfg, kw_only=True)


EmbodiedEnvCfg = EnvCfg
"""EmbodiChain's name for a declared environment's config; here every environment is one."""
