"""Coordinate frames: `env_I/uid/link` for every body, under `env_I`, under `world`.

Every environment is its own world; for people they are laid out by `arena_offsets`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco

from embodichain.recording.foxglove.messages import FrameTransforms, timestamp

__all__ = ["Frames", "frame_names"]


def frame_names(model: mujoco.MjModel, env_id: int) -> list[str]:
    """Frames of an environment's bodies by body id; the first is the environment's own world."""
    root = f"env_{env_id}"
    names = (model.body(i).name or f"body_{i}" for i in range(1, model.nbody))
    return [root, *(f"{root}/{name}" for name in names)]


class Frames:
    """The frames of some environments, in one message that is filled anew each time.

    Every body's frame hangs on its environment's: no product of rotations is needed, and a viewer
    that misses one frame still shows the others.

    Args:
        model: The model; only names are read.
        env_ids: The environments.
        offsets: Where each stands in ``world``, metres.
    """

    def __init__(
        self, model: mujoco.MjModel, env_ids: Sequence[int], offsets: Sequence[Sequence[float]]
    ) -> None:
        self._message = FrameTransforms()
        self._bodies: list[list[Any]] = []
        for env_id, (x, y, z) in zip(env_ids, offsets, strict=True):
            root, *names = frame_names(model, env_id)
            base = self._add("world", root)
            base.translation.x, base.translation.y, base.translation.z = x, y, z
            base.rotation.w = 1.0
            self._bodies.append([self._add(root, name) for name in names])

    def _add(self, parent: str, child: str) -> Any:
        return self._message.transforms.add(parent_frame_id=parent, child_frame_id=child)

    def place(self, index: int, data: mujoco.MjData) -> None:
        """Take over the poses of the index-th environment, after `mj_kinematics`."""
        poses = zip(
            self._bodies[index], data.xpos[1:].tolist(), data.xquat[1:].tolist(), strict=True
        )
        for transform, (x, y, z), (qw, qx, qy, qz) in poses:
            t, r = transform.translation, transform.rotation
            t.x, t.y, t.z = x, y, z
            r.w, r.x, r.y, r.z = qw, qx, qy, qz

    def encode(self, time_ns: int) -> bytes:
        """`FrameTransforms` of all environments, as bytes."""
        stamp = timestamp(time_ns)
        for transform in self._message.transforms:
            transform.timestamp.seconds, transform.timestamp.nanos = stamp.seconds, stamp.nanos
        data: bytes = self._message.SerializeToString()
        return data
