"""The metadata record `embodichain`: what a reader needs before the first message."""

from __future__ import annotations

import json
import uuid
from collections.abc import Mapping
from dataclasses import MISSING, Field, dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco

from embodichain.lab.gym.envs.action_columns import ActionColumn, action_columns
from embodichain.lab.sim.engine.engine_register import (
    ENGINES,
    find_recorded,
    recorded_name,
    split_recorded,
)
from embodichain.lab.sim.engine.fields import row_layout
from embodichain.recording.format.log_error import LARGEST_CHUNK, DamageError, LogError
from embodichain.recording.format.messages.columns import moved_ranges
from embodichain.recording.format.options import RecordOptions
from embodichain.recording.format.seals import SEAL, check_seal, sealed
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.observers import ObservedEnv
    from embodichain.lab.sim.engine.api import Engine

__all__ = [
    "FORMAT_VERSION",
    "METADATA",
    "METADATA_END",
    "METADATA_RECOVERED",
    "MUJOCO",
    "Header",
    "check_header",
    "check_keyframes",
    "check_part",
    "header_of",
    "why_unverifiable",
]

METADATA = "embodichain"
METADATA_END = "embodichain.end"
METADATA_RECOVERED = "embodichain.recovered"
"""Record of a file that was recovered from a broken one: the source, and why the log ends."""
MUJOCO = "mujoco"
"""The engine that simulates logs again, to the bit where it, or one like it, recorded them."""
FORMAT_VERSION = 4
"""Logs of other versions are refused."""
_LONGEST_STEP = 1e5
"""Seconds; longer steps are refused."""
_TEXT_FIELDS = frozenset(
    {
        "task",
        "mujoco_version",
        "model",
        "state",
        "unverifiable",
        "log_id",
        "policy",
        "engine",
        "writes",
    }
)
"""Fields of the header that are written as they are, all others as JSON."""


@dataclass(frozen=True, slots=True)
class Header:
    """What was recorded, and how to read its rows (full states).

    Attributes:
        task: Name of the task.
        seed: The environment's seed.
        num_envs: Number of environments N.
        control_dt: Length of a control step in seconds.
        physics_dt: Length of a physics step in seconds.
        substeps: Physics steps per control step (decimation).
        start_ns: Wall clock of the run's start; log time is this + control step x period.
        mujoco_version: Version of MuJoCo that simulated the run.
        model: Digest of the attachment model.mjb.
        state: ``all``, ``keyframes`` or ``none``.
        nstate: Number of columns of a full row (`mjSTATE_INTEGRATION`).
        moved: Columns that a physics step may write, as half-open ranges; only these are recorded
            after physics.
        layout: Component of the row to its (start, stop) columns.
        view_envs: Environments shown to viewers.
        unverifiable: Why this log cannot be verified; empty if it can.
        keyframe_every: Control steps between states if `state` is ``keyframes``.
        every: k if only every k-th episode is in the log; else 1.
        log_id: Identifier of the recording; the same in all files of a log.
        part: Index of the file within its log, from 0.
        first_step: First control step of the file.
        call_steps: Physics steps of each physics call of a control step; 0 is all of them, in one.
        policy: The source of the actions: name or path of a policy, ``teleop`` for a person; empty
            if it is not known.
        engine: What computed physics: ``mujoco``, or another engine with its version and, if it is
            not of this package, its package: ``counting 1.0 of my-package``.
        writes: ``all``; or ``none`` with arrays on a device: instead of each write, the log has the
            differences between states before and after physics and after resets.
        action: Meaning of each number of an action, see `ActionColumn.to_dict`; empty if it is not
            known.
        quota: How many episodes of each environment count, its first ones; empty if the log does
            not say.
        lists_counted: Whether the channel `/counted` lists the episodes that count.
        attachments: Name of each attachment to the bytes to which it unpacks, and its digest
            (`seals.digest_of`); empty in logs of versions up to 0.1.
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
    nstate: int
    moved: list[tuple[int, int]]
    layout: dict[str, tuple[int, int]]
    view_envs: list[int]
    unverifiable: str = ""
    keyframe_every: int = 0
    every: int = 1
    log_id: str = ""
    part: int = 0
    first_step: int = 0
    call_steps: int = 0
    policy: str = ""
    engine: str = MUJOCO
    writes: str = "all"
    action: tuple[dict[str, Any], ...] = ()
    quota: tuple[int, ...] = ()
    lists_counted: bool = False
    attachments: dict[str, tuple[int, str]] = field(default_factory=dict)

    def to_metadata(self) -> dict[str, str]:
        """Return the fields as strings, text as it is and everything else as JSON; sealed."""
        out = {"format_version": str(FORMAT_VERSION)}
        for name in self.__slots__:
            value = getattr(self, name)
            out[name] = value if isinstance(value, str) else json.dumps(value)
        return sealed(METADATA, out)

    @classmethod
    def from_metadata(cls, values: Mapping[str, str]) -> Header:
        """Read the record.

        Raises:
            LogError: If it was written by another version, is incomplete, or its digest is wrong.
        """
        try:
            check_header(values)
        except DamageError as error:
            raise LogError(f"the metadata record {METADATA!r} is damaged: {error}") from error
        version = values.get("format_version", "")
        if version != str(FORMAT_VERSION):
            raise LogError(
                f"the log has format version {version or 'none'!r}; this reads {FORMAT_VERSION}"
            )
        # Fields with a default were added later and may be missing in older logs.
        names = [f.name for f in fields(cls) if f.name in values or _is_required(f)]
        try:
            entries: dict[str, Any] = {}
            for name in names:
                value = values[name]
                entries[name] = value if name in _TEXT_FIELDS else json.loads(value)
            entries["moved"] = [(int(start), int(stop)) for start, stop in entries["moved"]]
            entries["layout"] = {
                component: (int(start), int(stop))
                for component, (start, stop) in entries["layout"].items()
            }
            entries["action"] = tuple(entries.get("action", ()))
            entries["quota"] = tuple(entries.get("quota", ()))
            entries["attachments"] = {
                attachment: (int(size), str(digest))
                for attachment, (size, digest) in entries.get("attachments", {}).items()
            }
            header = cls(**entries)
            header._check()
        except (AttributeError, KeyError, TypeError, ValueError, RecursionError) as error:
            raise LogError(f"the metadata record {METADATA!r} is damaged: {error!r}") from error
        return header

    def _check(self) -> None:
        """Raise ValueError unless the sizes are consistent and arrays of them can be allocated."""
        wrong = []
        for name in ("seed", "num_envs", "substeps", "start_ns", "nstate"):
            if type(getattr(self, name)) is not int:
                wrong.append(name)
        for name in ("keyframe_every", "every", "part", "first_step", "call_steps"):
            value = getattr(self, name)
            if type(value) is not int or not 0 <= value < 2**62:
                wrong.append(name)
        for name in ("num_envs", "substeps", "nstate"):
            if not getattr(self, name) > 0:
                wrong.append(name)
        for name in ("control_dt", "physics_dt"):
            if not 0 < getattr(self, name) <= _LONGEST_STEP:
                wrong.append(name)
        edges = [edge for span in self.moved for edge in span]
        if edges != sorted(edges) or not edges or edges[0] < 0 or edges[-1] > self.nstate:
            wrong.append("moved")
        if any(not 0 <= a <= b <= self.nstate for a, b in self.layout.values()):
            wrong.append("layout")
        if {"qpos", "qvel"} - self.layout.keys():
            wrong.append("layout")
        if not all(type(i) is int and 0 <= i < self.num_envs for i in self.view_envs):
            wrong.append("view_envs")
        if self.call_steps and self.substeps % self.call_steps:
            wrong.append("call_steps")
        if 8 * self.num_envs * self.nstate > LARGEST_CHUNK:
            wrong.append("num_envs")
        if not 0 <= self.start_ns < 2**62:
            wrong.append("start_ns")
        if (self.state == "keyframes") != (self.keyframe_every > 0):
            wrong.append("keyframe_every")
        if not all(map(_is_column, self.action)):
            wrong.append("action")
        if len(self.quota) not in (0, self.num_envs):
            wrong.append("quota")
        if not all(type(count) is int and count >= 0 for count in self.quota):
            wrong.append("quota")
        lists_counted: Any = self.lists_counted  # metadata may have a value of any type
        if type(lists_counted) is not bool:
            wrong.append("lists_counted")
        if self.writes not in ("all", "none"):
            wrong.append("writes")
        if wrong:
            raise ValueError(f"impossible values of {', '.join(dict.fromkeys(wrong))}")

    def check_env(self, env: int) -> None:
        """Raise `ConfigError` unless the log has the environment."""
        if not 0 <= env < self.num_envs:
            available = f"there are 0 to {self.num_envs - 1}"
            raise ConfigError(f"no environment {env} in the log: {available}")

    def require_states(self, path: Path) -> None:
        """Raise `LogError` if the log has no states.

        Args:
            path: The log, for the message.

        Raises:
            LogError: If the log has no states.
        """
        if self.state == "none":
            raise LogError(f"{path} has no states: it was recorded with record.state=none")

    @property
    def period_ns(self) -> int:
        """Length of a control step in nanoseconds."""
        return round(self.control_dt * 1e9)

    @property
    def recorded_with(self) -> str:
        """What simulated the run, with versions."""
        if self.engine == MUJOCO:
            return f"MuJoCo {self.mujoco_version}"
        return f"{self.engine}, MuJoCo {self.mujoco_version}"

    @property
    def unknown_engine(self) -> str:
        """Why physics of the log's engine cannot be compared; empty if it can."""
        if find_recorded(self.engine) is not None:
            return ""
        name, package = split_recorded(self.engine)
        broken = "".join(f"; {reason}" for reason in ENGINES.broken)
        if package:
            message = f"it was recorded with {name!r}, an engine of the package {package!r}"
            return f"{message}, which has none of this name here: pip install {package}{broken}"
        return (
            f"it was recorded with {name!r}, an engine that is not registered here; there are: "
            f"{', '.join(ENGINES)}. A package that has it has an entry point of the group "
            f"{ENGINES.group}{broken}"
        )

    @property
    def is_exact(self) -> bool:
        """Whether `mujoco.batch` computes the same results as the log's engine, to the bit."""
        kind = find_recorded(self.engine)
        return kind is not None and kind.is_exact

    @property
    def has_writes(self) -> bool:
        """Whether resets and events can be carried out again."""
        return self.writes == "all"

    @property
    def every_note(self) -> str:
        """Which episodes `record.every` left out; empty if none."""
        if self.every <= 1:
            return ""
        counted_env = next(iter(self.view_envs), 0)
        return f"only one in {self.every} episodes of environment {counted_env} is in the log"

    def part_note(self, alone: str) -> str:
        """Which part of a log a file is; empty for a whole log.

        Args:
            alone: The text about the next file if that was not read; else empty.
        """
        if not self.part and not alone:
            return ""
        part = f"file {self.part + 1} of a log, from step {self.first_step} on"
        return f"{part}; {alone or 'its last file'}"

    @property
    def moved_width(self) -> int:
        """Number of columns that physics writes."""
        return sum(stop - start for start, stop in self.moved)

    def slices(self) -> dict[str, slice]:
        """The layout as slices."""
        return {name: slice(start, stop) for name, (start, stop) in self.layout.items()}


def _is_required(entry: Field[Any]) -> bool:
    return entry.default is MISSING and entry.default_factory is MISSING


def check_header(values: Mapping[str, str]) -> bool:
    """Check the digest of the record `METADATA`; return whether it has one.

    Versions up to 0.1 wrote none. A record without one has only entries that they wrote, else its
    digest was lost.

    Raises:
        DamageError: If the digest is wrong or lost.
    """
    if check_seal(METADATA, values):
        return True
    allowed = {entry.name for entry in fields(Header)} - {"attachments"} | {"format_version"}
    for key in values:
        if key not in allowed:
            raise DamageError(f"it has no {SEAL!r} and an entry {key[:40]!r}")
    return False


def _is_column(column: Any) -> bool:
    """Whether this is a column of an action."""
    if not isinstance(column, dict):
        return False
    expected_keys = {field.name for field in fields(ActionColumn)}
    return expected_keys <= column.keys() and isinstance(column["name"], str)


def check_part(first: Header, values: Mapping[str, str], part: int) -> None:
    """Raise `DamageError` unless a file is the given part of a log.

    Args:
        first: Header of the log's first file.
        values: The metadata record of the file.
        part: The expected index of the file.
    """
    try:
        header = Header.from_metadata(values)
    except LogError as error:
        raise DamageError(str(error)) from error
    shared = ("log_id", "model", "num_envs", "nstate", "moved", "layout", "start_ns", "state")
    for name in shared:
        if not first.log_id or getattr(first, name) != getattr(header, name):
            raise DamageError("it is part of another log")
    if header.part != part:
        raise DamageError(f"it is part {header.part} of the log, not {part}")


def header_of(
    env: ObservedEnv,
    options: RecordOptions,
    model_digest: str,
    task: str,
    policy: str,
    start_ns: int,
) -> Header:
    """The metadata of a new recording.

    Args:
        env: The environment that is recorded.
        options: The recorder's options.
        model_digest: Digest of the compiled model.
        task: The task's name.
        policy: The source of the actions.
        start_ns: Wall clock in ns.
    """
    model = env.sim.engine.model
    layout = row_layout(model)
    nstate = max(columns.stop for columns in layout.values())
    # MuJoCo's automatic reset within a step, and plugins, write inputs too.
    may_reset = not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_AUTORESET
    moved = moved_ranges(layout)
    if may_reset or model.nplugin:
        moved = [(0, nstate)]
    return Header(
        task=task,
        seed=int(env.seed_value),
        num_envs=env.num_envs,
        control_dt=float(env.step_dt),
        physics_dt=float(env.physics_dt),
        substeps=int(env.sim_steps_per_control),
        start_ns=start_ns,
        mujoco_version=mujoco.__version__,
        model=model_digest,
        state=options.state,
        nstate=nstate,
        moved=moved,
        layout={name: (columns.start, columns.stop) for name, columns in layout.items()},
        view_envs=[int(i) for i in options.view_envs],
        unverifiable=why_unverifiable(model, options.state),
        keyframe_every=options.keyframe_every if options.state == "keyframes" else 0,
        every=options.every,
        log_id=uuid.uuid4().hex,
        call_steps=int(env.physics_steps_per_call),
        policy=policy,
        engine=recorded_name(env.sim.engine),
        writes="all" if env.sim.engine.reports_writes else "none",
        action=_action_of(env),
    )


def _action_of(env: Any) -> tuple[dict[str, Any], ...]:
    """What an environment's actions mean; empty for one without an action manager."""
    if getattr(env, "action_manager", None) is None:
        return ()
    return tuple(column.to_dict() for column in action_columns(env))


def why_unverifiable(model: mujoco.MjModel, state: str) -> str:
    """Why rows do not contain everything that physics depends on; empty if they do."""
    if state == "none":
        return "no states were recorded (record.state: none)"
    if int(model.opt.enableflags) & int(mujoco.mjtEnableBit.mjENBL_SLEEP):
        return "the model lets bodies sleep, which the state rows do not contain"
    if model.nplugin:
        return "the model has plugins, which may keep state outside the state rows"
    return ""


def check_keyframes(options: RecordOptions, engine: Engine) -> None:
    """Raise `ConfigError` if states between keyframes could not be simulated again."""
    if options.state != "keyframes":
        return
    reason = why_unverifiable(engine.model, "all")
    if engine.name != MUJOCO:
        reason = f"{engine.name} is not repeated to the bit"
    if reason:
        message = f"keyframes cannot be replayed: {reason}; use record.state=all"
        raise ConfigError([Problem("record.state", message)])
