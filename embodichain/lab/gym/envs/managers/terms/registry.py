"""The registry of terms: `register_term`, `quantity`, `TERMS`, and lookup by name or path.

A *quantity* is a function that reads numbers from the scene, ``(env, ...) -> (N,) or (N, K)``; a
*shape* (`register_shape`) reduces each row of them to one number; the section of a task determines
whether the result is a reward, a metric, a termination or an observation. Other terms are functions
and classes with the signature of their kind. Imports no torch, so that listing and validating start
fast; modules of terms load torch lazily for the same reason.
"""

from __future__ import annotations

import importlib
import inspect
import itertools
import pkgutil
import re
import typing
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any, Literal, TypeVar, cast, get_args

from embodichain.lab.gym.envs.managers.terms.other_projects import translation_of
from embodichain.lab.sim.configs.references import REFERENCE_WORDS
from embodichain.utils.errors import ConfigError
from embodichain.utils.plugins import TERM_MODULES
from embodichain.utils.register import load_entry_points
from embodichain.utils.suggest import did_you_mean, listing

__all__ = [
    "ENTRY_POINTS",
    "KINDS",
    "LEADING",
    "REDUCERS",
    "SECTIONS",
    "SHAPES",
    "TERMS",
    "VALUE_KINDS",
    "Kind",
    "SpecKind",
    "TermSpec",
    "call_mistake",
    "config_word",
    "describe_term",
    "import_object",
    "quantity",
    "register_shape",
    "register_term",
    "resolve_term",
]

Kind = Literal[
    "event",
    "observation",
    "reward",
    "action",
    "termination",
    "metric",
    "command",
    "curriculum",
]
KINDS: tuple[Kind, ...] = get_args(Kind)
SECTIONS: dict[str, Kind] = {
    "actions": "action",
    "events": "event",
    "commands": "command",
    "observations": "observation",
    "rewards": "reward",
    "terminations": "termination",
    "metrics": "metric",
    "curriculum": "curriculum",
}
"""Section of a task -> kind of its terms, in the order of pages and tables."""
VALUE_KINDS: tuple[Kind, ...] = ("observation", "reward", "termination", "metric")
"""Kinds whose terms are numbers: quantities can be used in all of them."""
SpecKind = Kind | Literal["policy", "shape", "step"]
LEADING: dict[SpecKind, tuple[str, ...]] = {
    "event": ("env", "env_ids"),
    "observation": ("env", "obs"),
    "reward": ("env", "obs", "action", "info"),
    "termination": ("env", "obs", "action", "info"),
    "metric": ("env", "obs", "action", "info"),
    "action": ("env",),
    "command": ("env",),
    "curriculum": ("env", "env_ids"),
    "policy": ("obs", "env"),
    "shape": ("env",),
    "step": ("env",),
}
"""First arguments of a function of each kind. The `__init__` of a class receives `env` (that of a
policy, which is described here but is not a term, only parameters; so are functions that make
the steps of an expert)."""
_LEAD_OF_QUANTITIES = ("obs", "action", "info")
"""Arguments that a quantity may take after `env`, in this order; not in observations."""

T = TypeVar("T", bound=Callable[..., Any])
DrawDeclaration = Callable[..., Iterable[Any]]
"""Parameters of an event -> its `PhysicsDraw`s (`physics_draws`)."""
_BUILTIN = "embodichain.lab.gym.envs.mdp"
_MODULES = ("shapes", "sampled_commands", "curricula", "terrain")
_PACKAGES = ("actions", "events", "quantities")
ENTRY_POINTS = "embodichain.terms"
"""Entry point group of packages with terms: each entry is a module to import with ours."""
_PATH = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*(\.[A-Za-z_]\w*)*")


@dataclass(frozen=True)
class TermSpec:
    """One term: a function or class that a config names.

    Attributes:
        name: Its name in configs.
        kind: The manager that runs it.
        func: The function or class.
        params: The parameters that a config may set, by the name that it writes (`config_word`),
            in order, without the leading arguments.
        doc: Its docstring.
        open_params: Whether it takes ``**kwargs``, so that any further name is allowed.
        lead: Which of ``obs``, ``action`` and ``info`` a quantity takes after ``env``; None for
            other terms.
        draws: What an event declares to draw for drives and links, see `register_term`.
        takes_strength: Whether an event's `strength` acts on what it draws.
    """

    name: str
    kind: SpecKind
    func: Callable[..., Any]
    params: dict[str, inspect.Parameter]
    doc: str
    open_params: bool = False
    lead: tuple[str, ...] | None = None
    _hints: dict[str, Any] = field(default_factory=dict, repr=False, compare=False)
    draws: DrawDeclaration | None = field(default=None, kw_only=True)
    takes_strength: bool = field(default=False, kw_only=True)

    @property
    def is_class(self) -> bool:
        """Whether the term is built once and then called."""
        return inspect.isclass(self.func)

    @property
    def label(self) -> str:
        """Kind and name, for messages: ``event term 'push'``."""
        kind = self.kind if self.kind in ("policy", "shape", "step") else f"{self.kind} term"
        return f"{kind} {self.name!r}"

    @property
    def place(self) -> str:
        """Where it is defined: ``package.module:name``."""
        return _place(self.func)

    @property
    def draws_params(self) -> dict[str, str]:
        """The parameters that `draws` takes -> their names in a config."""
        if self.draws is None:
            return {}
        return {name: config_word(name) for name in inspect.signature(self.draws).parameters}

    def hints(self) -> dict[str, Any]:
        """Evaluated types of the parameters only: those of `env` and the result may need torch."""
        if not self._hints:
            target = self.func.__init__ if self.is_class else inspect.unwrap(self.func)
            scope = getattr(target, "__globals__", {})
            for name, parameter in self.params.items():
                self._hints[name] = _evaluated(parameter.annotation, scope)
        return self._hints

    def written(self, given: Iterable[str]) -> dict[str, str]:
        """Names in a config -> the parameters they mean; unknown names are left out.

        EmbodiChain's names of references are other names of ours, see `REFERENCE_WORDS`.
        """
        parameters: dict[str, str] = {}
        for name in given:
            word = REFERENCE_WORDS.get(name, name)
            if name in self.params:
                parameters[name] = name
            elif word in self.params:
                parameters[name] = word
            elif self.open_params:
                parameters[name] = name
        return parameters

    def python_names(self) -> dict[str, str]:
        """Names of parameters in Python -> the names that a config writes."""
        return {parameter.name: word for word, parameter in self.params.items()}

    def arguments(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Return values by parameter name as keyword arguments of the function."""
        arguments: dict[str, Any] = {}
        for key, value in values.items():
            name = self.params[key].name if key in self.params else key
            arguments[name] = value
        return arguments


def config_word(name: str) -> str:
    """Return what a config writes for a parameter of a Python function.

    ``of`` for ``entity_cfg`` (`REFERENCE_WORDS`), ``from`` for ``from_``, else the name itself.
    """
    return REFERENCE_WORDS.get(name, name.removesuffix("_"))


def _evaluated(annotation: Any, scope: dict[str, Any]) -> Any:
    """Return the type of an annotation that may be text, evaluated where it is written."""
    if annotation is inspect.Parameter.empty:
        return Any
    holder: Any = SimpleNamespace(__annotations__={"parameter": annotation})
    try:
        return typing.get_type_hints(holder, scope, {}, include_extras=True)["parameter"]
    except NameError:  # a name imported for type checkers only: its type cannot be checked
        return Any


class _TermTable(Mapping[Kind, dict[str, TermSpec]]):
    """kind -> name -> term; the built-in terms are imported at the first access."""

    def __init__(self) -> None:
        self.registered: dict[Kind, dict[str, TermSpec]] = {kind: {} for kind in KINDS}
        self.broken: list[str] = []  # entry points that could not be loaded, and why
        self._loaded = False

    def __getitem__(self, kind: Kind) -> dict[str, TermSpec]:
        if not self._loaded:
            self._loaded = True  # before importing: a module of terms may look up terms
            try:
                for package in _PACKAGES:
                    _import_modules(f"{_BUILTIN}.{package}")
                for name in _MODULES:
                    importlib.import_module(f"{_BUILTIN}.{name}")
                for module in TERM_MODULES:
                    importlib.import_module(module)
            except BaseException:
                self._loaded = False
                raise
            self.broken = load_entry_points(ENTRY_POINTS, "the terms")
        return self.registered[kind]

    def __iter__(self) -> Iterator[Kind]:
        return iter(KINDS)

    def __len__(self) -> int:
        return len(KINDS)


def _import_modules(package: str) -> None:
    """Import every public module of a package: their decorators register the terms."""
    folder = importlib.import_module(package).__path__
    for module in pkgutil.iter_modules(folder):
        if not module.name.startswith("_"):
            importlib.import_module(f"{package}.{module.name}")


TERMS = _TermTable()
"""Every registered term: ``TERMS[kind][name]``."""


def register_term(
    *kinds: Kind,
    name: str | None = None,
    draws: DrawDeclaration | None = None,
    takes_strength: bool = False,
) -> Callable[[T], T]:
    """Make a function or class available to configs under a name.

    Args:
        *kinds: The managers that may run it; one signature can serve several.
        name: Its name; None is the function's name.
        draws: Of an event that draws drive gains, effort limits, armatures, masses or centres of
            mass: a function that takes those of the event's parameters that it names (references as
            `SceneEntityCfg`), and returns a `PhysicsDraw` for each quantity of each entity. It is
            called before the scene is compiled.
        takes_strength: Of an event: whether `strength` acts on it, because it gives the defaults of
            what it draws (`Uniform`, `EventDraws`).

    Returns:
        A decorator that returns its argument.

    Raises:
        ValueError: If a kind is unknown, the name is taken by another object, or `draws` takes a
            parameter that the event does not have.
    """
    unknown = [kind for kind in kinds if kind not in KINDS]
    if unknown or not kinds:
        raise ValueError(f"unknown kind of term {unknown or kinds}; allowed: {', '.join(KINDS)}")

    def decorate(func: T) -> T:
        if draws is not None:
            _DRAWS[func] = draws
        if takes_strength:
            _TAKE_STRENGTH.add(func)
        for kind in kinds:
            add_term(describe_term(kind, func, name))
        return func

    return decorate


def add_term(spec: TermSpec) -> None:
    """Register a term from its `TermSpec`.

    Raises:
        ValueError: If its name is taken by another object.
    """
    table = SHAPES if spec.kind == "shape" else TERMS.registered[cast("Kind", spec.kind)]
    registered = table.get(spec.name)
    if registered is not None and registered.place != spec.place:
        raise ValueError(f"{spec.label} is registered already, by {registered.place}")
    table[spec.name] = spec


def quantity(*kinds: Kind, name: str | None = None) -> Callable[[T], T]:
    """Register a function (or class) that reads numbers from the scene.

    A function takes ``env``, then those of ``obs``, ``action`` and ``info`` that it reads (a
    quantity that reads any of them cannot be an observation), then parameters. A class takes
    ``(env, **params)`` and is called without arguments.

    Args:
        *kinds: The managers that may use it; by default observation, reward, termination and
            metric, as far as its arguments allow.
        name: Its name; None is the function's name.

    Returns:
        A decorator that returns its argument. The quantity must return float64 or bool, (N,) or
        (N, K); observations may have more dimensions.
    """

    def decorate(func: T) -> T:
        lead = _lead_of(func)
        _LEADS[func] = lead
        allowed = VALUE_KINDS[1:] if lead else VALUE_KINDS
        for kind in kinds or allowed:
            add_term(describe_term(kind, func, name))
        return func

    return decorate


def register_shape(func: T) -> T:
    """Register a shape, which reduces rows of a quantity to numbers, under its lower-case name.

    A "_" at the end of the name, which avoids a clash with another Python name, is left out.

    ``(env, **params)`` returns a callable, or is a class with `__call__`: (N,) or (N, K) float64 or
    bool -> the same or (N,).
    """
    title = str(getattr(func, "__name__", "")).lower().removesuffix("_")
    add_term(describe_term("shape", func, title))
    return func


def _lead_of(func: Callable[..., Any]) -> tuple[str, ...]:
    """Return which of ``obs``, ``action`` and ``info`` a quantity takes after ``env``."""
    if inspect.isclass(func):
        return ()
    names = list(inspect.signature(func).parameters)[1:]
    return tuple(itertools.takewhile(lambda name: name in _LEAD_OF_QUANTITIES, names))


_LEADS: dict[Callable[..., Any], tuple[str, ...]] = {}
"""Quantities -> the arguments that they take after `env`."""
_DRAWS: dict[Callable[..., Any], DrawDeclaration] = {}
"""Events -> what they declare to draw; also for those that a config names by their path."""
_TAKE_STRENGTH: set[Callable[..., Any]] = set()
"""Events on which `strength` acts; also those that a config names by their path."""
SHAPES: dict[str, TermSpec] = {}
"""Every registered shape by name; filled with the terms."""
REDUCERS = (
    "column",
    "l1",
    "l2",
    "norm",
    "tanh",
    "gaussian",
    "tolerance",
    "above",
    "below",
    "within",
    "outside",
)
"""The shapes that make one number of several columns."""


def _place(func: Callable[..., Any]) -> str:
    return f"{func.__module__}:{getattr(func, '__qualname__', type(func).__qualname__)}"


def describe_term(kind: SpecKind, func: Callable[..., Any], name: str | None = None) -> TermSpec:
    """Describe a term by its signature.

    Raises:
        ValueError: If the signature lacks the arguments that the manager passes, or the declaration
            of an event's draws takes others than its parameters.
    """
    title = name or str(getattr(func, "__name__", type(func).__name__))
    of_quantity = _LEADS.get(func)
    if inspect.isclass(func):
        lead: tuple[str, ...] = () if kind == "policy" else ("env",)
    elif of_quantity is not None:
        lead = ("env", *of_quantity)
    else:
        lead = LEADING[kind]
    params = list(inspect.signature(func).parameters.values())
    positional = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    if len(params) < len(lead) or any(p.kind not in positional for p in params[: len(lead)]):
        what = kind if kind == "policy" else f"{kind} term"
        found = ", ".join(parameter.name for parameter in params)
        raise ValueError(
            f"{what} {title!r} must take ({', '.join(lead)}, ...) first, it takes ({found})"
        )
    rest = params[len(lead) :]
    variable = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
    spec = TermSpec(
        name=title,
        kind=kind,
        func=func,
        params=_by_config_word(p for p in rest if p.kind not in variable),
        doc=inspect.getdoc(func) or "",
        open_params=any(p.kind is inspect.Parameter.VAR_KEYWORD for p in rest),
        lead=of_quantity,
        draws=_DRAWS.get(func) if kind == "event" else None,
        takes_strength=kind == "event" and func in _TAKE_STRENGTH,
    )
    unknown = [name for name in spec.draws_params.values() if name not in spec.params]
    if unknown:
        message = f"draws takes {', '.join(unknown)}, and {spec.label} has no such parameter"
        raise ValueError(f"{message}; it has: {', '.join(spec.params) or 'none'}")
    return spec


def call_mistake(spec: TermSpec, kind: SpecKind) -> str | None:
    """Return what is wrong with the ``__call__`` of a class; None if it takes what it is given.

    Args:
        spec: The class.
        kind: What calls its objects.
    """
    call = inspect.getattr_static(spec.func, "__call__", None)
    if not inspect.isfunction(call):
        return None  # made by a decorator or written in C: the first call shows what it takes
    taken = inspect.signature(call)
    # A quantity that is a class has got `env` in `__init__`.
    lead = LEADING[kind] if spec.lead is None else spec.lead
    try:
        taken.bind(None, *lead)  # None stands for `self`
    except TypeError:
        wanted = ", ".join(("self", *lead))
        found = ", ".join(taken.parameters)
        return f"class {spec.name!r}: __call__ must take ({wanted}), it takes ({found})"
    return None


def _by_config_word(parameters: Iterable[inspect.Parameter]) -> dict[str, inspect.Parameter]:
    """Return parameters by the names that configs write.

    A function that has both `of` and `entity_cfg` keeps the two names.
    """
    parameters = list(parameters)
    counts = Counter(config_word(parameter.name) for parameter in parameters)
    by_word: dict[str, inspect.Parameter] = {}
    for parameter in parameters:
        word = config_word(parameter.name)
        by_word[word if counts[word] == 1 else parameter.name] = parameter
    return by_word


def resolve_term(
    kind: Kind, func: str | Callable[..., Any], *, allow_import: bool = True
) -> TermSpec:
    """Find the term that a config's `func` names.

    Args:
        kind: The kind of the term.
        func: A registered name, ``package.module:function``, or a callable.
        allow_import: Whether an import path may be followed; False for configs read from a log.

    Raises:
        ConfigError: If there is no such term; names the closest one.
    """
    if not isinstance(func, str):
        for spec in TERMS[kind].values():
            if spec.func is func:
                return spec
        return _described(kind, func, None)
    if func in TERMS[kind]:
        return TERMS[kind][func]
    if ":" in func:
        if not allow_import:
            raise ConfigError(f"{func!r} would be imported, which is not done for this config")
        return _described(kind, import_object(func), func)
    other_kinds = [other for other in KINDS if func in TERMS[other]]
    if other_kinds:
        raise ConfigError(f"{func!r} is a term of kind {', '.join(other_kinds)}, not {kind}")
    translation = translation_of(func)
    if translation:
        raise ConfigError(f"unknown {kind} term {func!r}.{translation}")
    names = listing(sorted(TERMS[kind]), func, "embodichain list terms")
    broken_packages = "".join(f" Besides, {reason}." for reason in TERMS.broken)
    raise ConfigError(
        f"unknown {kind} term {func!r}; allowed: {names}, or package.module:function."
        f"{did_you_mean(func, TERMS[kind])}{broken_packages}"
    )


def _described(kind: Kind, func: Callable[..., Any], name: str | None) -> TermSpec:
    if not callable(func):
        raise ConfigError(f"{name or func!r} is not a function or class")
    try:
        return describe_term(kind, func, name)
    except ValueError as error:
        raise ConfigError(str(error)) from error


def import_object(path: str) -> Any:
    """Import the object ``package.module:name``.

    Raises:
        ConfigError: If the path is malformed, or its module or name does not exist.
    """
    if not _PATH.fullmatch(path):
        raise ConfigError(f"{path!r} is not of the form package.module:function")
    module_name, _, attribute = path.partition(":")
    try:
        value: Any = importlib.import_module(module_name)
    except ImportError as error:
        raise ConfigError(f"cannot import {module_name!r}: {error}") from error
    for part in attribute.split("."):
        if not hasattr(value, part):
            public = [name for name in dir(value) if not name.startswith("_")]
            raise ConfigError(f"{module_name!r} has no {part!r}.{did_you_mean(part, public)}")
        value = getattr(value, part)
    return value
