"""`ArticulationData`: reads of an articulation's joints, root and links in all environments."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch

from embodichain.lab.sim.objects._arrays import to_tensor

if TYPE_CHECKING:
    from embodichain.lab.sim.engine.base import F64
    from embodichain.lab.sim.objects.articulation import Articulation

__all__ = ["ArticulationData"]


class ArticulationData:
    """Every property is a fresh float32 tensor; D joints in qpos order, L links.

    Limits and gains are known as soon as the articulation is added; the rest compiles the scene.
    """

    def __init__(self, owner: Articulation) -> None:
        self._owner = owner

    def _tile(self, values: F64) -> torch.Tensor:
        return to_tensor(np.tile(values, (self._owner.num_instances, *[1] * np.ndim(values))))

    @property
    def qpos(self) -> torch.Tensor:
        """(N, D) rad or m."""
        return to_tensor(self._owner.read_qpos())

    @property
    def target_qpos(self) -> torch.Tensor:
        """(N, D) drive position targets; the position itself for joints without a drive."""
        return to_tensor(self._owner.drives.read_target_qpos())

    @property
    def qvel(self) -> torch.Tensor:
        """(N, D) rad/s or m/s."""
        return to_tensor(self._owner.read_qvel())

    @property
    def target_qvel(self) -> torch.Tensor:
        """(N, D) drive velocity targets."""
        return to_tensor(self._owner.drives.target_qvel)

    @property
    def qacc(self) -> torch.Tensor:
        """(N, D) rad/s^2 or m/s^2 of the last physics step."""
        return to_tensor(self._owner.engine.acceleration("qacc")[:, self._owner.dofs])

    @property
    def qf(self) -> torch.Tensor:
        """(N, D) N m or N: total drive effort of the last physics step, or what was set since.

        See `Articulation.get_qf`.
        """
        return to_tensor(self._owner.read_efforts())

    @property
    def qpos_limits(self) -> torch.Tensor:
        """(N, D, 2) lower and upper limits; infinite where the file has none."""
        return to_tensor(self._owner.drives.limits.values)

    @property
    def qvel_limits(self) -> torch.Tensor:
        """(N, D) velocity limits of the file; not enforced by physics."""
        return self._tile(self._owner.parsed.qvel_limits)

    @property
    def qf_limits(self) -> torch.Tensor:
        """(N, D) effort limits of the file; enforced with ``max_effort: file`` only."""
        return self._tile(self._owner.parsed.qf_limits)

    @property
    def joint_stiffness(self) -> torch.Tensor:
        """(N, D) N m/rad or N/m."""
        return to_tensor(self._owner.drives.stiffness)

    @property
    def joint_damping(self) -> torch.Tensor:
        """(N, D) N m s/rad or N s/m."""
        return to_tensor(self._owner.drives.damping)

    @property
    def joint_friction(self) -> torch.Tensor:
        """(N, D) dry friction, N m or N."""
        return to_tensor(self._owner.drives.friction)

    @property
    def joint_armature(self) -> torch.Tensor:
        """(N, D) reflected inertia, kg m^2 or kg."""
        return to_tensor(self._owner.drives.armature)

    @property
    def root_pose(self) -> torch.Tensor:
        """(N, 7) x, y, z, qw, qx, qy, qz in the environment's frame."""
        return self._owner.pose_tensor()

    @property
    def root_vel(self) -> torch.Tensor:
        """(N, 6) linear (m/s, of the root's origin) then angular (rad/s), world axes."""
        return self._owner.link_velocity(self._owner.entity.root_body_id)

    @property
    def root_lin_vel(self) -> torch.Tensor:
        """(N, 3) m/s, world axes."""
        return self.root_vel[:, :3].contiguous()

    @property
    def root_ang_vel(self) -> torch.Tensor:
        """(N, 3) rad/s, world axes."""
        return self.root_vel[:, 3:].contiguous()

    @property
    def body_link_pose(self) -> torch.Tensor:
        """(N, L, 7) poses of all links in the environment's frame."""
        owner = self._owner
        ids = owner.entity.body_ids
        pos, quat = owner.engine.derived("xpos")[:, ids], owner.engine.derived("xquat")[:, ids]
        return to_tensor(np.concatenate([pos, quat], axis=2))

    @property
    def body_link_vel(self) -> torch.Tensor:
        """(N, L, 6) linear (of the link's origin) then angular velocity, world axes."""
        owner = self._owner
        return torch.stack([owner.link_velocity(int(b)) for b in owner.entity.body_ids], dim=1)
