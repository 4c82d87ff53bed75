"""Further names of a robot's links, sites and geoms: `names` of its config.

`with_file_names` writes the file's names for them in the other keys of the config;
`resolve_aliases` finds what each of them stands for, which references to the robot look up.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import mujoco

from embodichain.lab.sim.cfg import ArticulationCfg, RobotCfg
from embodichain.lab.sim.compiler.names import (
    FRAME_KINDS,
    FrameAlias,
    FrameKind,
    match_every,
    no_such,
)
from embodichain.lab.sim.compiler.robot.drives.drive_changes import DriveChange
from embodichain.lab.sim.configs.robot_names_cfg import GripperCfg
from embodichain.utils.errors import Problem
from embodichain.utils.suggest import did_you_mean, listing

__all__ = [
    "check_grippers",
    "frames_by_kind",
    "resolve_aliases",
    "with_file_names",
    "with_file_names_in",
]

_NAME = re.compile(r"\w+(/\w+)*")
"""An allowed name; a slash separates an arm from its part, as in ``left/tool``."""
Names = Mapping[FrameKind, Sequence[str]]
"""Kind -> the names of frames of that kind in the file."""


def frames_by_kind(model: mujoco.MjModel) -> dict[FrameKind, list[str]]:
    """Return the names of a robot's links, sites and geoms, without the world's."""
    return {
        "link": [model.body(i).name for i in range(1, model.nbody)],
        "site": [name for i in range(model.nsite) if (name := model.site(i).name)],
        "geom": [name for i in range(model.ngeom) if (name := model.geom(i).name)],
    }


def check_grippers(
    grippers: Mapping[str, GripperCfg], parts: Mapping[str, object], controls: Sequence[str]
) -> list[Problem]:
    """Return what is wrong with the names in `grippers`, with paths in the config.

    Args:
        grippers: Control part -> how it opens and closes.
        parts: The robot's control parts.
        controls: The names of its controls.
    """
    problems: list[Problem] = []
    for part, gripper in grippers.items():
        if part not in parts:
            problems.append(no_such("control part", part, [*parts] or ["none"], f"grippers.{part}"))
        for pattern in _as_list(gripper.actuators or []):
            path = f"grippers.{part}.actuators"
            _, mistakes = match_every(pattern, controls, "actuator", path)
            problems += mistakes
    return problems


def resolve_aliases(
    cfg: ArticulationCfg, names: Names, left_out: Collection[str] = ()
) -> tuple[dict[str, FrameAlias], list[Problem]]:
    """Return what each of a config's `names` stands for, and every mistake in them.

    Args:
        cfg: The config.
        names: The names in the file, those of attachments and tool points included.
        left_out: Names of attachments and tool points that are not there because of another
            mistake: what stands for them is not a mistake as well.
    """
    aliases: dict[str, FrameAlias] = {}
    problems: list[Problem] = []
    for name, patterns in cfg.names.items():
        path = f"names.{name}"
        if not _NAME.fullmatch(name):
            message = f"{name!r} is not a name: letters, digits and _, as in tool or left/tool"
            problems.append(Problem(path, message))
            continue
        alias, mistakes = _resolve(_as_list(patterns), names, path)
        if not _match_one_of(_as_list(patterns), left_out):
            problems += mistakes
        if alias is None:  # references to it are not a mistake as well
            aliases[name] = FrameAlias("link", ())
            continue
        clash = _clash(name, alias, names)
        if clash is None:
            aliases[name] = alias
        else:
            problems.append(Problem(path, clash))
    return aliases, problems


def _match_one_of(patterns: Iterable[str], names: Collection[str]) -> bool:
    """Return whether one of some patterns, with or without a kind, matches one of some names."""
    for pattern in patterns:
        _, _, without_kind = pattern.rpartition(":")
        ids, _ = match_every(without_kind, list(names), "name", "")
        if ids:
            return True
    return False


def _as_list(patterns: str | Sequence[str]) -> list[str]:
    if isinstance(patterns, str):
        return [patterns]
    return list(patterns)


def _resolve(
    patterns: Sequence[str], names: Names, path: str
) -> tuple[FrameAlias | None, list[Problem]]:
    """Return the frames that patterns match: links, else sites, else geoms."""
    if not patterns:
        return None, [Problem(path, "names nothing: give a link, a site or a geom")]
    problems: list[Problem] = []
    frames: list[str] = []
    kinds: set[FrameKind] = set()
    for pattern in patterns:
        kind, matching, mistakes = _match(pattern, names, path)
        problems += mistakes
        frames += matching
        if kind is not None:
            kinds.add(kind)
    if problems:
        return None, problems
    if len(kinds) > 1:
        message = f"names several kinds, {' and '.join(f'{kind}s' for kind in sorted(kinds))}"
        return None, [Problem(path, f"{message}: give links, sites or geoms")]
    return FrameAlias(kinds.pop(), tuple(dict.fromkeys(frames))), []


def _match(
    pattern: str, names: Names, path: str
) -> tuple[FrameKind | None, list[str], list[Problem]]:
    """Return the kind of the first names that a regex matches, these names, and its mistakes."""
    kinds: Sequence[FrameKind] = FRAME_KINDS
    prefix, colon, rest = pattern.partition(":")
    for kind in FRAME_KINDS:
        if colon and prefix == kind:
            kinds = (kind,)
            pattern = rest
    for kind in kinds:
        if pattern in names[kind]:
            return kind, [pattern], []
    first_mistakes: list[Problem] = []
    for kind in kinds:
        ids, mistakes = match_every(pattern, names[kind], kind, path)
        if ids:
            return kind, [names[kind][i] for i in ids], mistakes
        first_mistakes = first_mistakes or mistakes
    if len(kinds) == 1 or "malformed" in first_mistakes[0].message:
        return None, [], first_mistakes
    links = names["link"]
    message = f"no link, site or geom matches {pattern!r}; links: {listing(links, pattern)}"
    for kind in ("site", "geom"):
        if names[kind]:
            message += f"; {kind}s: {listing(names[kind], pattern)}"
    every_name = [name for kind in FRAME_KINDS for name in names[kind]]
    return None, [], [Problem(path, message, did_you_mean(pattern, every_name).strip())]


def _clash(name: str, alias: FrameAlias, names: Names) -> str | None:
    """Return why a name cannot be used: a frame of the file that it does not stand for has it."""
    for kind in FRAME_KINDS:
        if name in names[kind] and alias != FrameAlias(kind, (name,)):
            frames = ", ".join(alias.frames)
            return f"the file has a {kind} {name!r} already, and this would be {frames}"
    return None


def with_file_names(cfg: ArticulationCfg) -> ArticulationCfg:
    """Return a config whose keys besides `names` have the file's names for those of `names`."""
    if not cfg.names:
        return cfg
    changed: dict[str, Any] = {
        "attachments": {
            name: replace(part, link=_one(part.link, cfg)) if part.link else part
            for name, part in cfg.attachments.items()
        },
        "collision_shapes": _with_patterns(cfg.collision_shapes, cfg),
        "contact": _with_patterns(cfg.contact, cfg),
        "self_collision": replace(
            cfg.self_collision,
            exclude=[(_pattern(a, cfg), _pattern(b, cfg)) for a, b in cfg.self_collision.exclude],
            include=[(_pattern(a, cfg), _pattern(b, cfg)) for a, b in cfg.self_collision.include],
        ),
    }
    if isinstance(cfg, RobotCfg):
        changed["attach"] = {
            name: replace(file, to=_one(file.to, cfg)) for name, file in cfg.attach.items()
        }
        if isinstance(cfg.solver_cfg, Mapping):
            changed["solver_cfg"] = {
                part: replace(solver, end_link_name=_one(solver.end_link_name, cfg))
                if solver.end_link_name
                else solver
                for part, solver in cfg.solver_cfg.items()
            }
    return replace(cfg, **changed)


def with_file_names_in(
    changes: Sequence[DriveChange], cfg: ArticulationCfg
) -> Sequence[DriveChange]:
    """Return changes of links with the file's names for those of a config's `names`."""
    if not cfg.names:
        return changes
    return [
        change
        if change.names is None
        else replace(change, names=tuple(_pattern(name, cfg) for name in change.names))
        for change in changes
    ]


def _one(name: str, cfg: ArticulationCfg) -> str:
    """Return what a name stands for where one link is wanted; a list stays a mistake there."""
    value = cfg.names.get(name, name)
    if isinstance(value, str):
        return value.removeprefix("link:")
    return value[0] if len(value) == 1 else name


def _pattern(name: str, cfg: ArticulationCfg) -> str:
    """Return the regex that a name stands for."""
    if name not in cfg.names:
        return name
    patterns = [pattern.removeprefix("link:") for pattern in _as_list(cfg.names[name])]
    return patterns[0] if len(patterns) == 1 else "|".join(f"(?:{p})" for p in patterns)


def _with_patterns(values: Mapping[str, Any], cfg: ArticulationCfg) -> dict[str, Any]:
    return {_pattern(name, cfg): value for name, value in values.items()}
