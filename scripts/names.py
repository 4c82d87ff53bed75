"""Lists the public names of the package, and finds those that disappeared or changed incompatibly.

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
commit of git. The command line, keys and terms are the larger part here, and want the same.)
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
    "embodichain.lab.sim.drawing.views",
    "embodichain.lab.sim.shapes",
    "embodichain.recording.demos.collection",
    "embodichain.recording.viewers.showing",
    "embodichain.recording.viewers.web",
    "embodichain.utils.configclass",
    "embodichain.utils.errors",
)
"""Public modules that are no packages: what docs/ and README.md import, and configs."""
_GROUPS = ("task", "algo", "experiment", "object", "record", "scene", "sim", "viewer")
_LINE = re.compile(r"(?P<name>[^(]+)(?:\((?P<parameters>.*)\))?")


def all_names() -> list[str]:
    """Every public name, sorted."""
    return sorted({*_python(), *_command_line(), *_keys(), *_choices(), *_terms()})


def _python() -> Iterator[str]:
    import embodichain

    found = pkgutil.walk_packages(embodichain.__path__, "embodichain.")
    packages = [module.name for module in found if module.ispkg]
    for name in ["embodichain", *packages, *MODULES]:
        module = importlib.import_module(name)
        for exported in getattr(module, "__all__", ()):
            if not exported.startswith("_"):
                yield from _object(f"python {name}.{exported}", getattr(module, exported))


def _object(name: str, value: Any) -> Iterator[str]:
    if inspect.isclass(value):
        yield name + _parameters(value)
        for member, found in inspect.getmembers(value):
            if not member.startswith("_") and _is_ours(value, member):
                yield f"{name}.{member}" + (_parameters(found) if inspect.isroutine(found) else "")
    else:
        yield name + (_parameters(value) if callable(value) else "")


def _is_ours(owner: type, member: str) -> bool:
    """Whether a class of ours defines a member; those of libraries may come and go with them."""
    definers = (c for c in owner.__mro__ if member in vars(c))
    return next((c.__module__.startswith("embodichain") for c in definers), False)


def _parameters(value: Any) -> str:
    """``(a, b=, *, c)`` of something that is called, without ``self``."""
    try:
        signature = inspect.signature(value)
    except (TypeError, ValueError):  # an exception, a type of C
        return ""
    words = []
    kinds = inspect.Parameter
    named = False
    for parameter in signature.parameters.values():
        if parameter.name in ("self", "cls"):
            continue
        star = {kinds.VAR_POSITIONAL: "*", kinds.VAR_KEYWORD: "**"}.get(parameter.kind, "")
        if parameter.kind == kinds.KEYWORD_ONLY and not named:
            words.append("*")
        named |= star == "*" or parameter.kind == kinds.KEYWORD_ONLY
        default = parameter.default is not kinds.empty and not star
        words.append(star + parameter.name + "=" * default)
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

    yield from _fields("", RootCfg, ())
    for _, entry in LEARNERS.items():
        yield from _fields("algo", entry.config, ())


def _fields(path: str, config: type, above: tuple[type, ...]) -> Iterator[str]:
    if config in above:
        return
    hints = typing.get_type_hints(config)
    for name in (field.name for field in dataclasses.fields(config)):
        if name.startswith("_"):
            continue
        key = f"{path}.{name}" if path else name
        yield f"key {key}"
        yield from _below(key, hints[name], (*above, config))


def _below(key: str, hint: Any, above: tuple[type, ...]) -> Iterator[str]:
    """Keys of the data classes in a type: of all variants of a union, of a mapping's values."""
    if hint is SensorCfg:
        for config in dict.fromkeys(sensor_configs().values()):
            yield from _fields(key, config, above)
        return
    if dataclasses.is_dataclass(hint) and isinstance(hint, type):
        yield from _fields(key, hint, above)
        return
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        for variant in arguments:
            yield from _below(key, variant, above)
    elif isinstance(origin, type) and len(arguments) == 2 and issubclass(origin, dict):
        yield from _below(f"{key}.*", arguments[1], above)
    elif isinstance(origin, type) and issubclass(origin, list):
        yield from _below(f"{key}.*", arguments[0], above)


def _choices() -> Iterator[str]:
    for group in _GROUPS:
        for path in sorted((ROOT / "conf" / group).glob("*.yaml")):
            yield f"choice {group}={path.stem}"


def _terms() -> Iterator[str]:
    from embodichain.cli.results.terms import SECTION_OF, all_entries

    for entry in all_entries():
        words = [
            name + "=" * (parameter.default is not inspect.Parameter.empty)
            for name, parameter in entry.spec.params.items()
        ]
        for kind in entry.kinds:
            yield f"term {SECTION_OF[kind]} {entry.name}(*, {', '.join(words)})".replace(
                "*, )", ")"
            )


def breaks(old: Iterable[str], new: Iterable[str]) -> dict[str, str]:
    """Names that disappeared or changed incompatibly.

    Args:
        old: Lines of the list.
        new: Lines as they are now.

    Returns:
        Name -> what is wrong with it now, as a sentence.
    """
    now = {name: parameters for name, parameters in map(_split, new)}
    found = {}
    for name, before in map(_split, old):
        if name not in now:
            found[name] = "is gone"
        elif before is not None and (why := _refuses(before, now[name])):
            found[name] = why
    return found


def _split(line: str) -> tuple[str, list[str] | None]:
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


def _refuses(before: list[str], now: list[str] | None) -> str:
    """Why calls that were right may now be wrong; empty if they are not."""
    if now is None:
        return "is not called any more"
    positional, keywords, anything = _kinds(now)
    was_positional, was_keywords, _ = _kinds(before)
    here = positional | keywords
    for name, optional in (was_positional | was_keywords).items():
        if name not in here and "**" not in anything:
            return f"has no parameter {name!r} any more"
        if optional and not here.get(name, True):
            return f"needs {name!r} now"
    new = [n for n, optional in here.items() if n not in was_positional | was_keywords]
    needed = [n for n in new if not here[n]]
    if needed:
        return f"needs {needed[0]!r} now"
    if "*" not in anything and list(positional)[: len(was_positional)] != list(was_positional):
        return "has other positional parameters, or another order"
    return ""


def _kinds(words: list[str]) -> tuple[dict[str, bool], dict[str, bool], set[str]]:
    """Positional and keyword parameters, name -> may be left out; which of ``*`` and ``**``."""
    positional: dict[str, bool] = {}
    keywords: dict[str, bool] = {}
    anything = set()
    into = positional
    for word in words:
        if word.startswith("**"):
            anything.add("**")
        elif word.startswith("*"):
            anything |= {"*"} if word != "*" else set()
            into = keywords
        else:
            into[word.removesuffix("=")] = word.endswith("=")
    return positional, keywords, anything


def announced(changelog: str) -> set[str]:
    """What is in backticks in the entries of *Removed* and *Changed* that are unreleased."""
    unreleased = changelog.partition("## [Unreleased]")[2].partition("\n## ")[0]
    parts = re.split(r"^### ", unreleased, flags=re.MULTILINE)
    texts = [part for part in parts if part.startswith(("Removed", "Changed"))]
    return set(re.findall(r"`([^`]+)`", "".join(texts)))


def unannounced(old: Iterable[str], new: Iterable[str], changelog: str) -> list[str]:
    """Breaks that the changelog does not name, one sentence each.

    An entry names it by all of it (``option run --quiet``), without the first word
    (``run --quiet``), or by its last part (``--quiet``); the key path likewise.
    """
    said = announced(changelog)
    return [
        f"{name} {why}"
        for name, why in breaks(old, new).items()
        if not {name, name.split(" ", 1)[1], name.split()[-1], name.rsplit(".", 1)[-1]} & said
    ]


def main(arguments: list[str] | None = None) -> int:
    """Writes the list, or checks it."""
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
