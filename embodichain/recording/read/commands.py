"""`RecordedCommands`: commands of a viewed environment, for pictures of its steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.shown_commands import tolerance_of
from embodichain.lab.sim.drawing.command_arrows import height_above
from embodichain.lab.sim.drawing.commands import ShownCommand
from embodichain.recording.format.messages.schema import identifier
from embodichain.recording.read.chunks import LogReader
from embodichain.recording.read.events import read_metrics
from embodichain.recording.read.trajectory import Span

__all__ = ["RecordedCommands"]

_VELOCITY = ("lin_vel_x", "lin_vel_y", "ang_vel_z")
_POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")


class RecordedCommands:
    """The commands of an environment as a log samples them; between two samples, the earlier one's.

    Args:
        reader: The log.
        task: The task's config.
        model: The compiled scene.
        env: The environment; of one that was not viewed, no commands are known.
        span: The control steps.

    Raises:
        LogError: If a message is damaged.
    """

    def __init__(
        self,
        reader: LogReader,
        task: Mapping[str, Any],
        model: mujoco.MjModel,
        env: int,
        span: Span,
    ) -> None:
        self._steps = np.zeros(0, np.int64)
        self._commands: list[ShownCommand] = []  # with a row for each sample
        declared = task.get("commands") or {}
        if not declared or env not in reader.require_header().view_envs:
            return
        self._steps, columns = read_metrics(reader, env, span)
        if not len(self._steps):
            return
        metrics = {
            name: (str(metric.get("func")), metric.get("params") or {})
            for name, metric in (task.get("metrics") or {}).items()
        }
        for name, term in declared.items():
            params = term.get("params") or {}
            command = _command_of(name, params, columns, model)
            if command is not None:
                self._commands.append(replace(command, tolerance=tolerance_of(name, metrics)))

    def at(self, step: int) -> list[ShownCommand]:
        """The commands at a control step, of one environment."""
        if not self._commands:
            return []
        row = max(int(np.searchsorted(self._steps, step, side="right")) - 1, 0)
        return [command.of_env(row) for command in self._commands]


def _command_of(
    name: str,
    params: Mapping[str, Any],
    columns: Mapping[str, NDArray[np.float64]],
    model: mujoco.MjModel,
) -> ShownCommand | None:
    """A command whose columns are those of a velocity or of a pose, with a row for each sample."""
    of = params.get("of") or params.get("entity_cfg")
    root = _root_of(of, model) if isinstance(of, Mapping) else None
    if of is None or root is None:
        return None
    velocity = _stack(name, _VELOCITY, columns)
    if velocity is not None:
        body = _picked_body(of, model, root)
        height = height_above(model, body)
        return ShownCommand(kind="velocity", body=body, values=velocity, height=height)
    pose = _stack(name, _POSE, columns)
    if pose is not None:
        return ShownCommand(kind="pose", body=root, values=pose)
    return None


def _stack(
    name: str, labels: Sequence[str], columns: Mapping[str, NDArray[np.float64]]
) -> NDArray[np.float64] | None:
    """(S, K) the columns of a command; None if it has others."""
    names = [identifier(f"command_{name}_{label}") for label in labels]
    if not all(column in columns for column in names):
        return None
    return np.stack([columns[column] for column in names], axis=1)


def _root_of(of: Mapping[str, Any], model: mujoco.MjModel) -> int | None:
    """The first body of an entity."""
    uid = str(of.get("uid"))
    for body in range(1, model.nbody):
        name = model.body(body).name
        if name == uid or name.startswith(f"{uid}/"):
            return body
    return None


def _picked_body(of: Mapping[str, Any], model: mujoco.MjModel, root: int) -> int:
    """The link that a reference names, if it names one, else the root."""
    links = of.get("link_names")
    names = [links] if isinstance(links, str) else list(links or [])
    if len(names) != 1:
        return root
    link = f"{of.get('uid')}/{names[0]}"
    body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, link)
    return root if body < 0 else body
