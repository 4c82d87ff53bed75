"""`ArticulationData`: reads of an articulation's joints, root and links in all environments."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import torch

from embodichain.lab.sim.objects._arrays import to_tensor

if TYPE_CHECKING:
    from embodichain.lab.sim.compiler.index import EntityIndex
    from embodichain.lab.sim.host import Binding
    from embodichain.lab.sim.objects.articulation_links import ArticulationLinks
    from embodichain.lab.sim.objects.drives import Drives
    from embodichain.lab.sim.objects.joint_state import JointState

__all__ = ["ArticulationData"]


class ArticulationData:
    """Every property is a fresh float32 tensor; D joints in qpos order, L links.

    Limits and gains are known as soon as the articulation is added; the rest compiles the scene.

    Args:
        binding: The articulation's place in the simulation.
        joints: Its joints.
        drives: Their drives.
        links: Its links.
        root_pose: Returns the root pose (N, 7).
    """

    def __init__(
        self,
        binding: Binding[EntityIndex],
        joints: JointState,
        drives: Drives,
        links: ArticulationLinks,
        root_pose: Callable[[], torch.Tensor],
    ) -> None:
        self._binding = binding
        self._joints = joints
        self._drives = drives
        self._links = links
        self._root_pose = root_pose

    @property
    def qpos(self) -> torch.Tensor:
        """(N, D) rad or m."""
        return to_tensor(self._joints.qpos())

    @property
    def target_qpos(self) -> torch.Tensor:
        """(N, D) drive position targets; the position itself for joints without a drive."""
        return to_tensor(self._drives.read_target_qpos())

    @property
    def qvel(self) -> torch.Tensor:
        """(N, D) rad/s or m/s."""
        return to_tensor(self._joints.qvel())

    @property
    def target_qvel(self) -> torch.Tensor:
        """(N, D) drive velocity targets."""
        return to_tensor(self._drives.target_qvel)

    @property
    def qacc(self) -> torch.Tensor:
        """(N, D) rad/s^2 or m/s^2 of the last physics step."""
        return to_tensor(self._joints.qacc())

    @property
    def qf(self) -> torch.Tensor:
        """(N, D) N m or N: total drive effort of the last physics step, or what was set since.

        See `Articulation.get_qf`.
        """
        return to_tensor(self._joints.efforts())

    @property
    def qpos_limits(self) -> torch.Tensor:
        """(N, D, 2) lower and upper limits; infinite where the file has none."""
        return to_tensor(self._drives.limits.values)

    @property
    def qvel_limits(self) -> torch.Tensor:
        """(N, D) velocity limits of the file; not enforced by physics."""
        return to_tensor(np.tile(self._drives.parsed.qvel_limits, (self._binding.num_envs, 1)))

    @property
    def qf_limits(self) -> torch.Tensor:
        """(N, D) effort limits of the file; enforced with ``max_effort: file`` only."""
        return to_tensor(np.tile(self._drives.parsed.qf_limits, (self._binding.num_envs, 1)))

    @property
    def joint_stiffness(self) -> torch.Tensor:
        """(N, D) N m/rad or N/m."""
        return to_tensor(self._drives.stiffness)

    @property
    def joint_damping(self) -> torch.Tensor:
        """(N, D) N m s/rad or N s/m."""
        return to_tensor(self._drives.damping)

    @property
    def joint_friction(self) -> torch.Tensor:
        """(N, D) dry friction, N m or N."""
        return to_tensor(self._drives.friction)

    @property
    def joint_armature(self) -> torch.Tensor:
        """(N, D) reflected inertia, kg m^2 or kg."""
        return to_tensor(self._drives.armature)

    @property
    def root_pose(self) -> torch.Tensor:
        """(N, 7) x, y, z, qw, qx, qy, qz in the environment's frame."""
        return self._root_pose()

    @property
    def root_vel(self) -> torch.Tensor:
        """(N, 6) linear (m/s, of the root's origin) then angular (rad/s), world axes."""
        return to_tensor(self._links.velocity(self._links.body_of(None)))

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
        ids, engine = self._binding.index.body_ids, self._binding.engine
        pos, quat = engine.derived("xpos")[:, ids], engine.derived("xquat")[:, ids]
        return to_tensor(np.concatenate([pos, quat], axis=2))

    @property
    def body_link_vel(self) -> torch.Tensor:
        """(N, L, 6) linear (of the link's origin) then angular velocity, world axes."""
        bodies = self._binding.index.body_ids
        return to_tensor(np.stack([self._links.velocity(int(b)) for b in bodies], axis=1))
