"""Checking and applying the action given to `step`: `ActionCheck`, `ActionManager`.

Each action term receives its slice; `drive_robot` moves a robot without action terms. Noise and
delay are in `pipeline.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
import torch
from numpy.typing import NDArray

from embodichain.lab.gym.envs.cfg import ActionTermCfg, SceneEntityCfg
from embodichain.lab.gym.envs.managers.manager import BuiltTerm, Manager
from embodichain.lab.gym.envs.managers.pipeline import ActionPipeline
from embodichain.lab.gym.envs.managers.term import ActionTerm, finite_limits
from embodichain.lab.gym.envs.managers.terms.term_columns import TermColumns
from embodichain.lab.gym.envs.managers.terms.term_errors import FAILURES
from embodichain.utils.arrays import all_finite, is_host, tensor_of
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.tensor_mapping import leaves_of

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.managers.context import TermContext
    from embodichain.lab.sim.engine.api import EnvIndex
    from embodichain.lab.sim.objects.robot import Robot
    from embodichain.lab.sim.types import EnvAction
    from embodichain.utils.array_types import Floats
    from embodichain.utils.arrays import Arrays

__all__ = [
    "ActionCheck",
    "ActionManager",
    "ActionTerm",
    "action_space",
    "default_actions",
    "drive_robot",
    "is_passive",
    "no_action",
]


def action_space(
    robot: Robot | None, joint_ids: Sequence[int], manager: ActionManager
) -> gym.spaces.Box:
    """Return the action space of one environment: that of action terms, or joint positions.

    Bounds are finite, for joints without limits too.
    """
    if len(manager):
        return gym.spaces.Box(manager.low, manager.high, dtype=np.float32)
    if robot is None:
        return no_action()
    low, high = finite_limits(robot.parsed.qpos_limits, joint_ids)
    return gym.spaces.Box(low.astype(np.float32), high.astype(np.float32))


def no_action() -> gym.spaces.Box:
    """Return the action space of an environment in which nothing is driven: shape (0,)."""
    return gym.spaces.Box(0.0, 0.0, (0,), np.float32)


def is_passive(robot: Robot | None) -> bool:
    """Whether a robot has neither drives nor actuators: it is moved by physics alone."""
    return robot is not None and not robot.parsed.control_names


def default_actions(robot: Robot | None) -> dict[str, ActionTermCfg]:
    """Return the action term of an MJCF robot with actuators in its file; else an empty dict."""
    if robot is None:
        return {}
    parsed = robot.parsed
    has_passive_joint = any(not parsed.drives[i] for i in robot.active_joint_ids)
    if parsed.own_actuators or (has_passive_joint and parsed.control_names):
        params = {"of": SceneEntityCfg(uid=robot.uid)}
        return {"ctrl": ActionTermCfg(func="actuator_ctrl", params=params)}
    return {}


class ActionCheck:
    """Checks actions against a space, before anything is written.

    Args:
        space: Action space of one environment; shapes are checked if it is a Box.
        num_envs: N.
        arrays: Where actions must be.
    """

    def __init__(self, space: gym.Space[Any], num_envs: int, arrays: Arrays) -> None:
        self._shape: tuple[int, ...] | None = None
        if isinstance(space, gym.spaces.Box):
            self._shape = (num_envs, *(space.shape or ()))
        self._num_envs = num_envs
        self._arrays = arrays

    def __call__(self, action: Any) -> tuple[EnvAction, Floats]:
        """Check an action.

        Args:
            action: (N, A) floating tensor on the device, or a numpy array (converted to a float32
                tensor), or a mapping of such tensors (such as a TensorDict).

        Returns:
            The action, and its numbers as (N, A) float64 that share no memory with it.

        Raises:
            TypeError: If it is not a floating tensor, array or mapping.
            ConfigError: If it is a mapping, and arrays are on a device.
            ValueError: If its shape or device is wrong or a number is not finite; on a device
                numbers are not checked, and an environment with such an action diverges.
        """
        if isinstance(action, np.ndarray) and self._arrays.on_device:
            action = tensor_of(self._arrays.put(action))
        tensor: torch.Tensor | None = None
        if isinstance(action, np.ndarray):
            numbers = action
            if action.dtype.kind == "f":
                tensor = torch.from_numpy(action.astype(np.float32))
        elif isinstance(action, torch.Tensor):
            if action.device != self._arrays.device:
                raise ValueError(
                    f"action is on {action.device}; this environment is on {self._arrays.device}"
                )
            tensor = action.detach() if action.requires_grad else action
            numbers = self._arrays.of(tensor)
        elif isinstance(action, Mapping):
            self._arrays.require_host("actions that are mappings")
            return action, self._require_finite(self._joined(action))
        else:
            kind = type(action).__name__
            raise TypeError(f"an action is a tensor {self._allowed_shape()}, got {kind}")
        if tensor is None or numbers.dtype.kind != "f":
            raise TypeError(
                f"an action is a floating point tensor {self._allowed_shape()}, got {action.dtype}"
            )
        shape = numbers.shape
        if shape != self._shape and (self._shape is not None or shape[:1] != (self._num_envs,)):
            raise ValueError(f"action must have shape {self._allowed_shape()}, got {shape}")
        values: Floats = numbers.astype(np.float64)
        if values.ndim != 2:
            values = values.reshape(len(values), -1)
        return tensor, self._require_finite(values)

    def _allowed_shape(self) -> str:
        return f"({self._num_envs}, ...)" if self._shape is None else f"{self._shape}"

    def _joined(self, action: Mapping[str, Any]) -> Floats:
        """(N, A) the numbers of a mapping, entry by entry."""
        leaves = [leaf.detach().cpu().numpy() for _, leaf in leaves_of(action)]
        if not leaves:
            raise ValueError("the action is an empty mapping")
        for leaf in leaves:
            if leaf.shape[:1] != (self._num_envs,):
                raise ValueError(
                    f"action must have batch size ({self._num_envs},), got {leaf.shape[:1]}"
                )
        rows: list[NDArray[Any]] = [leaf.reshape(self._num_envs, -1) for leaf in leaves]
        return np.concatenate(rows, axis=1).astype(np.float64)

    @staticmethod
    def _require_finite(values: Floats) -> Floats:
        """Return the values, if all are finite."""
        if is_host(values) and not all_finite(values):
            rows = np.flatnonzero(~np.isfinite(values).all(axis=1))
            raise ValueError(f"action is not finite in environments {rows[:8].tolist()}")
        return values


def drive_robot(
    robot: Robot | None, joint_ids: list[int], action: EnvAction, seconds: float
) -> None:
    """Give a robot absolute joint targets.

    Args:
        robot: The robot; None does nothing.
        joint_ids: The A joints to move.
        action: (N, A) position targets, clamped to the joints' limits and to the change that
            `max_velocity` of the drives allows, or a mapping with any of ``qpos``, ``qvel``
            (velocity targets) and ``qf`` (efforts), each (N, A).
        seconds: The period of a control step.

    Raises:
        ValueError: If a shape or a key is wrong.
    """
    if robot is None:
        return
    joints = np.asarray(joint_ids, np.int64)
    drives = robot.drives

    def set_position_targets(target: torch.Tensor, joint_ids: list[int]) -> None:
        qpos = drives.within_rate(np.asarray(target, np.float64), joints, seconds)
        robot.set_qpos(qpos, joint_ids=joint_ids)

    def set_velocity_targets(target: torch.Tensor, joint_ids: list[int]) -> None:
        limit = drives.max_velocity[:, joints]
        qvel = np.clip(np.asarray(target, np.float64), -limit, limit)
        robot.set_qvel(qvel, joint_ids=joint_ids)

    if isinstance(action, torch.Tensor):
        set_position_targets(action, joint_ids)
        return
    setters: dict[Any, Any] = {
        "qpos": set_position_targets,
        "qvel": set_velocity_targets,
        "qf": robot.set_qf,
    }
    unknown = [key for key in action.keys() if key not in setters]  # noqa: SIM118  (it may be a TensorDict)
    if unknown:
        raise ValueError(f"unknown action entries {unknown}; allowed: {', '.join(setters)}")
    for key, value in action.items():
        setters[key](value, joint_ids=joint_ids)


class ActionManager(Manager[ActionTermCfg]):
    """Terms that own consecutive slices of the action, in declared order.

    Metrics of terms are those of the present step: ``info["metrics"]["TERM/METRIC"]``.

    Args:
        env: The environment; its scene is complete.
        cfgs: Name -> action term.

    Attributes:
        action_dim: Width of the whole action.
        low: (A,) float32 lower bounds of the action.
        high: (A,) float32 upper bounds.
        slices: Name -> columns.

    Raises:
        ConfigError: If a term is wrong, or its bounds are not finite and ordered.
    """

    def __init__(self, env: TermContext, cfgs: Mapping[str, ActionTermCfg]) -> None:
        self.slices: dict[str, slice] = {}
        self._pipelines: dict[str, ActionPipeline] = {}
        super().__init__(env, "actions", "action", cfgs)

    def _bind(self) -> None:
        was_bound = bool(self.slices)
        self.slices = {}
        start = 0
        lows: list[NDArray[np.float32]] = [np.zeros(0, np.float32)]
        highs: list[NDArray[np.float32]] = [np.zeros(0, np.float32)]
        for name, term in self.terms.items():
            low, high = _bounds_of(name, term)
            self.slices[name] = slice(start, start + len(low))
            start += len(low)
            lows.append(low)
            highs.append(high)
        low = np.concatenate(lows)
        high = np.concatenate(highs)
        if was_bound and not (np.array_equal(low, self.low) and np.array_equal(high, self.high)):
            raise ConfigError([Problem("actions", "the action space cannot change while it runs")])
        self.action_dim = start
        self.low: NDArray[np.float32] = low
        self.high: NDArray[np.float32] = high
        self._calls = [
            (name, self._receiver(name, term), self.slices[name])
            for name, term in self.terms.items()
        ]
        self._measured = [
            (name, term.instance.metrics)
            for name, term in self.terms.items()
            if _overrides(term, "metrics")
        ]
        self._before_physics = [
            term.instance.before_physics
            for term in self.terms.values()
            if _overrides(term, "before_physics")
        ]

    def _receiver(self, name: str, term: BuiltTerm[ActionTermCfg]) -> Callable[..., Any]:
        """Return the function that receives a term's slice: the term, or its delay and noise."""
        call = term.call
        cfg = term.cfg
        if cfg.delay == 0 and cfg.noise is None:
            return call
        # A term that is rebuilt keeps its delayed actions.
        pipeline = self._pipelines.get(name)
        if pipeline is None:
            columns = TermColumns(self._columns(term), term.instance.named_by, "joint")
            pipeline = ActionPipeline(name, cfg, columns, self.env.streams, self._arrays)
            self._pipelines[name] = pipeline
        pipeline.hold = term.instance.hold
        return lambda action: call(pipeline(action))

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Reset terms and delays of these environments; (n,), or None for all."""
        super().reset(env_ids)
        for name, pipeline in self._pipelines.items():
            delays = pipeline.reset(env_ids)
            if delays is not None and self.env.observers:
                self.env.log_event(f"actions.{name}", "delay", env_ids, {"delay": delays})

    def state_dict(self) -> dict[str, Any]:
        """State of terms, and delayed actions (copies)."""
        pipelines = {name: pipeline.state_dict() for name, pipeline in self._pipelines.items()}
        return {**super().state_dict(), "pipelines": pipelines}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        super().load_state_dict(state)
        for name, pipeline in self._pipelines.items():
            pipeline.load_state_dict(state["pipelines"][name])

    @property
    def names(self) -> tuple[str, ...]:
        """Name of each column of the action: ``TERM/JOINT``."""
        names: list[str] = []
        for name, term in self.terms.items():
            names += [f"{name}/{column}" for column in self._columns(term)]
        return tuple(names)

    def columns_of(self, name: str) -> tuple[str, ...]:
        """Name of each column of a term's slice, or its number."""
        return self._columns(self.terms[name])

    @staticmethod
    def _columns(term: BuiltTerm[ActionTermCfg]) -> tuple[str, ...]:
        """Name of each column of a term's slice, or its number."""
        if term.instance.names:
            return term.instance.names
        return tuple(str(i) for i in range(term.instance.action_dim))

    def centre_and_scale(self) -> tuple[list[float | str], list[float | str]]:
        """Centre and scale of each column of the action; see `ActionTerm.centre_and_scale`."""
        centres: list[float | str] = []
        scales: list[float | str] = []
        for term in self.terms.values():
            centre, scale = term.instance.centre_and_scale()
            centres += centre
            scales += scale
        return centres, scales

    def apply(self, action: torch.Tensor) -> None:
        """Apply every term to its slice of the action.

        Args:
            action: (N, A) float32, finite (checked by the environment).
        """
        is_only_term = len(self._calls) == 1
        for name, call, columns in self._calls:
            try:
                call(action if is_only_term else action[:, columns])
            except FAILURES as error:
                self.fail(name, error)

    @property
    def acts_in_physics(self) -> bool:
        """Whether a term acts before every physics step."""
        return bool(self._before_physics)

    def act_in_physics(self) -> None:
        """Let the terms act that act before every physics step."""
        for act in self._before_physics:
            act()

    @property
    def has_metrics(self) -> bool:
        """Whether a term measures how its action was applied."""
        return bool(self._measured)

    def report(self, metrics: dict[str, NDArray[Any]]) -> None:
        """Add the metrics of the last action.

        Args:
            metrics: Gains ``TERM/METRIC`` -> (N,) float32.
        """
        for name, measure in self._measured:
            for key, values in measure().items():
                metrics[f"{name}/{key}"] = values.astype(np.float32)

    def home(self) -> NDArray[np.float64]:
        """(A,) the action that goes to the initial state."""
        parts = [term.instance.home() for term in self.terms.values()]
        return np.concatenate([np.zeros(0), *parts])

    def hold(self) -> NDArray[np.float64]:
        """(N, A) the action that keeps the present targets."""
        action: Floats = self._arrays.full((self.num_envs, self.action_dim), 0.0)
        for name, term in self.terms.items():
            action[:, self.slices[name]] = term.instance.hold()
        return action


def _overrides(term: BuiltTerm[ActionTermCfg], name: str) -> bool:
    """Whether a term's class overrides a method of `ActionTerm`; it need not be a subclass."""
    default = getattr(ActionTerm, name)
    return getattr(type(term.instance), name, default) is not default


def _bounds_of(
    name: str, term: BuiltTerm[ActionTermCfg]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(A,) low and high of a term.

    Raises:
        ConfigError: If there are none, or they are neither finite and ordered nor infinite.
    """
    instance = term.instance
    if not hasattr(instance, "low") or not hasattr(instance, "high"):
        message = f"{term.spec.label} must set low and high"
        raise ConfigError([Problem(f"actions.{name}.func", message)])
    low = np.asarray(instance.low, np.float32)
    high = np.asarray(instance.high, np.float32)
    shape = (int(instance.action_dim),)
    is_bounded = np.isfinite(low) & np.isfinite(high)
    is_unbounded = np.isneginf(low) & np.isposinf(high)
    are_valid = (is_bounded | is_unbounded).all() and (low < high).all()
    if low.shape != shape or high.shape != shape or not are_valid:
        message = f"needs finite bounds low < high of shape {shape}, got {low}, {high}"
        raise ConfigError([Problem(f"actions.{name}", message)])
    return low, high
