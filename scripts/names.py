"""List the public names of the package, and find those that disappeared or changed incompatibly.

`python scripts/names.py` (`make names`) writes ``tests/packaging/public_names.txt``: one name a
line, with its parameters. `--check` writes nothing and compares: the exit code is 1 if a name is
gone, or no longer takes what it took, and the changelog's *Unreleased* does not have it in a
*Removed* or *Changed* entry, in backticks. Names that are new are no break.

Public is:

- ``python``: what the packages' ``__init__`` and the modules of `MODULES` have in ``__all__``, with
  the public members of the classes;
- ``verb``, ``option``: the command line;
- ``key``: configs; ``*`` stands for a name of the user's. Variants of a key are listed together;
- ``choice``: what the groups of `conf/` offer, such as ``task=reach``;
- ``term``: registered terms with their parameters.

Types and values of defaults are not compared: a parameter is ``name``, ``name=`` if it may be left
out, ``*name`` or ``**name``; names after ``*`` are keywords. (griffe compares the Python API with a
commit of git. The command line, keys and terms are the larger part here, and need the same.)
"""

from __future__ import annotations

import argparse
import dataclasses
import importlib
import inspect
import pkgutil
import re
import sys
import types
import typing
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from embodichain.lab.sim.configs.references import REFERENCE_WORDS
from embodichain.lab.sim.configs.sensor_cfg import SensorCfg, sensor_configs

ROOT = Path(__file__).parents[1]
LIST = ROOT / "tests" / "packaging" / "public_names.txt"
CHANGELOG = ROOT / "CHANGELOG.md"
MODULES = (
    "embodichain.cli.sweeps.launching",
    "embodichain.config.keys.learners",
    "embodichain.config.keys.tensor_algorithms",
    "embodichain.lab.gym.envs.cfg",
    "embodichain.lab.gym.envs.managers.param_types",
    "embodichain.lab.gym.envs.managers.scene_entity",
    "embodichain.lab.gym.envs.managers.term",
    "embodichain.lab.gym.envs.managers.terms.registry",
    "embodichain.lab.gym.envs.observers",
    "embodichain.lab.gym.expert.instructions",
    "embodichain.lab.gym.expert.step_register",
    "embodichain.lab.gym.lerobot_env",
    "embodichain.lab.gym.policies",
    "embodichain.lab.gym.utils.registration",
    "embodichain.lab.sim.cfg",
    "embodichain.lab.sim.drawing.renderer_register",
    "embodichain.lab.sim.drawing.views",
    "embodichain.lab.sim.engine.api",
    "embodichain.lab.sim.engine.engine_register",
    "embodichain.lab.sim.shapes",
    "embodichain.recording.demos.collection",
    "embodichain.recording.viewers.showing",
    "embodichain.recording.viewers.web",
    "embodichain.utils.configclass",
    "embodichain.utils.errors",
)
"""Public modules that are not packages: those that docs/ and README.md import, and configs."""
_GROUPS = (
    "task",
    "algo",
    "embodiment",
    "experiment",
    "object",
    "record",
    "scene",
    "sim",
    "variation",
    "viewer",
)
_LINE = re.compile(r"(?P<name>[^(]+)(?:\((?P<parameters>.*)\))?")


def all_names() -> list[str]:
    """Every public name, sorted."""
    return sorted({*_python(), *_command_line(), *_keys(), *_choices(), *_terms()})


def _python() -> Iterator[str]:
    import embodichain

    modules = pkgutil.walk_packages(embodichain.__path__, "embodichain.")
    packages = [module.name for module in modules if module.ispkg]
    for name in ["embodichain", *packages, *MODULES]:
        module = importlib.import_module(name)
        for exported in getattr(module, "__all__", ()):
            if not exported.startswith("_"):
                yield from _names_of(f"python {name}.{exported}", getattr(module, exported))


def _names_of(name: str, value: Any) -> Iterator[str]:
    """Yield the line of an object, and those of the public members of a class."""
    if not inspect.isclass(value):
        yield name + _parameters(value) if callable(value) else name
        return
    yield name + _parameters(value)
    for member, attribute in inspect.getmembers(value):
        if member.startswith("_") or not _is_ours(value, member):
            continue
        line = f"{name}.{member}"
        if inspect.isroutine(attribute):
            line += _parameters(attribute)
        yield line


def _is_ours(owner: type, member: str) -> bool:
    """Whether a class of ours defines a member; those of libraries may come and go with them."""
    for definer in owner.__mro__:
        if member in vars(definer):
            return definer.__module__.startswith("embodichain")
    return False


def _parameters(value: Any) -> str:
    """``(a, b=, *, c)`` of something that is called, without ``self``."""
    try:
        signature = inspect.signature(value)
    except (TypeError, ValueError):  # an exception, a type of C
        return ""
    words: list[str] = []
    has_star = False
    for parameter in signature.parameters.values():
        name = parameter.name
        if name in ("self", "cls"):
            continue
        if parameter.kind == inspect.Parameter.VAR_POSITIONAL:
            words.append(f"*{name}")
            has_star = True
            continue
        if parameter.kind == inspect.Parameter.VAR_KEYWORD:
            words.append(f"**{name}")
            continue
        if parameter.kind == inspect.Parameter.KEYWORD_ONLY and not has_star:
            words.append("*")
            has_star = True
        words.append(name if parameter.default is inspect.Parameter.empty else f"{name}=")
    return f"({', '.join(words)})"


def _command_line() -> Iterator[str]:
    import click

    from embodichain.cli.app import load_verb
    from embodichain.cli.verb import VERBS

    for verb in VERBS:
        yield f"verb {verb}"
        for parameter in load_verb(verb).params:
            if isinstance(parameter, click.Option):
                for option in [*parameter.opts, *parameter.secondary_opts]:
                    yield f"option {verb} {option}"


def _keys() -> Iterator[str]:
    from embodichain.config.keys.learners import LEARNERS
    from embodichain.config.keys.schema import RootCfg

    yield from _keys_of("", RootCfg, ())
    for _, entry in LEARNERS.items():
        yield from _keys_of("algo", entry.config, ())


def _keys_of(path: str, config: type, above: tuple[type, ...]) -> Iterator[str]:
    """Yield the keys of a data class and of those within it.

    Args:
        path: Key path of the data class.
        config: It.
        above: The data classes that it is in: one within itself is not read again.
    """
    if config in above:
        return
    hints = typing.get_type_hints(config)
    for name in (field.name for field in dataclasses.fields(config)):
        if name.startswith("_"):
            continue
        key = f"{path}.{name}" if path else name
        yield f"key {key}"
        yield from _keys_below(key, hints[name], (*above, config))


def _keys_below(key: str, hint: Any, above: tuple[type, ...]) -> Iterator[str]:
    """Yield keys of data classes in a type: of variants of a union, and of a mapping's values."""
    if hint is SensorCfg:
        for config in dict.fromkeys(sensor_configs().values()):
            yield from _keys_of(key, config, above)
        return
    if dataclasses.is_dataclass(hint) and isinstance(hint, type):
        yield from _keys_of(key, hint, above)
        return
    origin = typing.get_origin(hint)
    arguments = typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        for variant in arguments:
            yield from _keys_below(key, variant, above)
    elif isinstance(origin, type) and len(arguments) == 2 and issubclass(origin, dict):
        yield from _keys_below(f"{key}.*", arguments[1], above)
    elif isinstance(origin, type) and issubclass(origin, list):
        yield from _keys_below(f"{key}.*", arguments[0], above)


def _choices() -> Iterator[str]:
    for group in _GROUPS:
        for path in sorted((ROOT / "conf" / group).glob("*.yaml")):
            yield f"choice {group}={path.stem}"


def _terms() -> Iterator[str]:
    from embodichain.cli.results.terms import SECTION_OF, all_entries

    for entry in all_entries():
        words: list[str] = []
        for name, parameter in entry.spec.params.items():
            words.append(name if parameter.default is inspect.Parameter.empty else f"{name}=")
        if words:
            words.insert(0, "*")
        for kind in entry.kinds:
            yield f"term {SECTION_OF[kind]} {entry.name}({', '.join(words)})"


def breaks(old: Iterable[str], new: Iterable[str]) -> dict[str, str]:
    """Find names that disappeared or changed incompatibly.

    Args:
        old: Lines of the list.
        new: Lines as they are now.

    Returns:
        Name -> why it is broken, as the rest of a sentence.
    """
    parameters_now = dict(map(_split, new))
    reasons: dict[str, str] = {}
    for name, parameters in map(_split, old):
        if name not in parameters_now:
            reasons[name] = "is gone"
        elif parameters is not None:
            reason = _why_refused(parameters, parameters_now[name])
            if reason:
                reasons[name] = reason
    return reasons


def _split(line: str) -> tuple[str, list[str] | None]:
    """Return the name in a line, and its parameters, or None if it is not called."""
    match = _LINE.fullmatch(line.strip())
    if match is None:
        raise ValueError(f"not a line of the list: {line!r}")
    inside = match["parameters"]
    if inside is None:
        return match["name"], None
    words = [word for word in inside.split(", ") if word]
    if line.startswith("term "):
        words = [_config_word(word) for word in words]
    return match["name"], words


def _config_word(word: str) -> str:
    """A term's parameter as configs write it: lists of before have EmbodiChain's names too."""
    name, optional, _ = word.partition("=")
    return f"{REFERENCE_WORDS.get(name, name)}{optional}"


@dataclass
class _Signature:
    """Parameters as a line of the list has them.

    Attributes:
        positional: Name -> whether it may be left out.
        keywords: Parameters that are keywords only, likewise.
        any_positional: Whether there is an ``*args``.
        any_keyword: Whether there is a ``**kwargs``.
    """

    positional: dict[str, bool]
    keywords: dict[str, bool]
    any_positional: bool = False
    any_keyword: bool = False

    @property
    def by_name(self) -> dict[str, bool]:
        """All named parameters."""
        return self.positional | self.keywords

    @classmethod
    def read(cls, words: list[str]) -> _Signature:
        """Read the words between the parentheses of a line."""
        signature = cls(positional={}, keywords={})
        parameters = signature.positional
        for word in words:
            if word.startswith("**"):
                signature.any_keyword = True
            elif word.startswith("*"):
                signature.any_positional |= word != "*"
                parameters = signature.keywords
            else:
                parameters[word.removesuffix("=")] = word.endswith("=")
        return signature


def _why_refused(before: list[str], now: list[str] | None) -> str:
    """Return why calls that were right may now be wrong; empty if they are not."""
    if now is None:
        return "is not called any more"
    new = _Signature.read(now)
    old = _Signature.read(before)
    for name, is_optional in old.by_name.items():
        if name not in new.by_name and not new.any_keyword:
            return f"has no parameter {name!r} any more"
        if is_optional and not new.by_name.get(name, True):
            return f"needs {name!r} now"
    for name, is_optional in new.by_name.items():
        if name not in old.by_name and not is_optional:
            return f"needs {name!r} now"
    first_parameters = list(new.positional)[: len(old.positional)]
    if not new.any_positional and first_parameters != list(old.positional):
        return "has other positional parameters, or another order"
    return ""


def announced(changelog: str) -> set[str]:
    """Return the words in backticks in the unreleased entries of *Removed* and *Changed*."""
    unreleased = changelog.partition("## [Unreleased]")[2].partition("\n## ")[0]
    parts = re.split(r"^### ", unreleased, flags=re.MULTILINE)
    texts = [part for part in parts if part.startswith(("Removed", "Changed"))]
    return set(re.findall(r"`([^`]+)`", "".join(texts)))


def unannounced(old: Iterable[str], new: Iterable[str], changelog: str) -> list[str]:
    """Return breaks that the changelog does not name, one sentence each.

    An entry names it by all of it (``option run --quiet``), without the first word
    (``run --quiet``), or by its last part (``--quiet``); the key path likewise.
    """
    announced_names = announced(changelog)
    sentences: list[str] = []
    for name, reason in breaks(old, new).items():
        without_kind = name.split(" ", 1)[1]
        last_word = name.split()[-1]
        last_part = name.rsplit(".", 1)[-1]
        if announced_names.isdisjoint({name, without_kind, last_word, last_part}):
            sentences.append(f"{name} {reason}")
    return sentences


def main(arguments: list[str] | None = None) -> int:
    """Write the list, or check it."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--check", action="store_true", help="compare, and write nothing")
    options = parser.parse_args(arguments)
    now = all_names()
    old = LIST.read_text(encoding="utf-8").splitlines() if LIST.exists() else []
    problems = unannounced(old, now, CHANGELOG.read_text(encoding="utf-8"))
    for problem in problems:
        print(f"{problem}: name it in CHANGELOG.md, Unreleased, under Removed or Changed")
    if options.check:
        return int(bool(problems))
    LIST.write_text("\n".join(now) + "\n", encoding="utf-8")
    print(f"{LIST.relative_to(ROOT)}: {len(now)} names, {len(set(now) - set(old))} lines new")
    return 0


if __name__ == "__main__":
    sys.exit(main())
