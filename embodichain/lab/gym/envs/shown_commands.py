"""Commands of a task that pictures for people show: those in force, and those that a log has."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import mujoco

from embodichain.lab.gym.envs.cfg import EnvCfg
from embodichain.lab.gym.envs.managers.random_managers import CommandManager
from embodichain.lab.sim.drawing.command_arrows import height_above
from embodichain.lab.sim.drawing.commands import ShownCommand, Tolerance

__all__ = ["commands_in_force", "tolerance_of"]

_FOLLOWS = "follows_velocity"
"""The term whose thresholds say when a velocity is as commanded."""


def commands_in_force(
    manager: CommandManager, cfg: EnvCfg, model: mujoco.MjModel
) -> list[ShownCommand]:
    """Return the commands that have a marker, with live values.

    Args:
        manager: The commands; their arrays are on the host.
        cfg: The task.
        model: The compiled scene.
    """
    metrics = {name: (str(term.func), term.params) for name, term in cfg.metrics.items()}
    commands: list[ShownCommand] = []
    for name, term in manager.terms.items():
        marker = term.instance.marker
        if marker is None:
            continue
        command = ShownCommand(
            kind=marker.kind,
            body=marker.body,
            values=term.instance.values,
            tolerance=tolerance_of(name, metrics),
            height=height_above(model, marker.body),
        )
        commands.append(command)
    return commands


def tolerance_of(
    command: str, metrics: Mapping[str, tuple[str, Mapping[str, Any]]]
) -> Tolerance | None:
    """Return when a velocity is as commanded: what the task's metric asks for; None without one.

    Args:
        command: Its name.
        metrics: Name -> function and parameters.
    """
    for func, params in metrics.values():
        if func == _FOLLOWS and params.get("command_name") == command:
            return Tolerance(params["linear_threshold"], params.get("angular_threshold"))
    return None
