"""The terms that exist: `register_term`, `TERMS`, and finding a term by name or import path.

What a term's parameters may be is checked in `check.py`. No torch here, so that listing and
validating start fast; modules of terms load torch lazily for the same reason.
"""

from __future__ import annotations

import importlib
import inspect
import logging
import pkgutil
import re
import typing
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from importlib.metadata import entry_points
from types import SimpleNamespace
from typing import Any, Literal, TypeVar, get_args

from embodichain.utils.errors import ConfigError
from embodichain.utils.plugins import TERM_MODULES
from embodichain.utils.suggest import did_you_mean, listing

__all__ = [
    "ENTRY_POINTS",
    "KINDS",
    "LEADING",
    "TERMS",
    "Kind",
    "TermSpec",
    "describe_term",
    "import_object",
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
LEADING: dict[Kind | Literal["policy"], tuple[str, ...]] = {
    "event": ("env", "env_ids"),
    "observation": ("env", "obs"),
    "reward": ("env", "obs", "action", "info"),
    "termination": ("env", "obs", "action", "info"),
    "metric": ("env", "obs", "action", "info"),
    "action": ("env",),
    "command": ("env",),
    "curriculum": ("env", "env_ids"),
    "policy": ("obs", "env"),
}
"""What is passed first to a function of each kind. A class's `__init__` gets `env` (for policies,
which are described here too but are no terms: nothing)."""

_EEF_LATER = (
    "end-effector actions come with the IK solvers, in a later version; until then act on joints: "
    "default_offset_joint_position, relative_joint_position or joint_position_to_limits"
)
logger = logging.getLogger(__name__)

T = TypeVar("T", bound=Callable[..., Any])
_BUILTIN = "embodichain.lab.gym.envs.mdp"
_PACKAGES = (
    "actions",
    "commands",
    "curriculum",
    "events",
    "observations",
    "rewards",
    "terminations",
)
ENTRY_POINTS = "embodichain.terms"
"""Entry point group of packages with terms: each names a module that is imported with ours."""
_PATH = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*(\.[A-Za-z_]\w*)*")


@dataclass(frozen=True)
class TermSpec:
    """One term: a function or class that a config names.

    Attributes:
        name: How configs call it.
        kind: The manager that runs it.
        func: The function or class.
        params: What a config may set, by name, in order: the leading arguments are not in it.
        doc: Its docstring.
        open_params: Whether it takes ``**kwargs``, so that any further name is allowed.
    """

    name: str
    kind: Kind | Literal["policy"]
    func: Callable[..., Any]
    params: dict[str, inspect.Parameter]
    doc: str
    open_params: bool = False
    _hints: dict[str, Any] = field(default_factory=dict, repr=False, compare=False)

    @property
    def is_class(self) -> bool:
        """Whether the term is built once and then called."""
        return inspect.isclass(self.func)

    @property
    def label(self) -> str:
        """For messages: ``event term 'push'``."""
        return (
            f"policy {self.name!r}" if self.kind == "policy" else f"{self.kind} term {self.name!r}"
        )

    def hints(self) -> dict[str, Any]:
        """Types of the parameters, evaluated. Only theirs: `env` and results may name torch."""
        if not self._hints:
            target = self.func.__init__ if self.is_class else inspect.unwrap(self.func)
            scope = getattr(target, "__globals__", {})
            for name, parameter in self.params.items():
                self._hints[name] = _evaluated(parameter.annotation, scope)
        return self._hints


def _evaluated(annotation: Any, scope: dict[str, Any]) -> Any:
    if annotation is inspect.Parameter.empty:
        return Any
    holder: Any = SimpleNamespace(__annotations__={"it": annotation})
    try:
        return typing.get_type_hints(holder, scope, {}, include_extras=True)["it"]
    except NameError:  # a name that only type checkers import: nothing to check against
        return Any


class _TermTable(Mapping[Kind, dict[str, TermSpec]]):
    """kind -> name -> term; the built-in terms are imported at the first look."""

    def __init__(self) -> None:
        self.registered: dict[Kind, dict[str, TermSpec]] = {kind: {} for kind in KINDS}
        self.broken: list[str] = []  # entry points that could not be loaded, and why
        self._loaded = False

    def __getitem__(self, kind: Kind) -> dict[str, TermSpec]:
        if not self._loaded:
            self._loaded = True  # before: a module of terms may look terms up
            try:
                for package in _PACKAGES:
                    _import_modules(f"{_BUILTIN}.{package}")
                for module in TERM_MODULES:
                    importlib.import_module(module)
            except BaseException:
                self._loaded = False
                raise
            self.broken = _load_entry_points()
        return self.registered[kind]

    def __iter__(self) -> Iterator[Kind]:
        return iter(KINDS)

    def __len__(self) -> int:
        return len(KINDS)


def _load_entry_points() -> list[str]:
    """Import users' modules of terms; what cannot be imported is reported and left out."""
    broken: list[str] = []
    for entry in sorted(entry_points(group=ENTRY_POINTS)):
        try:
            entry.load()
        except Exception as error:  # whatever a user's module raises: everything else still works
            owner = "" if entry.dist is None else f" of {entry.dist.name}"
            reason = f"{type(error).__name__}: {error}"
            broken.append(
                f"the terms of {entry.value!r} (entry point {entry.name!r}{owner}) could not be "
                f"loaded: {reason}"
            )
            logger.warning("%s", broken[-1])
            logger.debug("the traceback:", exc_info=error)
    return broken


def _import_modules(package: str) -> None:
    """Import every public module of a package: their decorators register the terms."""
    found = importlib.import_module(package)
    for module in pkgutil.iter_modules(found.__path__):
        if not module.name.startswith("_"):
            importlib.import_module(f"{package}.{module.name}")


TERMS = _TermTable()
"""Every registered term: ``TERMS[kind][name]``."""


def register_term(*kinds: Kind, name: str | None = None) -> Callable[[T], T]:
    """Make a function or class available to configs under a name.

    Args:
        *kinds: The managers that may run it; one signature can serve several.
        name: Its name; None is the function's own.

    Returns:
        A decorator that leaves its argument as it is.

    Raises:
        ValueError: If a kind is unknown, or the name is taken by another object.
    """
    unknown = [kind for kind in kinds if kind not in KINDS]
    if unknown or not kinds:
        raise ValueError(f"unknown kind of term {unknown or kinds}; allowed: {', '.join(KINDS)}")

    def decorate(func: T) -> T:
        for kind in kinds:
            spec = describe_term(kind, func, name)
            known = TERMS.registered[kind].get(spec.name)
            if known is not None and _place(known.func) != _place(func):
                raise ValueError(
                    f"{kind} term {spec.name!r} is registered already, by {_place(known.func)}"
                )
            TERMS.registered[kind][spec.name] = spec
        return func

    return decorate


def _place(func: Callable[..., Any]) -> str:
    return f"{func.__module__}:{getattr(func, '__qualname__', type(func).__qualname__)}"


def describe_term(
    kind: Kind | Literal["policy"], func: Callable[..., Any], name: str | None = None
) -> TermSpec:
    """Read a term's parameters off its signature.

    Raises:
        ValueError: If the signature lacks the arguments that the manager passes.
    """
    title = name or str(getattr(func, "__name__", type(func).__name__))
    lead = LEADING[kind]
    if inspect.isclass(func):
        lead = () if kind == "policy" else ("env",)
    params = list(inspect.signature(func).parameters.values())
    positional = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    if len(params) < len(lead) or any(p.kind not in positional for p in params[: len(lead)]):
        raise ValueError(f"{kind} term {title!r} must take ({', '.join(lead)}, ...) first")
    rest = params[len(lead) :]
    variable = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
    return TermSpec(
        name=title,
        kind=kind,
        func=func,
        params={p.name: p for p in rest if p.kind not in variable},
        doc=inspect.getdoc(func) or "",
        open_params=any(p.kind is inspect.Parameter.VAR_KEYWORD for p in rest),
    )


def resolve_term(
    kind: Kind, func: str | Callable[..., Any], *, allow_import: bool = True
) -> TermSpec:
    """Find the term that a config's `func` names.

    Args:
        kind: The manager that asks.
        func: A registered name, ``package.module:function``, or a callable.
        allow_import: Whether an import path may be followed; False for configs read from a log.

    Raises:
        ConfigError: If there is no such term; names the closest one.
    """
    if not isinstance(func, str):
        return _described(kind, func, None)
    known = TERMS[kind].get(func)
    if known is not None:
        return known
    if ":" in func:
        if not allow_import:
            raise ConfigError(f"{func!r} would be imported, which is not done for this config")
        return _described(kind, import_object(func), func)
    elsewhere = [other for other in KINDS if func in TERMS[other]]
    if elsewhere:
        raise ConfigError(f"{func!r} is a term of kind {', '.join(elsewhere)}, not {kind}")
    if kind == "action" and "eef" in func.lower():
        raise ConfigError(f"{func!r} is not available yet: {_EEF_LATER}")
    names = listing(sorted(TERMS[kind]), func, "embodichain list terms")
    missing = "".join(f" Besides, {reason}." for reason in TERMS.broken)
    raise ConfigError(
        f"unknown {kind} term {func!r}; allowed: {names}, or package.module:function."
        f"{did_you_mean(func, TERMS[kind])}{missing}"
    )


def _described(kind: Kind, func: Callable[..., Any], name: str | None) -> TermSpec:
    if not callable(func):
        raise ConfigError(f"{name or func!r} is not a function or class")
    try:
        return describe_term(kind, func, name)
    except ValueError as error:
        raise ConfigError(str(error)) from error


def import_object(path: str) -> Any:
    """Import what ``package.module:name`` names.

    Raises:
        ConfigError: If the path is malformed, or its module or name does not exist.
    """
    if not _PATH.fullmatch(path):
        raise ConfigError(f"{path!r} is not of the form package.module:function")
    module_name, _, attribute = path.partition(":")
    try:
        found: Any = importlib.import_module(module_name)
    except ImportError as error:
        raise ConfigError(f"cannot import {module_name!r}: {error}") from error
    for part in attribute.split("."):
        if not hasattr(found, part):
            public = [n for n in dir(found) if not n.startswith("_")]
            raise ConfigError(f"{module_name!r} has no {part!r}.{did_you_mean(part, public)}")
        found = getattr(found, part)
    return found
