"""`foxglove.JointStates` of one environment: every hinge and slide joint, named `uid/joint`."""

from __future__ import annotations

import mujoco
import numpy as np

from embodichain.recording.foxglove.messages import JointState, JointStates
from embodichain.recording.foxglove.template import STAMP, Template, mark

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
        joints = [
            JointState(name=name, position=mark(2 * i), velocity=mark(2 * i + 1))
            for i, name in enumerate(self.names)
        ]
        message = JointStates(timestamp=STAMP, joints=joints)
        self._template = Template(message.SerializeToString(), 2 * len(joints))

    def encode(self, time_ns: int, data: mujoco.MjData) -> bytes:
        """`JointStates`: positions (rad or m) and velocities (rad/s or m/s), as bytes."""
        values = np.stack([data.qpos[self._qpos], data.qvel[self._qvel]], axis=1)
        return self._template.fill(values, time_ns)
