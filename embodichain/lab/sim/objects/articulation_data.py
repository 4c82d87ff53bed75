"""`ArticulationData`: reads of an articulation's joints, root and links in all environments."""

from __future__ import annotations

import numpy as np

from embodichain.lab.sim.objects.entity import TensorRead, TensorReads

__all__ = ["ArticulationData"]


class ArticulationData(TensorReads):
    """Reads of an articulation: every attribute is a fresh float32 tensor.

    D joints in qpos order, L links. Limits and gains are available once the articulation is added;
    other reads compile the scene. Poses are in the environment's frame. Velocities are those of
    origins, linear then angular, in world axes.
    """

    qpos = TensorRead(lambda a: a.read_qpos())
    """(N, D) rad or m."""
    target_qpos = TensorRead(lambda a: a.drives.read_target_qpos())
    """(N, D) drive position targets; the position itself for joints without a drive."""
    qvel = TensorRead(lambda a: a.read_qvel())
    """(N, D) rad/s or m/s."""
    target_qvel = TensorRead(lambda a: a.drives.target_qvel)
    """(N, D) drive velocity targets."""
    qacc = TensorRead(lambda a: a.read_qacc())
    """(N, D) rad/s^2 or m/s^2 of the last physics step."""
    qf = TensorRead(lambda a: a.read_efforts())
    """(N, D) N m or N: drive effort of the last physics step, or the effort set since.

    See `Articulation.get_qf`.
    """
    qpos_limits = TensorRead(lambda a: a.drives.limits.values)
    """(N, D, 2) lower and upper limits; infinite where the file has none."""
    qvel_limits = TensorRead(lambda a: np.tile(a.parsed.qvel_limits, (a.num_instances, 1)))
    """(N, D) velocity limits of the file; not enforced by physics."""
    qf_limits = TensorRead(lambda a: np.tile(a.parsed.qf_limits, (a.num_instances, 1)))
    """(N, D) effort limits of the file; enforced with ``max_effort: file`` only."""
    joint_stiffness = TensorRead(lambda a: a.drives.stiffness)
    """(N, D) N m/rad or N/m."""
    joint_damping = TensorRead(lambda a: a.drives.damping)
    """(N, D) N m s/rad or N s/m."""
    joint_friction = TensorRead(lambda a: a.drives.friction)
    """(N, D) dry friction, N m or N."""
    joint_armature = TensorRead(lambda a: a.drives.armature)
    """(N, D) reflected inertia, kg m^2 or kg."""
    root_pose = TensorRead(lambda a: np.concatenate(a.read_pose(), axis=1))
    """(N, 7) x, y, z, qw, qx, qy, qz."""
    root_vel = TensorRead(lambda a: a.velocity_of(a.body_of(None)))
    """(N, 6) m/s, then rad/s."""
    root_lin_vel = TensorRead(lambda a: a.velocity_of(a.body_of(None))[:, :3])
    """(N, 3) m/s."""
    root_ang_vel = TensorRead(lambda a: a.velocity_of(a.body_of(None))[:, 3:])
    """(N, 3) rad/s."""
    body_link_pose = TensorRead(lambda a: a.pose_of(a.index.body_ids))
    """(N, L, 7) poses of all links."""
    body_link_vel = TensorRead(lambda a: a.velocity_of(a.index.body_ids))
    """(N, L, 6) velocities of all links."""
