"""Links that a config adds to a file's: shapes fixed on links, and tool points of control parts."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import mujoco
import numpy as np

from embodichain.lab.sim.cfg import ArticulationCfg, AttachmentCfg, ObjectBaseCfg, SolverCfg
from embodichain.lab.sim.compiler.index import F64
from embodichain.lab.sim.compiler.rigid_math import initial_pose
from embodichain.lab.sim.compiler.rigid_objects import add_shape, check_shape, set_contact
from embodichain.lab.sim.shapes import PlaneCfg
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean

__all__ = ["WHOLE", "Tool", "add_attachments", "add_tools", "check_attachments", "resolve_tools"]

_WHOLE = np.ones(3)


def check_attachments(
    spec: mujoco.MjSpec, attachments: Mapping[str, AttachmentCfg]
) -> list[Problem]:
    """Return every mistake, with paths below the articulation's config."""
    links = [body.name for body in spec.bodies[1:]]  # the first is the world
    problems: list[Problem] = []
    for name, cfg in attachments.items():
        path = f"attachments.{name}"
        if name in links:
            problems.append(Problem(path, "the file has a link of that name already"))
        if cfg.link not in links:
            message = f"no link is called {cfg.link!r}; there are: {', '.join(links)}"
            problems.append(Problem(f"{path}.link", message, did_you_mean(cfg.link, links).strip()))
        if isinstance(cfg.shape, PlaneCfg):
            problems.append(Problem(f"{path}.shape", "a Plane cannot move"))
        found = check_shape(cfg.shape, _WHOLE)
        try:
            initial_pose(cfg)
        except ConfigError as error:
            found += error.problems
        problems += [Problem(f"{path}.{p.path}", p.message, p.hint) for p in found]
    return problems


def add_attachments(spec: mujoco.MjSpec, attachments: Mapping[str, AttachmentCfg]) -> None:
    """Add a body with one geom for each, as a child of its link; they are checked already."""
    for number, (name, cfg) in enumerate(attachments.items()):
        pos, quat = initial_pose(cfg)
        body = spec.body(cfg.link).add_body(name=name, pos=pos, quat=quat)
        geom = add_shape(spec, body, name, cfg.shape, _WHOLE, number)
        geom.mass = float(cfg.mass)
        set_contact(body, float(cfg.dynamic_friction), cfg.enable_collision)


WHOLE = "default"
"""EmbodiChain's name of the part that is the whole robot."""


class Tool:
    """The tool point of a part.

    Attributes:
        end_link: The link that carries it.
        pose: Its position (3,) in metres and wxyz orientation in that link's frame; None is the
            link's own frame.
        link: The link that is the tool point.
    """

    def __init__(self, part: str, end_link: str, pose: tuple[F64, F64] | None) -> None:
        self.end_link = end_link
        self.pose = pose
        name = "tcp" if part == WHOLE else f"{part}_tcp"
        self.link = end_link if pose is None else name


def resolve_tools(
    cfg: ArticulationCfg, parts: Collection[str], links: Sequence[str]
) -> tuple[dict[str, Tool], list[Problem]]:
    """Return the tool point of each part that `solver_cfg` gives one, and every mistake.

    Args:
        cfg: The articulation's config.
        parts: Its control parts.
        links: The links of its file.
    """
    tools: dict[str, Tool] = {}
    problems: list[Problem] = []
    given = getattr(cfg, "solver_cfg", None) or {}
    solvers: Mapping[str, SolverCfg] = {WHOLE: given} if isinstance(given, SolverCfg) else given
    for part, solver in solvers.items():
        path = f"solver_cfg.{part}"
        if part not in parts and part != WHOLE:
            known = ", ".join([*parts, WHOLE])
            message = f"no control part is called {part!r}; there are: {known}"
            problems.append(Problem(path, message, did_you_mean(part, parts).strip()))
        for key in ("root_link_name", "end_link_name"):
            name = getattr(solver, key)
            if name is not None and name not in links:
                message = f"no link is called {name!r}; there are: {', '.join(links)}"
                hint = did_you_mean(name, links).strip()
                problems.append(Problem(f"{path}.{key}", message, hint))
        pose, wrong = _point(solver, path)
        problems += wrong
        if solver.end_link_name is not None:
            tools[part] = tool = Tool(part, solver.end_link_name, pose)
            if pose is not None and tool.link in links:
                message = f"the file has a link called {tool.link!r} already"
                problems.append(Problem(f"{path}.tcp", message))
        elif pose is not None:
            message = "missing value: tcp is a pose in the frame of this link"
            problems.append(Problem(f"{path}.end_link_name", message))
    return tools, problems


def _point(solver: SolverCfg, path: str) -> tuple[tuple[F64, F64] | None, list[Problem]]:
    if solver.tcp is None or np.array_equal(np.asarray(solver.tcp), np.eye(4)):
        return None, []
    try:
        return initial_pose(ObjectBaseCfg(init_local_pose=solver.tcp)), []
    except ConfigError as error:
        return None, [Problem(f"{path}.tcp", p.message) for p in error.problems]


def add_tools(spec: mujoco.MjSpec, tools: Mapping[str, Tool]) -> None:
    """Add a massless body for each tool point that is not a link's own frame."""
    for tool in tools.values():
        if tool.pose is not None:
            pos, quat = tool.pose
            spec.body(tool.end_link).add_body(name=tool.link, pos=pos, quat=quat)
