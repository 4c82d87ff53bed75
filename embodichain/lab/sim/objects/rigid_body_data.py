"""`RigidBodyData`: a rigid body's pose, motion and inertia as tensors."""

from __future__ import annotations

import numpy as np

from embodichain.lab.sim.objects.entity import TensorRead, TensorReads

__all__ = ["RigidBodyData"]


class RigidBodyData(TensorReads):
    """Reads of one body: every attribute is a fresh float32 tensor.

    Velocities and accelerations are those of the body's origin, in world axes.
    """

    pose = TensorRead(lambda body: np.concatenate(body.read_pose(), axis=1))
    """(N, 7) x, y, z, qw, qx, qy, qz in the environment's frame."""
    lin_vel = TensorRead(lambda body: body.read_velocity()[0])
    """(N, 3) m/s."""
    ang_vel = TensorRead(lambda body: body.read_velocity()[1])
    """(N, 3) rad/s."""
    vel = TensorRead(lambda body: np.concatenate(body.read_velocity(), axis=1))
    """(N, 6) linear, then angular."""
    lin_acc = TensorRead(lambda body: body.read_acceleration()[0])
    """(N, 3) m/s^2 of the last physics step; zero for bodies that do not move."""
    ang_acc = TensorRead(lambda body: body.read_acceleration()[1])
    """(N, 3) rad/s^2 of the last physics step."""
    acc = TensorRead(lambda body: np.concatenate(body.read_acceleration(), axis=1))
    """(N, 6) linear, then angular."""
    default_com_pose = TensorRead(lambda body: body.read_com_pose(compiled=True))
    """(N, 7) compiled centre-of-mass frame in the body's frame."""
    com_pose = TensorRead(lambda body: body.read_com_pose())
    """(N, 7) centre-of-mass frame in the body's frame."""
    mass = TensorRead(lambda body: body.read_inertia()[0])
    """(N,) kg."""
    inertia = TensorRead(lambda body: body.read_inertia()[1])
    """(N, 3) principal moments, kg m^2."""
