"""Messages for viewers, one encoder per channel: `/tf`, joint states, metrics, lines of `/log`.

Frames are named ``env_I/uid/link``; their parent is ``env_I``, whose parent is ``world``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.Log_pb2 import Log
from numpy.typing import NDArray

from embodichain.lab.gym.envs.managers.value_managers import TermRows
from embodichain.lab.sim.engine.api import F64
from embodichain.lab.sim.engine.fields import row_layout
from embodichain.recording.format.messages.schema import (
    identifier,
    scalars_class,
    scalars_descriptor_set,
)
from embodichain.utils.number_text import result_number

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.observers import StepRecord

__all__ = [
    "METRICS",
    "Frames",
    "Joints",
    "Scalars",
    "ending_text",
    "event_text",
    "frame_names",
    "ids_text",
    "log_line",
    "scalar_joints",
]

METRICS = "Metrics"
"""Name of the message with the scalars of a run."""
_SCALAR_JOINTS = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
_COUNTS = ("elapsed_steps", "success", "fail")
_GROUPS = (("rewards", "reward"), ("episode_sums", "sum"), ("metrics", "metric"))
_REASONS = {"success": "success_terminated", "fail": "fail", "diverged": "diverged"}
"""Reason of an end -> the entry of ``info`` that says so."""
_MOST_LISTED = 8
"""Largest count of numbers or environments in a line of `/log`."""


def frame_names(model: mujoco.MjModel, env_id: int) -> list[str]:
    """Frames of an environment's bodies by body id; the first one is the environment's frame."""
    root = f"env_{env_id}"
    names = (model.body(i).name or f"body_{i}" for i in range(1, model.nbody))
    return [root, *(f"{root}/{name}" for name in names)]


def scalar_joints(model: mujoco.MjModel) -> dict[str, int]:
    """Ids of the hinge and slide joints by name."""
    joints = [joint for joint in range(model.njnt) if model.jnt_type[joint] in _SCALAR_JOINTS]
    return {model.joint(joint).name or f"joint_{joint}": joint for joint in joints}


class Frames:
    """`/tf`: one `FrameTransforms` for all viewed environments, updated for each sample.

    The parent of every body's frame is the environment's frame, so no poses are multiplied, and a
    viewer that misses one frame still shows the others.

    Args:
        model: The model; only names are read.
        env_ids: (n,) environments.
        offsets: (n, 3) positions of the environments in ``world``, metres.
    """

    def __init__(self, model: mujoco.MjModel, env_ids: Sequence[int], offsets: F64) -> None:
        self._message = FrameTransforms()
        add = self._message.transforms.add
        self._bodies = []
        for env_id, (x, y, z) in zip(env_ids, offsets.tolist(), strict=True):
            root, *names = frame_names(model, env_id)
            base = add(parent_frame_id="world", child_frame_id=root)
            base.translation.x = x
            base.translation.y = y
            base.translation.z = z
            base.rotation.w = 1.0
            frames = [add(parent_frame_id=root, child_frame_id=name) for name in names]
            self._bodies.append([(frame.translation, frame.rotation) for frame in frames])
        self._times = [frame.timestamp for frame in self._message.transforms]

    def place(self, index: int, data: mujoco.MjData) -> None:
        """Copy the body poses of the index-th environment from its kinematics."""
        positions = data.xpos[1:].tolist()
        quats = data.xquat[1:].tolist()
        bodies = zip(self._bodies[index], positions, quats, strict=True)
        for (translation, rotation), position, quat in bodies:
            translation.x, translation.y, translation.z = position
            rotation.w, rotation.x, rotation.y, rotation.z = quat

    def encode(self, time_ns: int) -> bytes:
        """Return the serialized message."""
        seconds, nanos = divmod(time_ns, 1_000_000_000)
        for timestamp in self._times:
            timestamp.seconds = seconds
            timestamp.nanos = nanos
        data: bytes = self._message.SerializeToString()
        return data


class Joints:
    """`/env_I/joint_states`: every hinge and slide joint, updated for each environment."""

    def __init__(self, model: mujoco.MjModel) -> None:
        joints = scalar_joints(model)
        layout = row_layout(model)
        ids = np.array(list(joints.values()), np.int64)
        self._qpos = layout["qpos"].start + model.jnt_qposadr[ids]
        self._qvel = layout["qvel"].start + model.jnt_dofadr[ids]
        self._message = JointStates()
        self._joints = [self._message.joints.add(name=name) for name in joints]

    def encode(self, time_ns: int, row: F64) -> bytes:
        """Return the serialized message of a state.

        Args:
            time_ns: Its time.
            row: (nstate,) state: positions (rad or m) and velocities (rad/s or m/s) are read.
        """
        timestamp = self._message.timestamp
        timestamp.seconds, timestamp.nanos = divmod(time_ns, 1_000_000_000)
        positions = row[self._qpos].tolist()
        velocities = row[self._qvel].tolist()
        for joint, qpos, qvel in zip(self._joints, positions, velocities, strict=True):
            joint.position = qpos
            joint.velocity = qvel
        data: bytes = self._message.SerializeToString()
        return data


class Scalars:
    """`/env_I/metrics`: the scalars of a step as flat fields of a message declared for the run.

    Plotting tools need flat fields; the fields depend on the task's terms.

    Args:
        step: Any step of the run.
        commands: Names of the columns of each command, and its (N, columns) values, not copied.
    """

    def __init__(self, step: StepRecord, commands: Sequence[tuple[list[str], F64]]) -> None:
        self._commands = [values.T for _, values in commands]
        self._counts = [key for key in _COUNTS if key in step.info]
        self._terms = {key: tuple(step.info.get(key, {})) for key, _ in _GROUPS}
        titles = ["reward", "terminated", "truncated", *self._counts]
        for key, prefix in _GROUPS:
            titles += [f"{prefix}_{name}" for name in self._terms[key]]
        for names, _ in commands:
            titles += [f"command_{name}" for name in names]
        self.names: list[str] = _field_names(titles)
        """Names of the fields."""
        self._message = scalars_class(METRICS, self.names)

    @property
    def descriptor_set(self) -> bytes:
        """Schema of the message."""
        return scalars_descriptor_set(METRICS, self.names)

    def sample(self, step: StepRecord, env_ids: Iterable[int]) -> list[list[float]]:
        """The scalars of environments in a step, in the order of `names`, for `encode`.

        Raises:
            ValueError: If the step has other scalars than the first one.
        """
        info = step.info
        blocks = [step.reward, step.terminated, step.truncated]
        try:
            for key in self._counts:
                blocks.append(_array(info[key]))
            for key, names in self._terms.items():
                blocks += _values_of_terms(info.get(key, {}), names)
        except KeyError as error:
            raise ValueError(
                f"a step's scalars are not those of the first one: {self.names}"
            ) from error
        blocks += self._commands
        # Numbers at once: fewer than the arrays, which the next step may change.
        return [_numbers_of(blocks, env_id) for env_id in env_ids]

    def encode(self, sample: Sequence[float], weights: Mapping[str, float]) -> bytes:
        """Return the serialized message of an environment.

        Args:
            sample: What `sample` returned of it.
            weights: Weights of the reward terms, by which their values are multiplied.
        """
        values = list(sample)
        first_reward = 3 + len(self._counts)  # after reward, terminated, truncated and counts
        for index, name in enumerate(self._terms["rewards"], first_reward):
            values[index] *= weights.get(name, 1.0)
        message = self._message(**dict(zip(self.names, values, strict=True)))
        data: bytes = message.SerializeToString()
        return data


def _numbers_of(blocks: Sequence[NDArray[Any]], env_id: int) -> list[float]:
    """The numbers of an environment in arrays (N,), and (K, N) of K numbers."""
    numbers: list[float] = []
    for block in blocks:
        if block.ndim == 1:
            numbers.append(block.item(env_id))
        else:
            numbers += block[:, env_id].tolist()
    return numbers


def _values_of_terms(group: Mapping[str, Any], names: Sequence[str]) -> list[NDArray[Any]]:
    """The values of these terms: one (K, N) array if they are together, else K arrays (N,).

    Raises:
        KeyError: If there are other terms.
    """
    if isinstance(group, TermRows) and tuple(group.names) == names:
        rows = group.rows
        return [rows] if isinstance(rows, np.ndarray) else list(rows)
    if len(group) != len(names):
        raise KeyError(names)
    return [_array(group[name]) for name in names]


def _array(value: Any) -> NDArray[Any]:
    """Return a tensor or an array as an array."""
    array: NDArray[Any] = value if type(value) is np.ndarray else value.numpy()
    return array


def _field_names(titles: Sequence[str]) -> list[str]:
    """Legal names of fields; of several that become equal, all but the first are numbered."""
    names: list[str] = []
    for name in map(identifier, titles):
        same = [other for other in names if other == name or other.startswith(f"{name}__")]
        names.append(f"{name}__{len(same) + 1}" if same else name)
    return names


# -- lines of `/log` -------------------------------------------------------------------------------


def log_line(time_ns: int, message: str, level: str = "INFO") -> bytes:
    """Return a serialized `foxglove.Log`."""
    line = Log(level=Log.Level.Value(level), message=message, name="embodichain")
    line.timestamp.FromNanoseconds(time_ns)
    data: bytes = line.SerializeToString()
    return data


def event_text(env_id: int, term: str, mode: str, drawn: Mapping[str, NDArray[Any]]) -> str:
    """``environment 0: place_cube (reset): position 0.58 0.14 0.05, rotation 0 0 0.16``."""
    text = f"environment {env_id}: {term} ({mode})"
    draws = []
    for name, values in drawn.items():
        numbers = [result_number(number) for number in np.asarray(values).reshape(-1).tolist()]
        draws.append(f"{name} {_listed(numbers, ' ')}")
    if draws:
        text += f": {', '.join(draws)}"
    return text


def ending_text(record: StepRecord, env_id: int) -> str:
    """``environment 0: episode 3 ended after 120 steps: success``."""
    reasons = [
        reason
        for reason, key in _REASONS.items()
        if key in record.info and bool(record.info[key][env_id])
    ]
    if not reasons:
        reasons = ["terminated" if record.terminated[env_id] else "out of time"]
    text = f"environment {env_id}: episode {int(record.episode_ids[env_id])} ended"
    steps = record.info.get("elapsed_steps")
    if steps is not None:
        text += f" after {int(steps[env_id])} steps"
    return f"{text}: {', '.join(reasons)}"


def ids_text(ids: NDArray[np.int64]) -> str:
    """``0, 3, 5 (and 12 more)``."""
    return _listed(list(map(str, ids.tolist())), ", ")


def _listed(words: list[str], separator: str) -> str:
    text = separator.join(words[:_MOST_LISTED])
    if len(words) > _MOST_LISTED:
        text += f" (and {len(words) - _MOST_LISTED} more)"
    return text
