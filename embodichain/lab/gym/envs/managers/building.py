"""`build_term`: a declared term made ready to be called, with its shapes and what it refers to."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np

from embodichain.lab.gym.envs.cfg import SceneEntityCfg, TermCfg
from embodichain.lab.gym.envs.managers.aliases import AliasSpec
from embodichain.lab.gym.envs.managers.check import CheckedTerm, check_in_task, check_term
from embodichain.lab.gym.envs.managers.references import references
from embodichain.lab.gym.envs.managers.registry import Kind, TermSpec
from embodichain.lab.gym.envs.managers.scene_entity import resolve_entity
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import EnvIndex

__all__ = ["BuiltTerm", "build_term"]

C = TypeVar("C", bound=TermCfg)
Shape = Callable[[Any], Any]


@dataclass(frozen=True, slots=True, eq=False)
class BuiltTerm(Generic[C]):
    """A declared term, ready to be called.

    Attributes:
        name: Its key in the config.
        cfg: What the config says.
        spec: The function or class behind it.
        call: Takes what the manager passes; parameters are bound.
        instance: What keeps something between calls: the object, if the term is a class.
    """

    name: str
    cfg: C
    spec: TermSpec
    call: Callable[..., Any]
    instance: Any = None


def build_term(env: TermContext, kind: Kind, name: str, cfg: C, path: str) -> BuiltTerm[C]:
    """Check a declared term and build it.

    Args:
        env: The environment; its scene is complete.
        kind: The manager that runs it.
        name: Its key in the config.
        cfg: Its declaration.
        path: Its key path.

    Raises:
        ConfigError: If it is wrong, or what it refers to does not exist; holds every mistake.
    """
    checked, problems = check_term(kind, cfg, path)
    where = f"{path}.params"
    if checked is not None:
        problems = check_in_task(checked, env.cfg, where)
    if checked is None or problems:
        raise ConfigError(problems)
    spec = checked.spec
    values, names = _resolved_values(env, checked, where), checked.names
    if isinstance(spec, AliasSpec):
        names = {**names, **{key: names.get(name, name) for key, name in spec.names.items()}}
    with _under(where, names):
        parts = spec.meaning(values, env) if isinstance(spec, AliasSpec) else [(spec, values)]
        (source, values), steps = parts[0], parts[1:]
        instance = source.func(env, **source.arguments(values)) if source.is_class else None
        shapes = [step.func(env, **step.arguments(given)) for step, given in steps]
    for step, given in checked.shapes:
        with _under(f"{path}.shape.{step.name}"):
            shapes.append(step.func(env, **step.arguments(given)))
    if source.lead is None and not shapes:
        return _plain(name, cfg, source, values, kind, instance)
    if instance is not None:
        read = instance if source.lead is None else _discarding(instance)
    else:
        read = partial(source.func, **source.arguments(values))
    lead = source.lead
    if lead is None:  # a function or class of the kind's own signature
        lead = ("obs",) if kind == "observation" else ("obs", "action", "info")
    call = _call(source.name, read, lead, shapes, kind, where)
    kept = [part for part in (instance, *shapes) if hasattr(part, "state_dict")]
    if len(kept) > 1:
        return BuiltTerm(name, cfg, spec, call, _Several(kept))
    return BuiltTerm(name, cfg, spec, call, kept[0] if kept else None)


def _plain(
    name: str, cfg: C, spec: TermSpec, values: dict[str, Any], kind: Kind, instance: Any
) -> BuiltTerm[C]:
    """A function or class with the signature of its kind."""
    if instance is None:
        arguments = spec.arguments(values)
        return BuiltTerm(name, cfg, spec, partial(spec.func, **arguments) if values else spec.func)
    method = {"action": "apply", "command": "resample"}.get(kind, "__call__")
    return BuiltTerm(name, cfg, spec, getattr(instance, method), instance)


def _discarding(instance: Callable[[], Any]) -> Callable[[Any], Any]:
    return lambda env: instance()


def _call(
    name: str,
    read: Callable[..., Any],
    lead: tuple[str, ...],
    shapes: list[Shape],
    kind: Kind,
    where: str,
) -> Callable[..., NDArray[Any]]:
    """What a manager calls: reads the quantity and shapes it.

    Args:
        name: The quantity's name, for messages.
        read: Takes the environment and what `lead` names.
        lead: Which of ``obs``, ``action`` and ``info`` it takes.
        shapes: Applied in order.
        kind: The manager; an observation of (N,) becomes (N, 1).
        where: Key path of the parameters.
    """
    at = [("obs", "action", "info").index(name) for name in lead]
    column = kind == "observation"
    shape_path = f"{where.removesuffix('.params')}.shape"

    def call(env: TermContext, *passed: Any) -> NDArray[Any]:
        try:
            value: Any = read(env, *(passed[i] for i in at)) if at else read(env)
        except ConfigError as error:
            raise _moved(error, where) from error
        if type(value) is not np.ndarray:
            value = value.numpy(force=True)
            value = value if value.dtype == np.bool_ else value.astype(np.float64)
        for shape in shapes:
            value = shape(value)
        if column and value.ndim == 1:
            value = value[:, None]
        elif value.ndim > 1 and not column:
            message = f"{name} has {value.shape[1]} columns; a {kind} is one number: try shape: l2"
            raise ConfigError([Problem(shape_path, message)])
        shaped: NDArray[Any] = value
        return shaped

    return call


class _Several:
    """Parts of a term that keep something between calls, as one."""

    def __init__(self, parts: list[Any]) -> None:
        self._parts = parts

    def reset(self, env_ids: EnvIndex | None) -> None:
        for part in self._parts:
            part.reset(env_ids)

    def state_dict(self) -> dict[str, Any]:
        return {"parts": [part.state_dict() for part in self._parts]}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        for part, kept in zip(self._parts, state["parts"], strict=True):
            part.load_state_dict(kept)


def _resolved_values(env: TermContext, checked: CheckedTerm, where: str) -> dict[str, Any]:
    """The parameters, with references replaced by what they mean."""
    hints = checked.spec.hints()
    values: dict[str, Any] = {}
    problems: list[Problem] = []
    for key, given in checked.values.items():
        path = f"{where}.{checked.names.get(key, key)}"
        try:
            value = _resolved(env, given, path)
            for reference in references(hints.get(key)) if value is not None else ():
                with _under(path):
                    value = reference.resolve(env, value)
            values[key] = value
        except ConfigError as error:
            problems += error.problems
    if problems:
        raise ConfigError(problems)
    return values


def _resolved(env: TermContext, value: Any, path: str) -> Any:
    """Replace references to entities, also within lists and maps, by what they mean."""
    if isinstance(value, SceneEntityCfg):
        return resolve_entity(env.sim, value, path)
    if isinstance(value, (list, tuple)):
        return type(value)(_resolved(env, v, f"{path}.{i}") for i, v in enumerate(value))
    if isinstance(value, dict):
        return {k: _resolved(env, v, f"{path}.{k}") for k, v in value.items()}
    return value


@contextmanager
def _under(path: str, names: Mapping[str, str] | None = None) -> Iterator[None]:
    """Put a path before those of a ConfigError that do not begin with it.

    Args:
        path: The path.
        names: Parameter -> the name that the config gives it.
    """
    try:
        yield
    except ConfigError as error:
        raise _moved(error, path, names) from error


def _moved(error: ConfigError, path: str, names: Mapping[str, str] | None = None) -> ConfigError:
    def moved(problem: Problem) -> Problem:
        if problem.path.startswith(path):
            return problem
        head, dot, rest = problem.path.partition(".")
        head = (names or {}).get(head, head)
        return Problem(f"{path}.{head}{dot}{rest}".rstrip("."), problem.message, problem.hint)

    return ConfigError(map(moved, error.problems))
