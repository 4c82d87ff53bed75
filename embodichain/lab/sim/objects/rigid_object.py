"""`RigidObject`: handle over one rigid body in N environments; its pose, velocity and forces.

Its mass, size and friction are in `rigid_properties.py`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

from embodichain.lab.sim.objects._arrays import as_rows, to_tensor
from embodichain.lab.sim.objects.rigid_properties import RigidProperties
from embodichain.lab.sim.unavailable import not_available
from embodichain.utils.math import quat_conjugate, quat_rotate

if TYPE_CHECKING:
    from embodichain.lab.sim.cfg import RigidObjectCfg
    from embodichain.lab.sim.engine.base import F64
    from embodichain.lab.sim.host import Host

__all__ = ["RigidBodyData", "RigidObject"]


class RigidBodyData:
    """Reads of one body in all environments; every property is a fresh float32 tensor."""

    def __init__(self, owner: RigidObject) -> None:
        self._owner = owner

    @property
    def pose(self) -> torch.Tensor:
        """(N, 7) x, y, z, qw, qx, qy, qz in the environment's frame."""
        return self._owner.get_local_pose()

    @property
    def lin_vel(self) -> torch.Tensor:
        """(N, 3) m/s, world axes, of the body's origin."""
        return to_tensor(self._owner.read_velocity()[0])

    @property
    def ang_vel(self) -> torch.Tensor:
        """(N, 3) rad/s, world axes."""
        return to_tensor(self._owner.read_velocity()[1])

    @property
    def vel(self) -> torch.Tensor:
        """(N, 6) linear, then angular."""
        return to_tensor(np.concatenate(self._owner.read_velocity(), axis=1))

    @property
    def lin_acc(self) -> torch.Tensor:
        """(N, 3) m/s^2 of the last physics step, world axes; zero for bodies that do not move."""
        return to_tensor(self._owner.read_acceleration()[0])

    @property
    def ang_acc(self) -> torch.Tensor:
        """(N, 3) rad/s^2 of the last physics step, world axes."""
        return to_tensor(self._owner.read_acceleration()[1])

    @property
    def acc(self) -> torch.Tensor:
        """(N, 6) linear, then angular."""
        return to_tensor(np.concatenate(self._owner.read_acceleration(), axis=1))

    @property
    def default_com_pose(self) -> torch.Tensor:
        """(N, 7) compiled centre-of-mass frame in the body's frame."""
        owner = self._owner
        model, body = owner.engine.model, owner.entity.root_body_id
        row = np.concatenate([model.body_ipos[body], model.body_iquat[body]])
        return to_tensor(np.tile(row, (owner.num_instances, 1)))

    @property
    def com_pose(self) -> torch.Tensor:
        """(N, 7) centre-of-mass frame in the body's frame."""
        owner = self._owner
        body = owner.entity.root_body_id
        pos = owner.model_values("body_ipos", slice(3 * body, 3 * body + 3))
        quat = owner.model_values("body_iquat", slice(4 * body, 4 * body + 4))
        return to_tensor(np.concatenate([pos, quat], axis=1))

    @property
    def mass(self) -> torch.Tensor:
        """(N,) kg."""
        return self._owner.get_mass()

    @property
    def inertia(self) -> torch.Tensor:
        """(N, 3) principal moments, kg m^2."""
        return self._owner.get_inertia()


class RigidObject(RigidProperties):
    """One rigid body with one shape, in N environments.

    `dynamic` bodies are simulated, `kinematic` ones move only by `set_local_pose`, `static` ones
    stand still unless `set_local_pose` moves them.
    """

    def __init__(self, cfg: RigidObjectCfg, uid: str, host: Host) -> None:
        super().__init__(cfg, uid, host)
        self._data = RigidBodyData(self)

    @property
    def body_data(self) -> RigidBodyData | None:
        """Reads of the body; None for a static one, as in EmbodiChain."""
        return None if self.is_static else self._data

    @property
    def body_state(self) -> torch.Tensor:
        """(N, 13): pose 7, linear velocity 3, angular velocity 3."""
        return torch.cat([self._data.pose, self._data.vel], dim=1)

    # -- velocity and force --------------------------------------------------------------------

    def read_velocity(self) -> tuple[F64, F64]:
        """Linear and angular velocity, (N, 3) each, world axes; zeros unless dynamic."""
        dofs = self._dofs()
        if dofs is None:
            zero = np.zeros((self.num_instances, 3))
            return zero, zero
        qvel = self.engine.state("qvel")[:, dofs]
        # A free joint's angular velocity is in the body's frame, its linear one in the world's.
        return qvel[:, :3], quat_rotate(self.read_pose()[1], qvel[:, 3:])

    def read_acceleration(self) -> tuple[F64, F64]:
        """Linear and angular acceleration of the last physics step, (N, 3) each, world axes."""
        dofs = self._dofs()
        if dofs is None:
            zero = np.zeros((self.num_instances, 3))
            return zero, zero
        qacc = self.engine.acceleration("qacc")[:, dofs]
        return qacc[:, :3], quat_rotate(self.read_pose()[1], qacc[:, 3:])

    def set_velocity(self, lin_vel: Any = None, ang_vel: Any = None, env_ids: Any = None) -> None:
        """Set velocities of a dynamic body.

        Args:
            lin_vel: (n, 3) m/s, world axes, or None to leave it.
            ang_vel: (n, 3) rad/s, world axes, or None to leave it.
            env_ids: The n environments; None is all N.
        """
        dofs = self._need_dynamic("set_velocity")
        ids, rows = self._ids(env_ids)
        if lin_vel is not None:
            lin = as_rows(lin_vel, rows, 3, f"{self.uid}: lin_vel")
            self.engine.write("qvel", lin, ids, slice(dofs.start, dofs.start + 3))
        if ang_vel is not None:
            ang = as_rows(ang_vel, rows, 3, f"{self.uid}: ang_vel")
            quat = self.read_pose()[1]
            local = quat_rotate(quat_conjugate(quat if ids is None else quat[ids]), ang)
            self.engine.write("qvel", local, ids, slice(dofs.start + 3, dofs.stop))

    def add_force_torque(
        self, force: Any = None, torque: Any = None, pos: Any = None, env_ids: Any = None
    ) -> None:
        """Apply a force and a torque, world axes, until `clear_dynamics` or a reset.

        Args:
            force: (n, 3) N, or None.
            torque: (n, 3) N m, or None.
            pos: (n, 3) point of application in the environment's frame; None is the centre of mass.
            env_ids: The n environments; None is all N.
        """
        self._need_dynamic("add_force_torque")
        ids, rows = self._ids(env_ids)
        body = self.entity.root_body_id
        total = np.zeros((rows, 6))
        if force is not None:
            total[:, :3] = as_rows(force, rows, 3, f"{self.uid}: force")
        if torque is not None:
            total[:, 3:] = as_rows(torque, rows, 3, f"{self.uid}: torque")
        if pos is not None:
            com = self.engine.derived("xipos")[:, body]
            arm = as_rows(pos, rows, 3, f"{self.uid}: pos") - (com if ids is None else com[ids])
            total[:, 3:] += np.cross(arm, total[:, :3])
        columns = slice(6 * body, 6 * body + 6)
        now = self.engine.state("xfrc_applied")[:, columns]
        self.engine.write("xfrc_applied", total + (now if ids is None else now[ids]), ids, columns)

    def clear_dynamics(self, env_ids: Any = None) -> None:
        """Stop the body and remove applied forces."""
        ids, _ = self._ids(env_ids)
        self.stop(ids)

    def stop(self, ids: NDArray[np.int64] | None) -> None:
        """`clear_dynamics` for checked indices: the door for terms."""
        dofs = self._dofs()
        if dofs is None:
            return
        self.engine.write("qvel", 0.0, ids, dofs)
        self.engine.write("qacc_warmstart", 0.0, ids, dofs)
        body = self.entity.root_body_id
        if self.engine.state("xfrc_applied")[:, 6 * body : 6 * body + 6].any():
            self.engine.write("xfrc_applied", 0.0, ids, slice(6 * body, 6 * body + 6))

    set_body_type = not_available("set_body_type", "the body type is compiled into the model")
    set_attrs = not_available("set_attrs", "use set_mass, set_friction, set_damping, set_inertia")
    set_collision_filter = not_available("set_collision_filter", "environments never share a world")
    set_physical_visible = not_available("set_physical_visible", "use set_visible")
    set_visual_material = not_available("set_visual_material", "declare shape.visual_material")
    get_vertices = not_available("get_vertices", "it comes with sensors and meshes")
    get_triangles = not_available("get_triangles", "it comes with sensors and meshes")
