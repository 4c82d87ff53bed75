"""Shapes fixed on links of an articulation: pushers, tools, payloads."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np

from embodichain.lab.sim.cfg import AttachmentCfg
from embodichain.lab.sim.compiler.objects import add_shape, check_shape, set_contact
from embodichain.lab.sim.compiler.pose import initial_pose
from embodichain.lab.sim.shapes import PlaneCfg
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean

__all__ = ["add_attachments", "check_attachments"]

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
