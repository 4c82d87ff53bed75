"""`foxglove.JointStates` of one environment: every hinge and slide joint, named `uid/joint`."""

from __future__ import annotations

import mujoco
import numpy as np

from embodichain.recording.foxglove.messages import JointState, JointStates, timestamp

__all__ = ["Joints"]

_SCALAR = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))


class Joints:
    """Where the joints of a model stand in qpos and qvel.

    Args:
        model: The model.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        ids = [j for j in range(model.njnt) if int(model.jnt_type[j]) in _SCALAR]
        self.names = [model.joint(j).name or f"joint_{j}" for j in ids]
        self._qpos = np.array([model.jnt_qposadr[j] for j in ids], np.int64)
        self._qvel = np.array([model.jnt_dofadr[j] for j in ids], np.int64)

        self._message = JointStates(joints=[JointState(name=name) for name in self.names])

    def encode(self, time_ns: int, data: mujoco.MjData) -> bytes:
        """`JointStates`: positions (rad or m) and velocities (rad/s or m/s), as bytes."""
        self._message.timestamp.CopyFrom(timestamp(time_ns))
        qpos, qvel = data.qpos[self._qpos].tolist(), data.qvel[self._qvel].tolist()
        for joint, position, velocity in zip(self._message.joints, qpos, qvel, strict=True):
            joint.position, joint.velocity = position, velocity
        encoded: bytes = self._message.SerializeToString()
        return encoded
