"""`EmbodiedEnvCfg`: a task declared in Python in EmbodiChain's form, with lists of entities.

`EmbodiedEnvCfg.complete` converts it like a gym config (`compat.gym_config`), with the same notes
on what is left out or changed.
"""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Mapping
from typing import Any

from embodichain.compat.gym_config.conversion import convert
from embodichain.compat.gym_config.env_cfg import FUNCTORS, checked_cfg
from embodichain.lab.gym.envs.cfg import EnvCfg, TermCfg
from embodichain.lab.gym.envs.managers.terms.registry import TERMS, Kind
from embodichain.lab.sim.cfg import ArticulationCfg, LightCfg, RigidObjectCfg, name_of
from embodichain.lab.sim.sensors.camera_cfg import CameraCfg
from embodichain.utils.configclass import configclass, is_configclass
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.fields.defaults import is_given

__all__ = ["EmbodiedEnvCfg"]

_log = logging.getLogger(__name__)
_LISTS = ("background", "rigid_object", "articulation")
"""Fields with entities in EmbodiChain's form."""
_MAPS = ("objects", "articulations", "lights")
"""Fields with entities in the form of `EnvCfg`."""
_ENV_KEYS = ("control_parts", "active_joint_ids", "filter_visual_rand", "filter_dataset_saving")
"""Fields that a gym config has in its section `env`."""
_ALWAYS = ("shape_type", "func")
"""Fields that are written even if they have their default."""


@configclass
class _EnvLightCfg:
    """Lights of a scene."""

    direct: list[LightCfg] = []
    indirect: dict[str, Any] | None = None
    """Left out: there is one background light."""


@configclass
class EmbodiedEnvCfg(EnvCfg):
    """The config of an environment in EmbodiChain's form. It has all fields of `EnvCfg`.

    `events`, `observations`, `rewards` and `actions` are a configclass with a field for each
    functor, or a map. A functor's `func` is a term's name or a function.
    """

    EnvLightCfg = _EnvLightCfg

    control_parts: list[str] | None = dataclasses.field(default=None, kw_only=True)
    """Control parts whose joints the actions move; None is every joint."""
    active_joint_ids: list[int] = dataclasses.field(default_factory=list, kw_only=True)
    sensor: list[Any] = dataclasses.field(default_factory=list, kw_only=True)
    """Sensors; observations contain the images of cameras."""
    light: _EnvLightCfg = dataclasses.field(default_factory=_EnvLightCfg, kw_only=True)
    background: list[RigidObjectCfg] = dataclasses.field(default_factory=list, kw_only=True)
    """Static or kinematic objects."""
    rigid_object: list[RigidObjectCfg] = dataclasses.field(default_factory=list, kw_only=True)
    rigid_object_group: list[Any] = dataclasses.field(default_factory=list, kw_only=True)
    """Left out: object groups are not available."""
    articulation: list[ArticulationCfg] = dataclasses.field(default_factory=list, kw_only=True)
    events: Any = dataclasses.field(default=None, kw_only=True)
    observations: Any = dataclasses.field(default=None, kw_only=True)
    rewards: Any = dataclasses.field(default=None, kw_only=True)
    actions: Any = dataclasses.field(default=None, kw_only=True)
    dataset: Any = dataclasses.field(default=None, kw_only=True)
    """Left out: a run's log becomes a data set."""
    extensions: Any = dataclasses.field(default=None, kw_only=True)
    filter_visual_rand: bool = dataclasses.field(default=False, kw_only=True)
    filter_dataset_saving: bool = dataclasses.field(default=False, kw_only=True)
    init_rollout_buffer: bool = dataclasses.field(default=False, kw_only=True)
    """No effect: a learner has its own buffer."""

    def complete(self) -> None:
        """Set the fields of `EnvCfg` from those in EmbodiChain's form; log what is left out.

        Raises:
            ConfigError: A value cannot be converted; lists every mistake.
        """
        conversion = convert(_gym_config(self), ours=True)
        try:
            declared = checked_cfg(conversion)
        except ConfigError as error:
            raise ConfigError(map(_without_env, error.problems)) from error
        for name in ("robot", "extensions", *FUNCTORS):
            setattr(self, name, getattr(declared, name))
        for name in _MAPS:
            setattr(self, name, {**getattr(declared, name), **getattr(self, name)})
        sensors = {name_of(sensor): _convert_sensor(sensor) for sensor in self.sensor}
        self.sensors = {**sensors, **self.sensors}
        for note in conversion.notes:
            _log.warning("%s", _without_env(note))


def _convert_sensor(cfg: Any) -> Any:
    """Return a sensor as EmbodiChain has it: observed, and with its axes of cameras."""
    if not isinstance(cfg, CameraCfg):
        return cfg
    if cfg.camera is not None:  # it has the pose of that camera
        return dataclasses.replace(cfg, observe=True)
    convention = cfg.convention
    if not convention:
        is_attached = cfg.extrinsics.parent or cfg.of.uid
        convention = "opengl" if is_attached else "ros"
    return dataclasses.replace(cfg, observe=True, convention=convention)


def _gym_config(cfg: EmbodiedEnvCfg) -> dict[str, Any]:
    """The content of an equivalent gym config, with the values that differ from a default."""
    env: dict[str, Any] = {key: getattr(cfg, key) for key in _ENV_KEYS if getattr(cfg, key)}
    env["extensions"] = cfg.extensions or {}
    if cfg.dataset is not None:
        env["dataset"] = {"recorder": None}  # its content is not used
    for section, kind in FUNCTORS.items():
        functors = _functors_by_name(getattr(cfg, section))
        env[section] = {name: _functor(functor, kind) for name, functor in functors.items()}
    config: dict[str, Any] = {key: _plain(getattr(cfg, key)) for key in _LISTS}
    if cfg.rigid_object_group:
        config["rigid_object_group"] = cfg.rigid_object_group
    if cfg.robot is not None:
        config["robot"] = _plain(cfg.robot)
    return {**config, "light": _plain(cfg.light), "env": env}


def _functors_by_name(section: Any) -> dict[str, Any]:
    """The functors of a section: of a map, or the public attributes of an object."""
    if section is None:
        return {}
    if isinstance(section, Mapping):
        values: Mapping[str, Any] = section
    elif is_configclass(section):
        names = [field.name for field in dataclasses.fields(section)]
        values = {name: getattr(section, name) for name in names}
    else:
        names = [name for name in dir(section) if not name.startswith("_")]
        values = {name: getattr(section, name) for name in names}
    return {str(name): value for name, value in values.items() if value is not None}


def _functor(functor: Any, kind: Kind) -> Any:
    """A functor as a map, with the name of its term if it is one."""
    plain = _plain(functor)
    if not isinstance(functor, TermCfg):
        return plain
    if kind == "observation":
        plain["mode"] = getattr(functor, "mode", "modify")  # a file has another default
    func = functor.func
    if callable(func):
        registered = next((name for name, spec in TERMS[kind].items() if spec.func is func), None)
        plain["func"] = registered or func
        if registered is None and functor.params:
            plain["params"] = functor.params  # a user's function gets a `SceneEntityCfg` unchanged
    return plain


def _plain(value: Any) -> Any:
    """A config as a map of non-default values; a user's class has the fields of its base here."""
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, type) or not is_configclass(value):
        return value
    base = next(cls for cls in type(value).__mro__ if cls.__module__.startswith("embodichain."))
    values: dict[str, Any] = {}
    for field in dataclasses.fields(base):
        field_value = getattr(value, field.name)
        if field.name in _ALWAYS or not _is_equal(field_value, _default(field)):
            values[field.name] = _plain(field_value)
    return values


def _default(field: dataclasses.Field[Any]) -> Any:
    if field.default_factory is not dataclasses.MISSING:
        return field.default_factory()
    return field.default


def _is_equal(value: Any, default: Any) -> bool:
    """Whether two values are equal; False for arrays, whose comparison is not one bool.

    A number that a user wrote differs from an equal default that is marked as a default.
    """
    if value is default:
        return True
    if is_given(value) != is_given(default):
        return False
    return not hasattr(value, "shape") and bool(_plain(value) == _plain(default))


def _without_env(problem: Problem) -> Problem:
    """A problem whose path is that of the field: a gym config has it below `env`."""
    return Problem(problem.path.removeprefix("env."), problem.message, problem.hint)
