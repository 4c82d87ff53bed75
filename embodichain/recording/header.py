"""The metadata record `embodichain`: what a reader must know before the first message."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import mujoco

from embodichain.recording.mcap_file import CHUNK_LIMIT
from embodichain.utils.errors import ConfigError

__all__ = [
    "FORMAT_VERSION",
    "METADATA",
    "METADATA_END",
    "METADATA_RECOVERED",
    "Header",
    "LogError",
    "why_unverifiable",
]

METADATA = "embodichain"
METADATA_END = "embodichain.end"
METADATA_RECOVERED = "embodichain.recovered"
"""In a file that was saved from a broken one: from which, and why it ends where it does."""
FORMAT_VERSION = 1
_LONGEST_STEP = 1e5
"""Seconds; a longer step is not believed."""


class LogError(ConfigError):
    """A file is MCAP, but not a log that this version can replay."""


@dataclass(frozen=True, slots=True)
class Header:
    """What was recorded, and how to read its rows.

    Attributes:
        task: Name of the task.
        seed: The environment's seed.
        num_envs: N.
        control_dt: Seconds a control step.
        physics_dt: Seconds a physics step.
        substeps: Physics steps a control step.
        start_ns: Wall clock of the run's start; log time is this + control step x period.
        mujoco_version: Version whose physics this is.
        model: Digest of the attachment model.mjb.
        state: ``all`` or ``none``.
        state_sig: MuJoCo's state specification (`mjSTATE_INTEGRATION`).
        nstate: Columns of a whole row.
        columns: Half-open ranges of columns in messages narrower than `nstate`; the others are 0.
        layout: Component of the row to its (start, stop) columns.
        view_envs: Environments shown to viewers.
        unverifiable: Why this log cannot be verified; empty if it can.
    """

    task: str
    seed: int
    num_envs: int
    control_dt: float
    physics_dt: float
    substeps: int
    start_ns: int
    mujoco_version: str
    model: str
    state: str
    state_sig: int
    nstate: int
    columns: list[tuple[int, int]]
    layout: dict[str, tuple[int, int]]
    view_envs: list[int]
    unverifiable: str = ""

    def to_metadata(self) -> dict[str, str]:
        """As strings: plain for text, JSON for everything else."""
        out = {"format_version": str(FORMAT_VERSION)}
        for name in self.__slots__:
            value = getattr(self, name)
            out[name] = value if isinstance(value, str) else json.dumps(value)
        return out

    @classmethod
    def from_metadata(cls, values: Mapping[str, str]) -> Header:
        """Read the record.

        Raises:
            LogError: If it was written by a later version, or lacks something.
        """
        version = values.get("format_version", "")
        if version != str(FORMAT_VERSION):
            raise LogError(
                f"the log has format version {version or 'none'!r}; this reads {FORMAT_VERSION}"
            )
        text = {"task", "mujoco_version", "model", "state", "unverifiable"}
        try:
            fields: dict[str, Any] = {
                k: values[k] if k in text else json.loads(values[k]) for k in cls.__slots__
            }
            fields["columns"] = [(int(a), int(b)) for a, b in fields["columns"]]
            fields["layout"] = {k: (int(a), int(b)) for k, (a, b) in fields["layout"].items()}
            header = cls(**fields)
            header._check()
        except (AttributeError, KeyError, TypeError, ValueError, RecursionError) as error:
            raise LogError(f"the metadata record {METADATA!r} is damaged: {error!r}") from error
        return header

    def _check(self) -> None:
        """Raise ValueError unless arrays of these sizes can be made and filled."""
        whole = ("seed", "num_envs", "substeps", "start_ns", "state_sig", "nstate")
        wrong = [name for name in whole if type(getattr(self, name)) is not int]
        wrong += [n for n in ("num_envs", "substeps", "nstate") if not getattr(self, n) > 0]
        for name in ("control_dt", "physics_dt"):
            if not 0 < getattr(self, name) <= _LONGEST_STEP:
                wrong.append(name)
        at = 0
        for start, stop in self.columns:
            if not at <= start <= stop <= self.nstate:
                wrong.append("columns")
            at = stop
        if any(not 0 <= a <= b <= self.nstate for a, b in self.layout.values()):
            wrong.append("layout")
        if {"qpos", "qvel"} - self.layout.keys():
            wrong.append("layout")
        if self.state_sig != int(mujoco.mjtState.mjSTATE_INTEGRATION):
            wrong.append("state_sig")
        if not all(type(i) is int and 0 <= i < self.num_envs for i in self.view_envs):
            wrong.append("view_envs")
        if 8 * self.num_envs * self.nstate > CHUNK_LIMIT:
            wrong.append("num_envs")
        if not 0 <= self.start_ns < 2**62:
            wrong.append("start_ns")
        if wrong:
            raise ValueError(f"impossible values of {', '.join(dict.fromkeys(wrong))}")

    @property
    def period_ns(self) -> int:
        """Nanoseconds a control step."""
        return round(self.control_dt * 1e9)

    def slices(self) -> dict[str, slice]:
        """The layout as slices."""
        return {name: slice(a, b) for name, (a, b) in self.layout.items()}


def why_unverifiable(model: mujoco.MjModel, state: str) -> str:
    """Why rows do not hold all that physics depends on; empty if they do."""
    if state == "none":
        return "no states were recorded (record.state: none)"
    if int(model.opt.enableflags) & int(mujoco.mjtEnableBit.mjENBL_SLEEP):
        return "the model lets bodies sleep, which the state rows do not hold"
    if model.nplugin:
        return "the model has plugins, which may keep state outside the state rows"
    return ""
