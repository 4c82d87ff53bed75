"""`foxglove.JointStates` of environments: every hinge and slide joint, named `uid/joint`."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.engine.base import F64
from embodichain.lab.sim.engine.layout import row_layout
from embodichain.recording.foxglove.messages import JointState, JointStates
from embodichain.recording.foxglove.template import STAMP, Template, mark

__all__ = ["Joints"]

_SCALAR = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))


class Joints:
    """Where the joints of a model stand in a row.

    Args:
        model: The model.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        ids = [j for j in range(model.njnt) if int(model.jnt_type[j]) in _SCALAR]
        self.names = [model.joint(j).name or f"joint_{j}" for j in ids]
        layout = row_layout(model)
        qpos = [layout["qpos"].start + int(model.jnt_qposadr[j]) for j in ids]
        qvel = [layout["qvel"].start + int(model.jnt_dofadr[j]) for j in ids]
        self._columns = np.array([qpos, qvel], np.int64).T.reshape(-1)
        joints = [
            JointState(name=name, position=mark(2 * i), velocity=mark(2 * i + 1))
            for i, name in enumerate(self.names)
        ]
        message = JointStates(timestamp=STAMP, joints=joints)
        self._template = Template(message.SerializeToString(), 2 * len(joints))

    def table(self, stamped: NDArray[np.uint8], rows: F64) -> NDArray[np.uint8]:
        """(L, n, bytes) `JointStates`: positions (rad or m), velocities (rad/s or m/s).

        Args:
            stamped: The `stamps` of L moments.
            rows: (L, n, nstate).
        """
        moments, count, _ = rows.shape
        values = rows.reshape(moments * count, -1)[:, self._columns]
        found = self._template.table(values, np.repeat(stamped, count, 0))
        return found.reshape(moments, count, -1)
