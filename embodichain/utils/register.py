"""Registers: the things of one kind that a config names, ours and those of other packages.

A kind of thing (sensors, formats of exports, ...) has one `Register`. A module of this package and
a module of a package outside use the same door, a decorator; the module of a package outside is
named by an entry point::

    [project.entry-points."embodichain.sensors"]
    altimeter = "my_package.altimeter"

Modules are imported at the first lookup, so that a register costs nothing before it is used.
"""

from __future__ import annotations

import ast
import importlib
import importlib.util
import logging
import pkgutil
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from embodichain.utils.errors import ConfigError
from embodichain.utils.suggest import did_you_mean, listing

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

__all__ = ["Register", "entries_of", "load_entry_points"]

logger = logging.getLogger(__name__)

T = TypeVar("T")
Member = TypeVar("Member")


class Register(Generic[T]):
    """Name -> thing, for things of one kind.

    Names have the order of `modules`, then that of the entry points' names.

    Args:
        kind: What it contains, in the singular, for messages: ``sensor type``.
        group: The entry-point group of packages with more of them: ``embodichain.sensors``. The
            value of an entry is a module; importing it registers its things.
        modules: The modules of this package whose import registers ours; ``package.*`` is every
            public module in a package.

    Attributes:
        kind: The first argument.
        group: The second argument.
    """

    def __init__(self, kind: str, *, group: str, modules: Sequence[str] = ()) -> None:
        self.kind = kind
        self.group = group
        self._additions = 0
        self._modules = tuple(modules)
        self._members: dict[str, T] = {}
        self._places: dict[str, str] = {}
        self._broken: list[str] = []
        self._is_loaded = False
        self._is_loading = False
        self._lock = threading.RLock()

    def add(
        self, name: str, *other_names: str, describes: Any = None
    ) -> Callable[[Member], Member]:
        """Register a class, a function or any other object.

        Args:
            name: Its name in configs.
            *other_names: More names of the same object.
            describes: The function or class that the object describes, whose place is the one that
                messages name; None is the object itself.

        Returns:
            A decorator that returns its argument.

        Raises:
            ValueError: If a name is empty, or an object that is defined elsewhere has it.
        """

        def decorate(member: Member) -> Member:
            place = _place(member if describes is None else describes)
            for each in (name, *other_names):
                if not each:
                    raise ValueError(f"the {self.kind} of {place} has an empty name")
                owner = self._places.get(each, place)
                if owner != place:
                    raise ValueError(
                        f"{self.kind} {each!r} of {place} is registered already, by {owner}"
                    )
            self._additions += 1
            for each in (name, *other_names):
                self._places[each] = place
                self._members[each] = member  # type: ignore[assignment]
            return member

        return decorate

    def __getitem__(self, name: str) -> T:
        """Return the thing of a name.

        Raises:
            ConfigError: If there is none; names the closest one, and packages that are broken.
        """
        members = self._loaded()
        if name not in members:
            raise ConfigError(self.unknown(name))
        return members[name]

    def __contains__(self, name: object) -> bool:
        return name in self._loaded()

    def __iter__(self) -> Iterator[str]:
        return iter(tuple(self._loaded()))

    def __len__(self) -> int:
        return len(self._loaded())

    def get(self, name: str) -> T | None:
        """Return the thing of a name, or None."""
        return self._loaded().get(name)

    def items(self) -> tuple[tuple[str, T], ...]:
        """Return all names and things; a thing with several names occurs once for each."""
        return tuple(self._loaded().items())

    def names(self) -> tuple[str, ...]:
        """Return the names of modules and entry points, without importing one.

        These are the names in the register where each module of ``package.*`` and each entry point
        is called as what it registers.
        """
        return tuple(dict.fromkeys([*self._own_modules(), *self._entry_values()]))

    def entry_names(self) -> tuple[str, ...]:
        """Return the names of entry points alone, without importing a module."""
        return tuple(self._entry_values())

    def summaries(self) -> dict[str, str]:
        """Return the names of `names`, each with the first line of its module's docstring.

        Modules are read, not imported. A module that is not there, or is not Python, has none.
        """
        modules = {**self._entry_values(), **self._own_modules()}
        return {name: _summary(modules[name]) for name in self.names()}

    def place(self, name: str) -> str:
        """Return where the thing of a name is defined: ``package.module:name``.

        Raises:
            ConfigError: If there is no such thing.
        """
        self[name]
        return self._places[name]

    def package(self, name: str) -> str:
        """Return the package whose entry point registers the thing of a name; empty for ours.

        Raises:
            ConfigError: If there is no such thing.
        """
        top = self.place(name).partition(".")[0].partition(":")[0]
        for entry in entries_of(self.group):
            if entry.module.partition(".")[0] == top and entry.dist is not None:
                return entry.dist.name
        return ""

    @property
    def revision(self) -> int:
        """How often something was registered: what follows from all of it is kept by this."""
        self._loaded()
        return self._additions

    @property
    def broken(self) -> tuple[str, ...]:
        """One sentence, without its full stop, for each entry point that could not be loaded."""
        self._loaded()
        return tuple(self._broken)

    def unknown(self, name: str) -> str:
        """Return the message about a name that nothing has.

        It names what exists, the closest name, and the packages that could not be loaded, as one
        of these may have it.
        """
        names = tuple(self)
        besides = "".join(f" Besides, {reason}." for reason in self._broken)
        allowed = listing(names, name)
        hint = did_you_mean(name, names)
        return f"unknown {self.kind} {name!r}; there are: {allowed}.{hint}{besides}"

    def _loaded(self) -> dict[str, T]:
        """Import our modules and those of other packages, once."""
        if not self._is_loaded:
            with self._lock:
                self._load()
        return self._members

    def _load(self) -> None:
        # Another thread may have done it meanwhile; this one comes back here when a module that
        # it imports looks something up.
        if self._is_loaded or self._is_loading:
            return
        self._is_loading = True
        try:
            for module in self._own_modules().values():
                importlib.import_module(module)
            self._broken = load_entry_points(self.group, f"the {self.kind}s")
            self._put_in_order()
            self._is_loaded = True
        finally:
            self._is_loading = False

    def _put_in_order(self) -> None:
        """Order the names by modules: one that something else imported before came first."""
        modules = [*self._own_modules().values(), *self._entry_values().values()]
        rank = {module: number for number, module in enumerate(modules)}

        def rank_of(name: str) -> int:
            return rank.get(self._places[name].partition(":")[0], len(modules))

        self._members = {name: self._members[name] for name in sorted(self._members, key=rank_of)}

    def _own_modules(self) -> dict[str, str]:
        """Last part of the path -> our modules, in order."""
        modules: dict[str, str] = {}
        for path in self._modules:
            package = path.removesuffix(".*")
            inner = [package] if package == path else _modules_in(package)
            modules.update((module.rpartition(".")[2], module) for module in inner)
        return modules

    def _entry_values(self) -> dict[str, str]:
        """Name of an entry point -> the module that it names."""
        return {entry.name: entry.module for entry in entries_of(self.group)}


def load_entry_points(group: str, contents: str) -> list[str]:
    """Import the modules that other packages name in an entry-point group, by name.

    A module that fails is reported and left out: what the others have must work without it.

    Args:
        group: The group.
        contents: What the modules contain, for the report: ``the terms``.

    Returns:
        One sentence, without its full stop, for each module that failed; each was also logged as
        a warning.
    """
    broken: list[str] = []
    for entry in entries_of(group):
        try:
            entry.load()
        except Exception as error:  # another package's module may raise anything
            owner = "" if entry.dist is None else f" of {entry.dist.name}"
            reason = f"{type(error).__name__}: {error}"
            broken.append(
                f"{contents} of {entry.value!r} (entry point {entry.name!r}{owner}) could not be "
                f"loaded: {reason}"
            )
            logger.warning("%s", broken[-1])
            logger.debug("the traceback:", exc_info=error)
    return broken


def entries_of(group: str) -> list[EntryPoint]:
    """Return the entry points of a group, by name."""
    return sorted(_installed_entries(tuple(sys.path)).select(group=group))


@lru_cache(maxsize=1)
def _installed_entries(path: tuple[str, ...]) -> Any:
    """All entry points in the folders that packages are imported from.

    To read them takes 20 ms, and there are a dozen registers. What Python returns has another type
    before Python 3.12, with the same method `select`.
    """
    from importlib.metadata import entry_points

    return entry_points()


def _modules_in(package: str) -> list[str]:
    """Paths of the public modules in a package, by name; none of them is imported."""
    spec = importlib.util.find_spec(package)
    folders = [] if spec is None else spec.submodule_search_locations
    modules = [module.name for module in pkgutil.iter_modules(folders)]
    return [f"{package}.{name}" for name in modules if not name.startswith("_")]


def _summary(module: str) -> str:
    """First line of a module's docstring, as it stands in its file."""
    try:
        spec = importlib.util.find_spec(module)
    except ImportError:  # the package that it is in is missing, or does not work
        return ""
    if spec is None or spec.origin is None or not spec.origin.endswith(".py"):
        return ""
    try:
        docstring = ast.get_docstring(ast.parse(Path(spec.origin).read_bytes()))
    except (OSError, SyntaxError, ValueError):  # reported when the module is imported
        return ""
    return (docstring or "").partition("\n")[0]


def _place(member: Any) -> str:
    """Where an object is defined; for one that does not know, where it is registered."""
    module = getattr(member, "__module__", None)
    name = getattr(member, "__qualname__", None)
    if isinstance(module, str) and isinstance(name, str):
        return f"{module}:{name}"
    # An instance knows its class only, which may have others in the register.
    caller = sys._getframe(2)
    return f"{caller.f_globals.get('__name__', '?')}:{caller.f_lineno}"
