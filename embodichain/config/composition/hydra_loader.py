"""Hydra's loader of the YAML trees, and its errors as one-line messages with file and line.

The search path is `--config-dir`, `hydra.searchpath`, `./conf`, this package's tree, plug-ins'
trees. The first that has a file wins, so that a user's `task/reach.yaml` replaces the package's. A
Hydra plug-in adds these folders to searches of this package's tree only: other Hydra applications
in the process are not affected.
"""

from __future__ import annotations

import copy
import errno
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from importlib import resources
from importlib.util import find_spec
from pathlib import Path

import yaml
from hydra import version
from hydra._internal.config_loader_impl import ConfigLoaderImpl
from hydra._internal.config_repository import IConfigRepository
from hydra._internal.utils import create_config_search_path
from hydra.core.config_loader import ConfigLoader
from hydra.core.config_search_path import ConfigSearchPath
from hydra.core.default_element import ResultDefault
from hydra.core.object_type import ObjectType
from hydra.core.override_parser.types import Override
from hydra.core.plugins import Plugins
from hydra.core.utils import setup_globals
from hydra.errors import HydraException, MissingConfigException
from hydra.plugins.config_source import ConfigResult, ConfigSource
from hydra.plugins.search_path_plugin import SearchPathPlugin
from omegaconf import DictConfig, OmegaConf

from embodichain.config.composition.config_files import TextRepository
from embodichain.config.composition.defaults_lists import (
    chosen_twice,
    explain_defaults,
    explain_lists,
    place_of_entry,
    place_of_override,
)
from embodichain.config.composition.environment import register_env_resolvers
from embodichain.config.composition.locate import (
    COMMAND_LINE,
    ConfigFile,
    TooDeepError,
    depth_of,
    display_path,
)
from embodichain.config.composition.registered_options import PLACE, RegisteredOptions
from embodichain.config.gymnasium_ids import CONFIG_MODULE, ENTRY_POINTS, LOCAL
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.register import entries_of
from embodichain.utils.suggest import did_you_mean, listing

__all__ = [
    "COMPOSING",
    "SEARCH_PATH",
    "VERSION_BASE",
    "chosen_config_dir",
    "config_loader",
    "explain",
    "explain_yaml",
    "folder_of_source",
    "own_folder",
    "register_resolvers",
    "search_path_of",
    "searched",
    "user_configs",
]

_BASE = "1.3"
VERSION_BASE = {} if isinstance(version.getbase(), str) else {"version_base": _BASE}
"""Argument of `hydra.main`: the behaviour of Hydra 1.3, which 1.4 has without being asked."""
COMPOSING = (
    *(HydraException, yaml.YAMLError, OSError, ValueError, RecursionError),
    AssertionError,  # Hydra's, of a group with a list of options that is chosen a second time
)
"""Exceptions that composing may raise because of the user's files."""
SEARCH_PATH = "hydra.searchpath"
"""Hydra's key for places to search."""
_DEEPEST = 200
"""Depth of nested maps and lists that Python's recursion allows in Hydra and OmegaConf."""
_SHOWN_BY = {"task": "embodichain list tasks"}
_UNPLACED = re.compile(
    r"(?:In '(?P<file>[^']+)': )?Could not (?P<verb>override|delete) '(?P<choice>[^'=]+)[^']*'"
    r"(?:.*\nDid you mean to override (?:one of )?(?P<places>[^?]+)\?)?"
)
"""Hydra's refusal to change a choice that no file makes."""
# Options that the packages of the extra `sweep` provide.
_PLUGINS = {("hydra/launcher", "joblib"), ("hydra/sweeper", "optuna")}
_config_dir: ContextVar[Path | None] = ContextVar("config_dir", default=None)
_search_path: ContextVar[tuple[str, ...]] = ContextVar("search_path", default=())


@contextmanager
def user_configs(config_dir: str | Path | None) -> Iterator[None]:
    """Search `config_dir` before everything else while the context lasts.

    Args:
        config_dir: A folder with the user's groups (``task/``...); None changes nothing.

    Raises:
        ConfigError: The folder does not exist.
    """
    folder = _config_dir.get() if config_dir is None else Path(config_dir).resolve()
    if folder is not None and not folder.is_dir():
        raise ConfigError(f"--config-dir {config_dir}: no such folder")
    token = _config_dir.set(folder)
    try:
        yield
    finally:
        _config_dir.reset(token)


def chosen_config_dir() -> Path | None:
    """Return the folder of the enclosing `user_configs`."""
    return _config_dir.get()


@contextmanager
def searched(places: Sequence[str]) -> Iterator[None]:
    """Search places after `user_configs` and before everything else while the context lasts.

    Args:
        places: ``file://FOLDER`` or ``pkg://PACKAGE``, see `search_path_of`; the first wins.
    """
    token = _search_path.set((*places, *_search_path.get()))
    try:
        yield
    finally:
        _search_path.reset(token)


def search_path_of(override: Override) -> tuple[list[str], list[Problem]]:
    """Return the places of ``hydra.searchpath=[file://FOLDER, pkg://PACKAGE]``, and its mistakes.

    A folder needs no ``file://``.
    """
    value = None if override.is_delete() else override.value()
    if value is None:
        return [], []
    if not isinstance(value, list) or not all(isinstance(place, str) for place in value):
        message = "expected a list of folders: hydra.searchpath=[file:///path/to/conf]"
        return [], [Problem(SEARCH_PATH, message, source=COMMAND_LINE)]
    places = []
    problems = []
    for place in value:
        scheme, separator, name = place.rpartition("://")
        if scheme == "pkg":
            exists = _is_package(name)
        else:
            exists = (not separator or scheme == "file") and Path(name).is_dir()
            place = f"file://{Path(name).resolve()}"
        if exists:
            places.append(place)
        else:
            message = f"no such folder or package: {place}"
            problems.append(Problem(SEARCH_PATH, message, source=COMMAND_LINE))
    return places, problems


def _is_package(name: str) -> bool:
    """Whether a package is installed; those above it are imported."""
    try:
        return find_spec(name) is not None
    except ModuleNotFoundError:  # a package above it
        return False


@contextmanager
def config_loader(config_dir: str | Path | None = None) -> Iterator[_Loader]:
    """Provide a loader of `embodichain.conf`.

    It is separate from that of a running Hydra application, which `hydra.initialize` would replace.

    Args:
        config_dir: Searched first; None keeps the enclosing `user_configs`.

    Raises:
        ConfigError: `config_dir` does not exist.
    """
    base = version.getbase()
    if not (hasattr(base, "major") or isinstance(base, str)):  # a string: Hydra 1.4
        version.setbase(_BASE)  # unset until a Hydra application starts
    _register_plugins()
    with user_configs(config_dir):
        yield _Loader(create_config_search_path(f"pkg://{CONFIG_MODULE}"))


def register_resolvers() -> None:
    """Register Hydra's resolvers (``${now:%Y-%m-%d}``) and ours with OmegaConf."""
    if not OmegaConf.has_resolver("now"):
        setup_globals()
    register_env_resolvers()


class _Loader(ConfigLoaderImpl):
    """Hydra's loader, which remembers what it merged.

    It gets a group's options from the sources, which Hydra's loader copies each time, in 10 ms.

    Attributes:
        merged: The defaults list of the last config. To compute it again
            (`compute_defaults_list`) reads every file again, a third of the time of composing.
    """

    def __init__(self, config_search_path: ConfigSearchPath) -> None:
        super().__init__(config_search_path)
        self.repository = TextRepository(config_search_path)
        self.merged: tuple[ResultDefault, ...] = ()

    def _compose_config_from_defaults_list(
        self, defaults: list[ResultDefault], repo: IConfigRepository
    ) -> DictConfig:
        self.merged = tuple(defaults)
        return super()._compose_config_from_defaults_list(defaults, repo)

    @staticmethod
    def _embed_result_config(ret: ConfigResult, package_override: str | None) -> ConfigResult:
        embedded = ConfigLoaderImpl._embed_result_config(ret, package_override)
        if embedded is ret:  # at the root: Hydra would merge the shared content itself, not a copy
            embedded = copy.copy(ret)
            embedded.config = copy.deepcopy(ret.config)
        return embedded

    def get_group_options(
        self,
        group_name: str,
        results_filter: ObjectType | None = ObjectType.CONFIG,
        config_name: str | None = None,
        overrides: list[str] | None = None,
    ) -> list[str]:
        try:
            return self.repository.get_group_options(group_name, results_filter)
        except OSError as error:
            if error.errno == errno.ENAMETOOLONG:  # no folder has that name
                return []
            raise


class EmbodichainSearchPath(SearchPathPlugin):
    """Adds the user's folders before the package's tree, and plug-ins' trees after it."""

    def manipulate_search_path(self, search_path: ConfigSearchPath) -> None:
        """Called by Hydra for every search path it makes."""
        paths = [element.path or "" for element in search_path.get_path()]
        if f"pkg://{CONFIG_MODULE}" not in paths:
            return
        own = own_folder()
        config_dir = _config_dir.get()
        # Each is put before all others, so the last one is searched first.
        places = [("./conf", f"file://{Path(LOCAL).resolve()}")]
        places += [(SEARCH_PATH, place) for place in reversed(_search_path.get())]
        if config_dir is not None:
            places.append(("--config-dir", f"file://{config_dir}"))
        for provider, place in places:
            folder = Path(place.removeprefix("file://"))
            if place.startswith("pkg://") or (folder.is_dir() and folder != own):
                search_path.prepend(provider, place)
        for entry in entries_of(ENTRY_POINTS):
            search_path.append(entry.name, f"pkg://{entry.value}")
        search_path.append("embodichain", PLACE)


def _register_plugins() -> None:
    """Register our places with Hydra, which replaces its plug-ins in a job of a sweep."""
    Plugins.instance().register(EmbodichainSearchPath)
    Plugins.instance().register(RegisteredOptions)


_register_plugins()


def folder_of_source(scheme: str, path: str) -> Path | None:
    """Return the folder of an entry of a search path; None for Hydra's own and for non-folders."""
    if scheme == "file":
        return Path(path)
    if scheme == "pkg" and not path.startswith("hydra"):
        return _folder_of(path)
    return None


def origin_of(source: ConfigSource) -> str:
    """Return where an option comes from, for tables: ``embodichain``, or a folder.

    In a working copy of this package its folder may have files of the user, too.
    """
    if source.provider != "main":
        return str(source.provider)
    shown = display_path(own_folder())
    return "embodichain" if Path(shown).is_absolute() else f"./{shown}"


def own_folder() -> Path:
    """Return the folder of this package's groups."""
    return _folder_of(CONFIG_MODULE).resolve()


def _folder_of(module: str) -> Path:
    return Path(str(resources.files(module)))


def explain(error: Exception, loader: ConfigLoader, choices: Sequence[str] = ()) -> list[Problem]:
    """Describe an error of composing.

    Args:
        error: One of `COMPOSING`.
        loader: Provides groups, options and the search path.
        choices: Overrides that chose options, as they were given to Hydra.
    """
    if isinstance(error, yaml.YAMLError):
        return [explain_yaml(error)]
    if isinstance(error, UnicodeDecodeError):
        return [Problem("", "not UTF-8 text", source=name) for name in _not_utf8(loader)]
    if isinstance(error, OSError) and not isinstance(error, HydraException):
        name = display_path(Path(str(error.filename)))
        return [Problem("", f"cannot be read: {error.strerror}", source=name)]
    if isinstance(error, ValueError | RecursionError) and not isinstance(error, HydraException):
        folders = _folders(loader)
        is_recursion = isinstance(error, RecursionError)
        problems = explain_defaults(folders, circles=is_recursion)
        if is_recursion and not problems:
            problems = _too_deep(folders)
        if problems:
            return problems
    if isinstance(error, AssertionError):
        problems = explain_lists(_folders(loader))
        if problems:
            return problems
    unchosen = re.search(r"You must specify '([^']+)'", str(error))
    if unchosen:
        return [_unchosen(unchosen[1], loader)]
    if isinstance(error, MissingConfigException):
        return [_no_such_config(error, loader)]
    unplaced = _UNPLACED.search(str(error))
    if unplaced:
        return [_unplaced(unplaced, loader)]
    duplicate = re.search(r"Multiple values for (\S+)\.|(\S+) appears more than once", str(error))
    if duplicate:
        return _chosen_twice(duplicate[1] or duplicate[2], error, loader, choices)
    cause = error.__cause__ or error
    if "Incompatible key type 'NoneType'" in str(cause):
        problems = _null_keys(loader)
        if problems:
            return problems
    lines = [line.strip() for line in str(cause).splitlines() if line.strip()]
    key = next((line[9:].strip() for line in lines if line.startswith("full_key:")), "")
    text = lines[0] if lines else type(cause).__name__
    return [Problem(key, text, source=COMMAND_LINE)]


def explain_yaml(error: yaml.YAMLError, path: Path | None = None) -> Problem:
    """Describe malformed YAML, with the line where the parser stopped."""
    mark = getattr(error, "problem_mark", None)
    reason = getattr(error, "problem", None) or str(error)
    context = getattr(error, "context", None)
    source = "" if path is None else display_path(path)
    if mark is not None:
        if path is None:
            source = display_path(Path(mark.name)) if Path(mark.name).is_file() else mark.name
        source = f"{source}:{mark.line + 1}"
    if reason.startswith("could not determine a constructor for the tag"):
        reason = f"tags are not used here, found {reason.split()[-1]}"
    if context:
        reason = f"{reason} ({context})"
    return Problem("", f"malformed YAML: {reason}", source=source)


def _chosen_twice(
    group: str, error: Exception, loader: ConfigLoader, choices: Sequence[str]
) -> list[Problem]:
    """The problems of a group of which two options are chosen, in files or by an override."""
    refused = re.search(r"'override [^':]+: ([^']+)'", str(error))
    if refused:
        names = [
            f"{key.partition('@')[0]}/{name}"
            for key, _, name in (line.lstrip("+").partition("=") for line in choices)
        ]
        problems = chosen_twice(_folders(loader), group, refused[1], names)
        is_added = any(line.startswith(f"+{group}=") for line in choices)
        if problems and not is_added:
            return problems
    written = group.removesuffix("@task") if group.startswith("embodiment@") else group
    message = f"an option is chosen already: write {written}=NAME, without +"
    return [Problem(written, message, source=COMMAND_LINE)]


def _unplaced(refusal: re.Match[str], loader: ConfigLoader) -> Problem:
    """The problem that an option is chosen where no file has a place for its group."""
    choice = refusal["choice"]
    group, at, _ = choice.partition("@")
    source = COMMAND_LINE
    if refusal["file"]:
        source = place_of_override(_folders(loader), refusal["file"], choice) or COMMAND_LINE
    if choice == "embodiment":
        message = f"a file chooses it where no task places it: write `override /{group}@task: NAME`"
        return Problem(group, message, source=source)
    places = [place for place in (refusal["places"] or "").split(", ") if place]
    if choice == "embodiment@task" and not places:
        message = f"the task has no place for an {group}: its robot is written in it."
        hint = f"Add the line `- /{group}@_here_: NAME` to its defaults, and leave out its `robot`."
        return Problem(group, message, hint, source)
    if refusal["verb"] == "delete":
        return Problem(choice, "cannot delete it: no option is chosen there", source=source)
    message = "no option is chosen there"
    if not at:
        message = f"its place is missing: {group}@PLACE=NAME"
    message = f"{message}; places of this group: {listing(places, choice)}."
    hint = did_you_mean(choice, places).strip()
    if not hint and source == COMMAND_LINE:
        hint = f"+{group}@PLACE=NAME adds one."
    return Problem(choice, message, hint, source)


def _unchosen(group: str, loader: ConfigLoader) -> Problem:
    """The problem of a group without an option."""
    options = listing(loader.get_group_options(group), shown_by=_SHOWN_BY.get(group, ""))
    message = f"missing value: choose one with {group}=NAME; there are: {options}"
    return Problem(group, message, source=COMMAND_LINE)


def _no_such_config(error: MissingConfigException, loader: ConfigLoader) -> Problem:
    """The problem of an option that does not exist."""
    name = error.missing_cfg_file or ""
    group, _, option = name.rpartition("/")
    asking_file = re.search(r"In '([^']+)'", str(error))
    place = f" (in the defaults list of '{asking_file[1]}')" if asking_file else ""
    source = COMMAND_LINE
    if asking_file:
        source = place_of_entry(_folders(loader), asking_file[1], name) or COMMAND_LINE
    if (group, option) in _PLUGINS:
        message = f"{option!r}{place} needs packages: pip install 'embodichain[sweep]'"
        return Problem(group, message, source=COMMAND_LINE)
    options = list(error.options or loader.get_group_options(group))
    if not options:
        return Problem("", f"there is no config '{name}'{place}", source=source)
    listed = listing(options, option, _SHOWN_BY.get(group, ""))
    message = f"unknown option {option!r}{place}; {group} is one of: {listed}."
    return Problem(group, message, did_you_mean(option, options).strip(), source)


def _folders(loader: ConfigLoader) -> list[Path]:
    """The folders that are searched, without Hydra's own."""
    sources = [folder_of_source(source.scheme(), source.path) for source in loader.get_sources()]
    return [folder for folder in sources if folder is not None]


def _null_keys(loader: ConfigLoader) -> list[Problem]:
    """The keys that are null, in all files of the search path: the error does not name the file."""
    problems: list[Problem] = []
    for folder in _folders(loader):
        for path in sorted(folder.rglob("*.yaml")):
            with suppress(yaml.YAMLError, UnicodeDecodeError):  # another file than that one
                package = path.parent.relative_to(folder).as_posix().replace("/", ".").strip(".")
                file = ConfigFile.read(path, package)
                null_keys = {m.path for m in file.misread if m.read.rpartition(".")[2] == "None"}
                problems += [problem for problem in file.problems() if problem.path in null_keys]
    return problems


def _too_deep(folders: Sequence[Path]) -> list[Problem]:
    """A problem for each file that nests too deeply: the error does not name the file."""
    problems = []
    for path in _files(folders):
        try:
            if depth_of(path) > _DEEPEST:
                raise TooDeepError(path)
            ConfigFile.read(path, "")
        except yaml.YAMLError as error:
            problems.append(explain_yaml(error, path))
        except (OSError, UnicodeDecodeError):
            continue  # another mistake, of a file that may not be composed
    return problems


def _files(folders: Sequence[Path]) -> Iterator[Path]:
    """Yield the YAML files of some folders."""
    for folder in folders:
        yield from sorted(folder.rglob("*.yaml"))


def _not_utf8(loader: ConfigLoader) -> list[str]:
    """The files of the search path that are not UTF-8: the error does not name the file."""
    return [display_path(path) for path in _files(_folders(loader)) if not _is_utf8(path)]


def _is_utf8(path: Path) -> bool:
    try:
        path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        return False
    return True
