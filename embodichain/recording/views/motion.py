"""What moves: `/tf`, a frame for every body, and the joint states of each environment.

Frames are named ``env_I/uid/link`` and hang on ``env_I``, which hangs on ``world``.
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from embodichain.lab.sim.engine.base import F64
from embodichain.lab.sim.engine.api import row_layout
from embodichain.recording.views.messages import FrameTransforms, JointStates, set_time

__all__ = ["Frames", "Joints", "frame_names", "scalar_joints"]

_SCALAR = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))


def frame_names(model: mujoco.MjModel, env_id: int) -> list[str]:
    """Frames of an environment's bodies by body id; the first is the environment's own world."""
    root = f"env_{env_id}"
    names = (model.body(i).name or f"body_{i}" for i in range(1, model.nbody))
    return [root, *(f"{root}/{name}" for name in names)]


def scalar_joints(model: mujoco.MjModel) -> dict[str, int]:
    """Ids of the hinge and slide joints by name."""
    ids = [j for j in range(model.njnt) if int(model.jnt_type[j]) in _SCALAR]
    return {model.joint(j).name or f"joint_{j}": j for j in ids}


class Frames:
    """One `FrameTransforms` for all viewed environments, filled anew for each sample.

    Every body's frame hangs on its environment's, so no product of rotations is needed, and a
    viewer that misses one frame still shows the others.

    Args:
        model: The model; only names are read.
        env_ids: (n,) environments.
        offsets: (n, 3) position of each in ``world``, metres.
    """

    def __init__(self, model: mujoco.MjModel, env_ids: Sequence[int], offsets: F64) -> None:
        self._message = FrameTransforms()
        add = self._message.transforms.add
        self._bodies = []
        for env_id, (x, y, z) in zip(env_ids, offsets.tolist(), strict=True):
            root, *names = frame_names(model, env_id)
            base = add(parent_frame_id="world", child_frame_id=root)
            base.translation.x, base.translation.y, base.translation.z = x, y, z
            base.rotation.w = 1.0
            frames = [add(parent_frame_id=root, child_frame_id=name) for name in names]
            self._bodies.append([(frame.translation, frame.rotation) for frame in frames])
        self._times = [frame.timestamp for frame in self._message.transforms]

    def place(self, index: int, data: mujoco.MjData) -> None:
        """Take the body poses of the index-th environment from its kinematics."""
        positions, rotations = data.xpos[1:].tolist(), data.xquat[1:].tolist()
        for (p, q), xyz, wxyz in zip(self._bodies[index], positions, rotations, strict=True):
            p.x, p.y, p.z = xyz
            q.w, q.x, q.y, q.z = wxyz

    def encode(self, time_ns: int) -> bytes:
        """Return the serialized message."""
        seconds, nanos = divmod(time_ns, 1_000_000_000)
        for timestamp in self._times:
            timestamp.seconds, timestamp.nanos = seconds, nanos
        data: bytes = self._message.SerializeToString()
        return data


class Joints:
    """One `JointStates`: every hinge and slide joint, filled anew for each environment.

    Args:
        model: The model.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        joints, layout = scalar_joints(model), row_layout(model)
        ids = np.array(list(joints.values()), np.int64)
        self._qpos = layout["qpos"].start + model.jnt_qposadr[ids]
        self._qvel = layout["qvel"].start + model.jnt_dofadr[ids]
        self._message = JointStates()
        self._joints = [self._message.joints.add(name=name) for name in joints]

    def encode(self, time_ns: int, row: F64) -> bytes:
        """Return the serialized message.

        Args:
            time_ns: Its time.
            row: (nstate,) state: positions (rad or m) and velocities (rad/s or m/s) are read.
        """
        set_time(self._message.timestamp, time_ns)
        positions, velocities = row[self._qpos].tolist(), row[self._qvel].tolist()
        for joint, qpos, qvel in zip(self._joints, positions, velocities, strict=True):
            joint.position, joint.velocity = qpos, qvel
        data: bytes = self._message.SerializeToString()
        return data
