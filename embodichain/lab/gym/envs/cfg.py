"""The declaration of a task as plain data: `EnvCfg` and the configs of its terms.

Python users fill an `EnvCfg`; `task` in YAML is checked against it (there `num_envs`, `seed`,
`first_env` and `sim_cfg` are outside `task`). Imports neither torch nor MuJoCo. Names and defaults
of the first six fields are EmbodiChain 0.2.1's; the vocabulary is documented in docs/task.md.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Annotated, Any, Literal

from pydantic import Field

from embodichain.lab.gym.envs.noise_cfg import (
    AnyNoiseCfg,
    ConstantNoiseCfg,
    GaussianNoiseCfg,
    NoiseCfg,
    UniformNoiseCfg,
)
from embodichain.lab.sim.cfg import (
    ArticulationCfg,
    LightCfg,
    RigidObjectCfg,
    RobotCfg,
    SimulationManagerCfg,
    Vec3,
)
from embodichain.lab.sim.configs.physics_cfg import OptionsCfg
from embodichain.lab.sim.configs.scene_cfg import SceneCfg, ViewCfg
from embodichain.lab.sim.configs.sensor_cfg import AnySensorCfg
from embodichain.utils.configclass import configclass
from embodichain.utils.fields.defaults import KEEP_DEFAULT, DefaultInt
from embodichain.utils.fields.value_checks import refuse, require

__all__ = [
    "LARGEST_WEIGHT",
    "NO_LIMIT",
    "ActionTermCfg",
    "CommandCfg",
    "ConstantNoiseCfg",
    "CurriculumCfg",
    "EnvCfg",
    "EventCfg",
    "GaussianNoiseCfg",
    "MetricCfg",
    "NoiseCfg",
    "ObservationCfg",
    "PhysicsTaskCfg",
    "RewardCfg",
    "SceneEntityCfg",
    "SuggestedCfg",
    "SummandCfg",
    "SymmetryCfg",
    "TermCfg",
    "TerminationCfg",
    "UniformNoiseCfg",
    "ValueCfg",
]

LARGEST_WEIGHT = 3.4028234663852886e38
"""The largest number of float32, in which rewards are added."""
NO_LIMIT = 2**31 - 1
"""`max_episode_steps` of an environment whose episodes are not limited."""
Names = str | list[str] | None
"""One name or regex, several, or None for all."""
Pair = Annotated[list[float], Field(min_length=2, max_length=2)]
"""[low, high]."""
Seconds = Annotated[
    Pair, require("needs 0 < low <= high, got {}", lambda x: 0 < x[0] <= x[1] < math.inf)
]
Clip = Annotated[Pair, require("low exceeds high in {}", lambda clip: clip[0] <= clip[1])]
Weight = Annotated[
    float,
    require("must be a finite number (of float32), got {}", lambda x: abs(x) <= LARGEST_WEIGHT),
]
Steps = Annotated[int, Field(ge=0)]
Delay = Annotated[
    Steps | Annotated[list[Steps], Field(min_length=2, max_length=2)],
    require(
        "needs 0 <= low <= high, got {}",
        lambda delay: isinstance(delay, int) or delay == sorted(delay),
    ),
]
"""Control steps, or [low, high]."""
EntryName = Annotated[
    str, refuse(lambda name: None if all(name.split("/")) else f"has an empty part: {name!r}")
]
"""A key in the observation; "/" nests."""
EpisodeSteps = Annotated[
    int,
    require(
        "must be at least 1, or -1 for no limit, got {}", lambda steps: steps >= 1 or steps == -1
    ),
]
Numbers = float | list[float] | dict[str, float] | None
"""One number, one for each column, or {joint or link regex: number}."""


@configclass
class SceneEntityCfg:
    """Refers to an entity and, optionally, to its joints, and to its links, sites or geoms.

    Regexes must match in full. Resolved against the scene at build: no match is an error that lists
    the candidates. The order is the declared one when `preserve_order`, else the entity's own. A
    reference names frames of one kind: links, sites or geoms.
    """

    uid: str = ""
    joint_names: Names = None
    link_names: Names = None
    body_names: Names = None
    """Another name of `link_names`."""
    control_parts: Names = None
    """Leaves out joints that mimic another one: they have no drive."""
    preserve_order: bool = False
    joint_ids: list[int] | None = None
    body_ids: list[int] | None = None
    site_names: Names = None
    """Sites of the file (MJCF)."""
    geom_names: Names = None
    """Geoms of the file that have a name; of a rigid object ``geom``, or ``SHAPE/geom``."""
    link: str | None = None
    """One link: its name, or a regex that only it matches."""
    site: str | None = None
    """One site, likewise."""
    geom: str | None = None
    """One geom, likewise."""


@configclass
class TermCfg:
    """A named function of a manager.

    `func` is a registered term's name, ``package.module:function``, or (Python only) a callable;
    `params` are checked against its signature.
    """

    func: str | Callable[..., Any] = ""
    params: dict[str, Any] = {}


ValueShape = str | dict[str, Any] | list[str | dict[str, Any]] | None
"""``l2``, ``{tanh: 0.1}``, ``{tolerance: {bounds: [0, 1], margin: 2}}``, or a list of these."""


@configclass
class ValueCfg(TermCfg):
    """A term with one or several numbers for each environment; `shape` reduces them to one."""

    shape: ValueShape = dataclasses.field(default=None, kw_only=True)
    """Applied to the value of `func`; the shapes of a list are applied in order."""


@configclass
class SummandCfg(ValueCfg):
    """A term of a sum of terms (`sum_of`); adds value x weight."""

    weight: Weight = 1.0


@configclass
class EventCfg(TermCfg):
    """Something that happens to the scene: ``f(env, env_ids, **params) -> None``."""

    mode: Literal["startup", "reset", "interval"] = "reset"
    interval_step: Annotated[int, Field(ge=1)] = 10
    """Control steps between firings of an `interval` event; 1 is every step."""
    interval_range_s: Seconds | None = None
    """[low, high] seconds between firings, drawn each time; overrides `interval_step`."""
    is_global: bool = False
    """Whether all environments share one timer (and `env_ids` is None)."""
    strength: Annotated[float, Field(ge=0, le=1)] = 1.0
    """How far its draws are from the default, 0 to 1: default + strength x (drawn - default), and
    default x (drawn / default) ^ strength for factors. Draws are made at 0 too. Only of events that
    have defaults (`register_term`)."""


@configclass
class ObservationCfg(ValueCfg):
    """An entry of the observation: ``f(env, obs, **params) -> (N, ...)``.

    With `mode` ``modify``, ``f(env, data, **params)`` receives the entry `name` and returns its
    replacement. `noise`, `clip`, `scale`, `delay` and `history_length` are applied to the returned
    value, in this order.
    """

    mode: Literal["add", "modify"] = "add"
    name: EntryName | None = None
    """Its key in the observation; "/" nests. None is the term's key."""
    group: str = "policy"
    noise: AnyNoiseCfg | None = None
    """The task's `enable_corruption` switches it off, for all groups or by group."""
    clip: Clip | None = None
    """[low, high]."""
    scale: Numbers = None
    """A number, a list or {joint or link regex: number}. The numbers of a list go with plain names
    of the reference in `params`; without names they are in the order of the columns."""
    delay: Delay = 0
    """Control steps, or [low, high]: then each episode of each environment draws its own."""
    history_length: Steps = 0
    """The values of this many steps, the oldest first; 0 is the current value, no history."""
    flatten_history_dim: bool = True
    """Whether the history is concatenated, (N, H x ...), instead of stacked, (N, H, ...)."""


@configclass
class ActionTermCfg(TermCfg):
    """How a slice of the action moves the robot: a class ``(env, **params)``.

    `delay`, then `noise`, are applied to its slice of the action before the term receives it.
    """

    delay: Delay = 0
    """Control steps, or [low, high]: then each episode of each environment draws its own. Until
    the first action arrives, the term receives the one that keeps the present targets."""
    noise: AnyNoiseCfg | None = None
    """In units of the action."""


@configclass
class RewardCfg(ValueCfg):
    """``f(env, obs, action, info, **params) -> (N,)``; adds value x weight, never x dt."""

    mode: Literal["add", "replace"] = "add"
    weight: Weight = 1.0


@configclass
class TerminationCfg(ValueCfg):
    """``f(env, obs, action, info, **params) -> (N,) bool``."""

    kind: Literal["success", "fail", "time_out"] | None = None
    """None is ``time_out`` for a function of that name, and ``fail`` for any other."""

    @property
    def ends_by(self) -> Literal["success", "fail", "time_out"]:
        """The kind that is meant."""
        if self.kind is not None:
            return self.kind
        func = self.func if isinstance(self.func, str) else getattr(self.func, "__name__", "")
        return "time_out" if func.rpartition(":")[2] == "time_out" else "fail"


@configclass
class MetricCfg(ValueCfg):
    """``f(env, obs, action, info, **params) -> (N,)``, reduced over an episode."""

    reduce: Literal["last", "any", "all", "mean", "sum", "max", "min"] = "last"


@configclass
class CommandCfg(TermCfg):
    """A goal that is not a place, such as a velocity: a class ``(env, **params)``."""

    resampling_time_s: Seconds | None = None
    """[low, high] seconds between draws within an episode; None draws only at resets."""


@configclass
class CurriculumCfg(TermCfg):
    """Changes the task during a training: ``f(env, env_ids, **params)``, before each reset."""


@configclass
class PhysicsTaskCfg(OptionsCfg):
    """Physics options of a task; None keeps the value of `sim_cfg`."""

    physics_dt: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None
    """Seconds per physics step."""
    gravity: Vec3 | None = None
    """m/s^2."""
    solver: Literal["Newton", "CG", "PGS"] | None = None
    iterations: Annotated[int, Field(ge=1)] | None = None
    integrator: Literal["implicitfast", "implicit", "Euler", "RK4"] | None = None
    cone: Literal["pyramidal", "elliptic"] | None = None
    impratio: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None


@configclass
class SymmetryCfg:
    """How a reflection changes the columns of actions and observations, for `algo.symmetric`.

    A reflection in the plane between a robot's left and right half, for example, changes the sign
    of the y component of a velocity, and swaps the joints of a left and a right leg.
    """

    robot: str | None = None
    """Uid of the robot of `swap` and `opposite`; None is the task's first robot."""
    swap: dict[str, str] = {}
    """Regex of joints -> the joint that each is swapped with, with the regex's groups (``\\1``).
    Joints that occur in no pair are their own mirror images."""
    opposite: Names = None
    """Joints (regexes) whose mirror image moves in the negative direction."""
    observations: dict[str, Literal["joints", "scan"] | list[Literal[-1, 1]]] = {}
    """Observation of the group `policy` -> ``joints``: a value for each active joint; ``scan``: the
    heights of a height scan; or the sign of each column."""
    actions: dict[str, Literal["joints"] | list[Literal[-1, 1]]] = {}
    """Action term -> ``joints`` or the sign of each column."""


@configclass
class SuggestedCfg:
    """Values for root keys that the user left at null, by verb."""

    run: dict[str, Any] = {}
    train: dict[str, Any] = {}
    collect: dict[str, Any] = {}


@configclass
class EnvCfg:
    """The config of `BaseEnv`: number of environments, stepping, scene and task."""

    num_envs: Annotated[int, Field(ge=1)] = 1
    sim_cfg: SimulationManagerCfg = SimulationManagerCfg()
    seed: int | None = None
    """Any integer; -1 draws one, None is 0 until `reset(seed=)` sets one."""
    sim_steps_per_control: Annotated[int, Field(ge=1)] = 4
    """Physics steps a control step (K)."""
    ignore_terminations: bool = False
    max_episode_steps: Annotated[EpisodeSteps, KEEP_DEFAULT] = DefaultInt(300)
    """Control steps; -1 means no limit."""
    first_env: Annotated[int, Field(ge=0)] = dataclasses.field(default=0, kw_only=True)
    """Number of the first environment: environment *i* has the random streams of first_env + i."""
    # The declared task (not in EmbodiChain). Maps are keyed by name; an entity's uid is its key.
    description: str = dataclasses.field(default="", kw_only=True)
    id: str | None = dataclasses.field(default=None, kw_only=True)
    """A registered Python class instead of the generic one; ``package.module:ID`` imports it."""
    physics: PhysicsTaskCfg | None = dataclasses.field(default=None, kw_only=True)
    decimation: Annotated[int, Field(ge=1)] | None = dataclasses.field(default=None, kw_only=True)
    """Sets `sim_steps_per_control` and overrides it."""
    episode_length_s: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = dataclasses.field(
        default=None, kw_only=True
    )
    """Sets `max_episode_steps` in seconds and overrides it."""
    robot: RobotCfg | None = dataclasses.field(default=None, kw_only=True)
    robots: dict[str, RobotCfg] = dataclasses.field(default_factory=dict, kw_only=True)
    objects: dict[str, RigidObjectCfg] = dataclasses.field(default_factory=dict, kw_only=True)
    articulations: dict[str, ArticulationCfg] = dataclasses.field(
        default_factory=dict, kw_only=True
    )
    lights: dict[str, LightCfg] = dataclasses.field(default_factory=dict, kw_only=True)
    scene: SceneCfg | None = dataclasses.field(default=None, kw_only=True)
    """What surrounds robots and objects; None is that of `sim_cfg`."""
    views: dict[str, ViewCfg] = dataclasses.field(default_factory=dict, kw_only=True)
    """Camera views by name; empty is those of `sim_cfg`."""
    sensors: dict[str, AnySensorCfg] = dataclasses.field(default_factory=dict, kw_only=True)
    actions: dict[str, ActionTermCfg] = dataclasses.field(default_factory=dict, kw_only=True)
    events: dict[str, EventCfg] = dataclasses.field(default_factory=dict, kw_only=True)
    commands: dict[str, CommandCfg] = dataclasses.field(default_factory=dict, kw_only=True)
    observations: dict[str, ObservationCfg] = dataclasses.field(default_factory=dict, kw_only=True)
    enable_corruption: bool | dict[str, bool] = dataclasses.field(default=True, kw_only=True)
    """Whether noise is applied to observations: for all groups, or by group (default True)."""
    rewards: dict[str, RewardCfg] = dataclasses.field(default_factory=dict, kw_only=True)
    reward_floor: Annotated[float, Field(allow_inf_nan=False)] | None = dataclasses.field(
        default=None, kw_only=True
    )
    """Smallest reward of a step, sum of all terms; None means no limit."""
    terminations: dict[str, TerminationCfg] = dataclasses.field(default_factory=dict, kw_only=True)
    metrics: dict[str, MetricCfg] = dataclasses.field(default_factory=dict, kw_only=True)
    symmetry: SymmetryCfg | None = dataclasses.field(default=None, kw_only=True)
    """The reflection under which the task does not change."""
    curriculum: dict[str, CurriculumCfg] = dataclasses.field(default_factory=dict, kw_only=True)
    expert: list[str | dict[str, Any]] | TermCfg | None = dataclasses.field(
        default=None, kw_only=True
    )
    """Steps that solve the task, for `policy: expert`; or the function that makes them."""
    extensions: dict[str, Any] = dataclasses.field(default_factory=dict, kw_only=True)
    """Values that become attributes of the environment, by name."""
    suggested: SuggestedCfg = dataclasses.field(default_factory=SuggestedCfg, kw_only=True)

    @property
    def key_sources(self) -> Any:
        """A `KeySources`: where keys were set, or None; not part of the config's values."""
        return vars(self).get("_key_sources")

    @key_sources.setter
    def key_sources(self, sources: Any) -> None:
        vars(self)["_key_sources"] = sources

    def complete(self) -> None:
        """Set fields that follow from others, in place, before an environment is built.

        The default does nothing; configs in another form, such as EmbodiChain's, convert it here.

        Raises:
            ConfigError: If the config cannot be completed.
        """
