"""`Manager`: builds the terms of one section, and resets and saves those with state.

`build_term` builds one declared term. `CurriculumManager` is the simplest manager.
"""

from __future__ import annotations

import copy
import inspect
import logging
import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Generic, NoReturn, TypeVar, cast

import numpy as np

from embodichain.lab.gym.envs.cfg import CurriculumCfg, SceneEntityCfg, TermCfg
from embodichain.lab.gym.envs.managers.param_types import references
from embodichain.lab.gym.envs.managers.scene_entity import resolve_entity
from embodichain.lab.gym.envs.managers.terms.aliases import AliasSpec
from embodichain.lab.gym.envs.managers.terms.check import CheckedTerm, check_in_task, check_term
from embodichain.lab.gym.envs.managers.terms.per_name import ranges_in_columns
from embodichain.lab.gym.envs.managers.terms.registry import REDUCERS, Kind, TermSpec
from embodichain.lab.gym.envs.managers.terms.term_columns import TermColumns, columns_of_term
from embodichain.lab.gym.envs.managers.terms.term_errors import (
    FAILURES,
    TermError,
    counted,
    declared_at,
    failed_term,
    finite_physics,
    kind_of_values,
    present_step,
    warn_not_finite,
)
from embodichain.utils.arrays import all_finite, is_host
from embodichain.utils.errors import ConfigError, EmbodichainError, Problem
from embodichain.utils.named import Named
from embodichain.utils.short_repr import short_repr
from embodichain.utils.suggest import did_you_mean

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.managers.context import TermContext
    from embodichain.lab.sim.engine.api import EnvIndex
    from embodichain.utils.arrays import Arrays

__all__ = [
    "BuiltTerm",
    "CurriculumManager",
    "Manager",
    "build_term",
    "checked_rows",
]

_log = logging.getLogger(__name__)
C = TypeVar("C", bound=TermCfg)
Shape = Callable[[Any], Any]


@dataclass(frozen=True, slots=True, eq=False)
class BuiltTerm(Generic[C]):
    """A declared term, ready to be called.

    Attributes:
        name: Its key in the config.
        cfg: Its declaration.
        spec: The function or class that its declaration names; of an alias, the alias.
        call: The function that the manager calls, with parameters bound.
        instance: The object with the term's state, if the term is a class, of whatever base.
        columns: The names of the columns of its value, before shapes.
    """

    name: str
    cfg: C
    spec: TermSpec
    call: Callable[..., Any]
    instance: Any = None
    columns: TermColumns = TermColumns()

    @property
    def takes_obs(self) -> bool:
        """Whether it takes the observation, as a reward, termination or metric."""
        lead = self.spec.lead
        if lead is not None:
            return "obs" in lead
        return getattr(self.instance, "takes_obs", True)

    @property
    def takes_info(self) -> bool:
        """Whether it takes ``info``, as a reward, termination or metric."""
        lead = self.spec.lead
        if lead is not None:
            return "info" in lead
        return getattr(self.instance, "takes_info", True)


def build_term(env: TermContext, kind: Kind, name: str, cfg: C, path: str) -> BuiltTerm[C]:
    """Check a declared term and build it.

    Args:
        env: The environment; its scene is complete.
        kind: The manager that runs it.
        name: Its key in the config.
        cfg: Its declaration.
        path: Its key path.

    Raises:
        ConfigError: If it is wrong or refers to something that does not exist; lists all mistakes.
    """
    checked, problems = check_term(kind, cfg, path)
    params_path = f"{path}.params"
    if checked is not None:
        problems = check_in_task(checked, env.cfg, params_path)
    if checked is None or problems:
        raise ConfigError(problems)
    spec = checked.spec
    values = _values_in_scene(env, checked, params_path)
    columns = columns_of_term(env, checked.values, values, spec.hints())

    with _under(params_path, _names_in_config(checked)):
        # What is called: the term, or what its name stands for, which may have shapes of its own.
        called = spec
        shapes_of_alias: list[tuple[TermSpec, dict[str, Any]]] = []
        if isinstance(spec, AliasSpec):
            (called, values), *shapes_of_alias = spec.meaning(values, env)
        instance: Any = None
        if called.is_class:
            instance = called.func(env, **called.arguments(values))
        shapes: list[Shape] = [
            shape.func(env, **shape.arguments(params)) for shape, params in shapes_of_alias
        ]
    for shape, params in checked.shapes:
        with _under(f"{path}.shape.{shape.name}"):
            params = _in_columns_of_term(params, columns)
            shapes.append(shape.func(env, **shape.arguments(params)))
    state: Any
    if called.lead is None and not shapes:
        call = _direct_call(called, values, kind, instance)
        state = instance
    else:
        call = _shaped_call(
            _reader(env, called, values, instance),
            shapes,
            name=called.name,
            lead=_lead_of(called, kind),
            kind=kind,
            path=path,
            columns=_axes_of(called, values) or columns,
        )
        state = _state_of([instance, *shapes])
    return BuiltTerm(name=name, cfg=cfg, spec=spec, call=call, instance=state, columns=columns)


def _names_in_config(checked: CheckedTerm) -> dict[str, str]:
    """Return the parameters of what a term calls -> the names that the config writes.

    An alias calls another term, whose parameters have names of their own.
    """
    spec = checked.spec
    if not isinstance(spec, AliasSpec):
        return checked.names
    of_target = {key: checked.names.get(name, name) for key, name in spec.names.items()}
    in_python = {
        name: of_target[key] for name, key in spec.target.python_names().items() if key in of_target
    }
    return {**checked.names, **in_python, **of_target}


def _lead_of(called: TermSpec, kind: Kind) -> tuple[str, ...]:
    """Return which of ``obs``, ``action`` and ``info`` a quantity takes."""
    if called.lead is not None:
        return called.lead
    # A function or class with the signature of its kind.
    return ("obs",) if kind == "observation" else ("obs", "action", "info")


def _axes_of(called: TermSpec, values: Mapping[str, Any]) -> str:
    """Return the letters of the axes that a quantity reads; empty if it has no such parameter."""
    default = called.params["axes"].default if "axes" in called.params else ""
    return str(values.get("axes", default))


def _reader(
    env: TermContext, called: TermSpec, values: dict[str, Any], instance: Any
) -> Callable[..., Any]:
    """Return the function that reads a quantity, of which of obs, action and info it takes."""
    if instance is None:
        arguments = called.arguments(values)
        if called.lead != ():
            return partial(called.func, env, **arguments)
        # Arguments by position: a `partial` with keywords makes a dict at every call.
        signature = inspect.signature(called.func, follow_wrapped=False)
        bound = signature.bind(env, **arguments)
        bound.apply_defaults()
        return partial(called.func, *bound.args, **bound.kwargs)
    if called.lead is None:
        return partial(instance, env)
    return cast("Callable[..., Any]", instance)  # it received the environment when it was made


def _state_of(parts: list[Any]) -> Any:
    """Return the parts of a term that have a state, as one object; None if there is none."""
    stateful = [part for part in parts if hasattr(part, "state_dict")]
    if not stateful:
        return None
    return stateful[0] if len(stateful) == 1 else _Several(stateful)


def _in_columns_of_term(params: Mapping[str, Any], columns: TermColumns) -> dict[str, Any]:
    """Return parameters of a shape in the order of the columns: bounds of each, number of one."""
    values = dict(params)
    which = values.get("which")
    if isinstance(which, str):
        if which not in columns.names:
            names = ", ".join(columns.names) or "none"
            message = (
                f"no column is called {which!r}; names of columns: {names}; or give its number"
            )
            hint = did_you_mean(which, columns.names).strip()
            raise ConfigError([Problem("which", message, hint)])
        values["which"] = columns.names.index(which)
    bounds = values.get("bounds")
    is_map = isinstance(bounds, Mapping)
    has_list_per_end = isinstance(bounds, (list, tuple)) and any(
        isinstance(bound, list) for bound in bounds
    )
    if is_map and not columns.names:
        message = "the columns have no names that a map could give: write [low, high]"
        raise ConfigError([Problem("bounds", message)])
    if is_map or (has_list_per_end and columns.named_by):
        ends = ranges_in_columns(bounds, columns.names, "bounds", columns.named_by, columns.what)
        values["bounds"] = [end.tolist() for end in ends]
    return values


def _direct_call(
    spec: TermSpec, values: dict[str, Any], kind: Kind, instance: Any
) -> Callable[..., Any]:
    """Return what a manager calls of a function or class with the signature of its kind."""
    if instance is not None:
        method = {"action": "apply", "command": "resample"}.get(kind, "__call__")
        return getattr(instance, method)
    if not values:
        return spec.func
    return partial(spec.func, **spec.arguments(values))


def _shaped_call(
    read: Callable[..., Any],
    shapes: list[Shape],
    *,
    name: str,
    lead: tuple[str, ...],
    kind: Kind,
    path: str,
    columns: str | TermColumns,
) -> Callable[..., NDArray[Any]]:
    """Return the function that a manager calls: it reads the quantity and applies the shapes.

    For other kinds than an observation, a value of one column is that column, with its sign.

    Args:
        read: The quantity: takes the arguments in `lead`.
        shapes: Applied in order.
        name: The quantity's name, for messages.
        lead: Which of ``obs``, ``action`` and ``info`` it takes.
        kind: The manager; an observation of (N,) becomes (N, 1).
        path: Key path of the term.
        columns: The names of the quantity's columns, or the letters of its axes.
    """
    positions = [("obs", "action", "info").index(argument) for argument in lead]
    is_observation = kind == "observation"
    params_path = f"{path}.params"
    shape_path = f"{path}.shape"

    def call(env: TermContext, *passed: Any) -> NDArray[Any]:
        try:
            value: Any = read(*[passed[i] for i in positions]) if positions else read()
        except ConfigError as error:
            raise _moved(error, params_path) from error
        if type(value) is not np.ndarray and is_host(value):
            value = env.arrays.of(value)
            if value.dtype != np.bool_:
                value = value.astype(np.float64)
        try:
            for shape in shapes:
                value = shape(value)
        except ConfigError as error:
            raise _moved(error, shape_path) from error
        if value.ndim == 1:
            return value[:, None] if is_observation else value
        if is_observation:
            return value
        if value.shape[1:] != (1,):
            raise ConfigError([_several_columns(name, value, kind, shape_path, columns)])
        return value[:, 0]

    return call


def _several_columns(
    name: str, value: Any, kind: Kind, path: str, columns: str | TermColumns
) -> Problem:
    """Return the mistake that a quantity has several columns where one number is needed."""
    count = value[0].size if is_host(value) else int(np.prod(value.shape[1:]))
    if isinstance(columns, str):
        labels = list(columns)
        selection = "params: {axes: x}, y or z"
    else:
        labels = columns.labels(count)
        selection = "shape: {column: 0}"
    hint = f"Reduce them by a shape ({', '.join(REDUCERS)}), or take one with its sign: {selection}"
    if len(labels) == count and len(set(labels)) > 1:
        hint = f"They are {', '.join(labels)}. {hint}"
    return Problem(path, f"{name} has {count} columns; a {kind} is one number", hint)


class _Several:
    """The stateful parts of a term as one object."""

    def __init__(self, parts: list[Any]) -> None:
        self._parts = parts

    def reset(self, env_ids: EnvIndex | None) -> None:
        for part in self._parts:
            part.reset(env_ids)

    def state_dict(self) -> dict[str, Any]:
        return {"parts": [part.state_dict() for part in self._parts]}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        for part, part_state in zip(self._parts, state["parts"], strict=True):
            part.load_state_dict(part_state)


def _values_in_scene(env: TermContext, checked: CheckedTerm, where: str) -> dict[str, Any]:
    """Return the parameters, with references replaced by the objects they refer to."""
    hints = checked.spec.hints()
    values: dict[str, Any] = {}
    problems: list[Problem] = []
    for key, declared in checked.values.items():
        path = f"{where}.{checked.names.get(key, key)}"
        try:
            value = _in_scene(env, declared, path)
            if value is not None:
                for reference in references(hints.get(key)):
                    with _under(path):
                        value = reference.resolve(env, value)
            values[key] = value
        except ConfigError as error:
            problems += error.problems
    if problems:
        raise ConfigError(problems)
    return values


def _in_scene(env: TermContext, value: Any, path: str) -> Any:
    """Replace references to entities by `ResolvedEntity`, within lists and maps too."""
    if isinstance(value, SceneEntityCfg):
        return resolve_entity(env.sim, value, path)
    if isinstance(value, (list, tuple)):
        return type(value)(_in_scene(env, part, f"{path}.{i}") for i, part in enumerate(value))
    if isinstance(value, dict):
        return {key: _in_scene(env, part, f"{path}.{key}") for key, part in value.items()}
    return value


@contextmanager
def _under(path: str, names: Mapping[str, str] | None = None) -> Iterator[None]:
    """Prefix the key paths of a ConfigError that do not begin with a path.

    Args:
        path: The path.
        names: Parameter -> the name that the config gives it.
    """
    try:
        yield
    except ConfigError as error:
        raise _moved(error, path, names) from error


def _moved(error: ConfigError, path: str, names: Mapping[str, str] | None = None) -> ConfigError:
    """Return the error with key paths below a path; see `_under`."""

    def moved(problem: Problem) -> Problem:
        if problem.path.startswith(path):
            return problem
        inner, dot, rest = problem.path.partition(".")
        head = (names or {}).get(inner, inner)
        hint = problem.hint
        if inner:  # a hint may show the parameter as it is written
            hint = hint.replace(f"{inner}: {{", f"{head}: {{")
        return Problem(f"{path}.{head}{dot}{rest}".rstrip("."), problem.message, hint)

    return ConfigError(map(moved, error.problems))


class Manager(Generic[C]):
    """Terms of one kind, built once in declared order.

    Args:
        env: The environment; its scene is complete.
        section: The section of the task, for messages.
        kind: The kind of its terms.
        cfgs: Name -> declaration.

    Raises:
        ConfigError: If a term or an entity that it refers to does not exist, or a parameter is
            wrong; lists the mistakes of all terms.

    Attributes:
        revision: Number of changes of parameters and weights so far.
        takes_obs: Whether a reward, termination or metric takes the observation.
        takes_info: Whether one takes ``info``.
    """

    def __init__(self, env: TermContext, section: str, kind: Kind, cfgs: Mapping[str, C]) -> None:
        self.env = env
        self.num_envs = env.num_envs
        self._arrays: Arrays = env.arrays
        self.section = section
        self._kind: Kind = kind
        self.revision = 0
        self._declared = dict(cfgs)
        self._changed: dict[str, dict[str, Any]] = {}
        self._warning_counts: dict[str, int] = {}
        problems: list[Problem] = []
        self.terms: dict[str, BuiltTerm[C]] = Named(kind)
        for name, cfg in cfgs.items():
            try:
                self.terms[name] = build_term(env, kind, name, cfg, path=f"{section}.{name}")
            except ConfigError as error:
                problems += error.problems
            except FAILURES as error:
                self.fail(name, error)
        if problems:
            raise ConfigError(problems)
        self._collect()

    def __repr__(self) -> str:
        """Return class, section, N and the names of the terms, in one line."""
        return short_repr(self, self.section, num_envs=self.num_envs, terms=list(self.terms))

    def _renew(self, name: str) -> None:
        """Build a term anew: without a state, as at the start of an episode."""
        old = self.terms[name]
        path = f"{self.section}.{name}"
        term = build_term(self.env, self._kind, name, old.cfg, path=path)
        if hasattr(term.instance, "reset"):
            term.instance.reset(None)
        self.terms[name] = term
        self._collect()

    def _collect(self) -> None:
        """List the resets and states of all terms, then `_bind`; repeated when one is rebuilt."""
        self.takes_obs = any(term.takes_obs for term in self.terms.values())
        self.takes_info = any(term.takes_info for term in self.terms.values())
        self._resets: list[tuple[str, Callable[[EnvIndex | None], None]]] = []
        self._stateful: dict[str, Any] = {}
        for name, term in self.terms.items():
            if hasattr(term.instance, "reset"):
                self._resets.append((name, term.instance.reset))
            if hasattr(term.instance, "state_dict"):
                self._stateful[name] = term.instance
        self._bind()

    def _bind(self) -> None:
        """Prepare what a subclass calls of its terms; the default does nothing."""

    def params(self, name: str) -> dict[str, Any]:
        """The current parameters of a term (a deep copy), as written in a config."""
        return copy.deepcopy(self.terms[name].cfg.params)

    def set_params(self, name: str, params: dict[str, Any], shape: Any = None) -> None:
        """Rebuild a term with other parameters; its state is carried over.

        Args:
            name: The term.
            params: All its parameters, as written in a config.
            shape: Its shapes, the same ones with other parameters; None keeps them.

        Raises:
            ConfigError: If they are wrong; the term is then not changed.
        """
        old = self.terms[name]
        changes: dict[str, Any] = {"params": params}
        if shape is not None:
            changes["shape"] = shape
        cfg = copy.copy(old.cfg)
        vars(cfg).update(changes)
        path = f"{self.section}.{name}"
        term = build_term(self.env, self._kind, name, cfg, path=path)
        if old.instance is not None and hasattr(old.instance, "state_dict"):
            term.instance.load_state_dict(old.instance.state_dict())
        self.terms[name] = term
        self.revision += 1
        self._changed[name] = copy.deepcopy(self._changed.get(name, {}) | changes)
        self._collect()

    def __len__(self) -> int:
        return len(self.terms)

    @contextmanager
    def _failing(self, name: str, env_ids: Any = None) -> Iterator[None]:
        """Name the term in what is raised inside the context; see `fail`."""
        try:
            yield
        except FAILURES as error:
            self.fail(name, error, env_ids)

    def fail(self, name: str, error: BaseException, env_ids: Any = None) -> NoReturn:
        """Raise the error of a term that raised an exception; see `failed`.

        What this package raises for another reason than a wrong config, such as that nothing can be
        drawn here, stays what it is.
        """
        if isinstance(error, EmbodichainError) and not isinstance(error, (ConfigError, TermError)):
            error.add_note(f"in {declared_at(self.env, f'{self.section}.{name}')}")
            raise error
        raise self.failed(name, error, env_ids) from error

    def failed(self, name: str, error: BaseException, env_ids: Any = None) -> Exception:
        """Return the error to raise, from this one, where a term raised an exception.

        Args:
            name: The term.
            error: What it raised.
            env_ids: (n,) environments for which it was called, or None for all.
        """
        if name in self.terms:
            place = self.terms[name].spec.place
        else:  # it raised while it was built
            place = str(self._declared[name].func)
        return failed_term(self.env, f"{self.section}.{name}", place, error, env_ids)

    def _warn_not_finite(self, name: str, values: Any, what: str) -> None:
        """Log that a term's values (N,) are not finite; see `warn_not_finite`.

        Those of an environment whose physics has diverged are not the term's mistake.
        """
        if not is_host(values) or all_finite(values):
            return
        path = f"{self.section}.{name}"
        bad = ~np.isfinite(values) & finite_physics(self.env)
        if bad.any():
            causes = {path: (kind_of_values(values[bad]), bad)}
            warn_not_finite(self.env, causes, what, self._warning_counts)

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Reset the terms that are classes; (n,) environments, or None for all."""
        for name, reset in self._resets:
            try:
                reset(env_ids)
            except FAILURES as error:
                self.fail(name, error, env_ids)

    def term_states(self) -> dict[str, Any]:
        """State of the terms that have one (copies), by name."""
        return {name: term.state_dict() for name, term in self._stateful.items()}

    def load_term_states(self, states: Mapping[str, Any]) -> None:
        """Continue where `term_states` was taken, with the same parameters."""
        for name, term in self._stateful.items():
            term.load_state_dict(states[name])

    def state_dict(self) -> dict[str, Any]:
        """State of the terms that have one, and changed parameters (copies)."""
        return {"terms": self.term_states(), "params": copy.deepcopy(self._changed)}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        for name in {*self._changed, *state["params"]}:
            declared = self._declared[name]
            values: dict[str, Any] = {
                "params": declared.params,
                "shape": getattr(declared, "shape", None),
            }
            values |= state["params"].get(name, {})
            self.set_params(name, **copy.deepcopy(values))
        self.load_term_states(state["terms"])


def checked_rows(value: Any, num_envs: int, kind: Kind, name: str) -> None:
    """Check that a term's value is a tensor or an array of shape (N,).

    Raises:
        ConfigError: If not; names the term. (N, 1) is refused too, because it would broadcast.
    """
    if not hasattr(value, "shape") or not hasattr(value, "dtype"):
        raise ConfigError(
            f"{kind} term {name!r} must return a tensor of shape ({num_envs},), "
            f"got {type(value).__name__}"
        )
    if tuple(value.shape) != (num_envs,):
        raise ConfigError(
            f"{kind} term {name!r} must return shape ({num_envs},), got {tuple(value.shape)}"
        )


class CurriculumManager(Manager[CurriculumCfg]):
    """Calls every term for environments that are about to be reset, before the reset.

    A term returns the values it has set (a number, or several by name) or None;
    ``info["curriculum"]`` of every step contains the current ones. Time is `env.control_step`,
    which counts on through resets.

    Args:
        env: The environment, with all other managers.
        cfgs: Name -> curriculum.

    A curriculum can be held at a stage, for an evaluation: `hold`. What a stage is, a term says by
    ``stage_dict()`` and ``load_stage_dict(stage)``, which do not depend on the number of
    environments; of terms without them it is all that curricula may set, weights and parameters,
    and their state.

    Attributes:
        values: The last results of the terms, under ``TERM`` or ``TERM/NAME``.
        held: Whether the curriculum is held, so that terms are not called.
    """

    def __init__(self, env: TermContext, cfgs: Mapping[str, CurriculumCfg]) -> None:
        super().__init__(env, "curriculum", "curriculum", cfgs)
        self.values: dict[str, float] = {}
        self.held = False
        self._begun = False

    def before_step(self) -> None:
        """Call the terms for all environments, with arrays on a device only; see `compute`."""
        if self._arrays.on_device:
            self._compute(None)

    def compute(self, env_ids: EnvIndex | None) -> None:
        """Call the terms. With arrays on a device this does nothing: `before_step` calls them.

        Args:
            env_ids: (n,) sorted unique int64 environments about to be reset, or None for all.
        """
        if not self._arrays.on_device:  # there it is not known which environments are reset
            self._compute(env_ids)

    def _compute(self, env_ids: EnvIndex | None) -> None:
        if self.held:
            return
        self._begun = True
        for name, term in self.terms.items():
            with self._failing(name, env_ids):
                value = term.call(self.env, env_ids)
                numbers: dict[str, float] = {}
                if isinstance(value, Mapping):
                    numbers = {f"{name}/{key}": float(number) for key, number in value.items()}
                elif value is not None:
                    numbers[name] = float(value)
            self.values |= numbers
            for key, number in numbers.items():
                if not math.isfinite(number) and counted(key, self._warning_counts):
                    place = declared_at(self.env, f"curriculum.{key}")
                    _log.warning("%s: %s is %s", present_step(self.env), place, number)

    def stage_dict(self) -> dict[str, Any]:
        """The stage that was reached, for `hold` in any number of environments (copies)."""
        staged = {
            name: term for name, term in self.terms.items() if hasattr(term.instance, "stage_dict")
        }
        stage: dict[str, Any] = {
            "control_step": self.env.control_step,
            "values": dict(self.values),
            "names": list(self.terms),
            "terms": {name: term.instance.stage_dict() for name, term in staged.items()},
        }
        if len(staged) == len(self.terms):
            return stage
        # What the other terms have set is not known: all that a curriculum may set is saved.
        states = {
            name: instance.state_dict()
            for name, instance in self._stateful.items()
            if name not in staged
        }
        params = {
            name: manager.state_dict()["params"]
            for name, manager in self.env.managers.items()
            if manager is not self
        }
        weights = dict(self.env.reward_manager.weights)
        return {**stage, "states": states, "params": params, "weights": weights}

    def hold(self, stage: Mapping[str, Any] | None = None) -> None:
        """Stay at a stage: set what it has set, and do not call terms any more.

        Args:
            stage: Of `stage_dict`; None is the present one, in a new environment the first.
        """
        if stage is not None:
            self._load_stage(stage)
        elif not self._begun and self.env.control_step == 0:
            self._compute(None)  # as the first reset does
        self.held = True

    def release(self) -> None:
        """Go on from the present stage."""
        self.held = False

    def _load_stage(self, stage: Mapping[str, Any]) -> None:
        """Set what a stage has set; entries of terms that are not here are left out."""
        for section, changed in stage.get("params", {}).items():
            manager = self.env.managers[section]
            for name, values in changed.items():
                if name in manager.terms:
                    manager.set_params(name, **copy.deepcopy(values))
        for name, weight in stage.get("weights", {}).items():
            if name in self.env.reward_manager.weights:
                self.env.reward_manager.set_weight(name, weight)
        for name, state in stage.get("states", {}).items():
            term = self._stateful.get(name)
            if term is None:
                continue
            if _have_same_shapes(term.state_dict(), state):
                term.load_state_dict(copy.deepcopy(state))
            else:
                text = "curriculum.%s: its state from training has other shapes; it starts again"
                _log.warning(text, name)
        for name, state in stage["terms"].items():
            if name in self.terms:
                self.terms[name].instance.load_stage_dict(state)
        self.values = {
            key: value
            for key, value in stage["values"].items()
            if key.partition("/")[0] in self.terms
        }
        for name in self.terms:
            if name not in stage["names"]:
                _log.warning("curriculum.%s was not in training: it stays where it begins", name)

    def state_dict(self) -> dict[str, Any]:
        """The values that were set, and the state of terms that are classes (copies)."""
        return {**super().state_dict(), "values": dict(self.values), "held": self.held}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        super().load_state_dict(state)
        self.values = dict(state["values"])
        self.held = state.get("held", False)  # of 0.1, which could not be held


def _have_same_shapes(state: Any, other: Any) -> bool:
    """Whether two states have the same entries, and arrays of the same shapes."""
    if isinstance(state, Mapping) and isinstance(other, Mapping):
        return state.keys() == other.keys() and all(
            _have_same_shapes(value, other[key]) for key, value in state.items()
        )
    return bool(np.shape(state) == np.shape(other))
