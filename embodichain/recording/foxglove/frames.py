"""Coordinate frames: `env_I/uid/link` for every body, under `env_I`, under `world`.

Every environment is its own world; for people they are laid out by `arena_offsets`.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import count
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.engine.base import F64
from embodichain.recording.foxglove.messages import FrameTransforms
from embodichain.recording.foxglove.template import STAMP, Template, mark

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
        datas: Each one's data, where `mj_kinematics` leaves poses.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        env_ids: Sequence[int],
        offsets: Sequence[Sequence[float]],
        datas: Sequence[mujoco.MjData],
    ) -> None:
        message = FrameTransforms()
        self._poses: F64 = np.zeros((len(env_ids), model.nbody - 1, 7))
        numbers = count()
        for env_id, (x, y, z) in zip(env_ids, offsets, strict=True):
            root, *names = frame_names(model, env_id)
            base = _add(message, "world", root)
            base.translation.x, base.translation.y, base.translation.z = x, y, z
            base.rotation.w = 1.0
            for name in names:
                frame = _add(message, root, name)
                for field, axes in ((frame.translation, "xyz"), (frame.rotation, "xyzw")):
                    for axis in axes:
                        setattr(field, axis, mark(next(numbers)))
        self.shape = self._poses.shape
        """Of `poses`."""
        self._sources = [
            pair
            for poses, data in zip(self._poses, datas, strict=True)
            for pair in ((poses[:, :3], data.xpos[1:]), (poses[:, 3:], data.xquat[1:]))
        ]
        bodies = np.arange(self._poses.size).reshape(-1, 7)
        as_mujoco_has_them = bodies[:, [0, 1, 2, 6, 3, 4, 5]].reshape(-1)  # w first
        self._template = Template(
            message.SerializeToString(), self._poses.size, order=as_mujoco_has_them
        )

    def poses(self) -> F64:
        """(n, bodies, 7) position, quaternion wxyz of every body now; the next call changes it."""
        for poses, source in self._sources:
            poses[...] = source
        return self._poses

    def table(self, stamped: NDArray[np.uint8], poses: F64) -> NDArray[np.uint8]:
        """(L, bytes) `FrameTransforms` of (L, n, bodies, 7) `poses`, at L moments' `stamps`."""
        return self._template.table(poses.reshape(len(poses), -1), stamped)


def _add(message: Any, parent: str, child: str) -> Any:
    frame = message.transforms.add(parent_frame_id=parent, child_frame_id=child)
    frame.timestamp.CopyFrom(STAMP)
    return frame
