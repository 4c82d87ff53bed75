"""`RigidObject`: handle over one rigid body in N environments."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

from embodichain.lab.sim.objects._arrays import as_rows, bool_rows, to_tensor
from embodichain.lab.sim.objects.entity import BatchEntity
from embodichain.lab.sim.objects.rigid_inertia import RigidInertia
from embodichain.lab.sim.unavailable import not_available
from embodichain.utils.math import quat_conjugate, quat_rotate

if TYPE_CHECKING:
    from embodichain.lab.sim.cfg import RigidObjectCfg
    from embodichain.lab.sim.compiler.index import EntityIndex
    from embodichain.lab.sim.engine.base import F64, Engine, EnvIndex
    from embodichain.lab.sim.host import Host
    from embodichain.lab.sim.objects.rigid_inertia import Solid

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
        pos = owner.engine.model_field("body_ipos")[:, 3 * body : 3 * body + 3]
        quat = owner.engine.model_field("body_iquat")[:, 4 * body : 4 * body + 4]
        return to_tensor(np.concatenate([pos, quat], axis=1))

    @property
    def mass(self) -> torch.Tensor:
        """(N,) kg."""
        return self._owner.get_mass()

    @property
    def inertia(self) -> torch.Tensor:
        """(N, 3) principal moments, kg m^2."""
        return self._owner.get_inertia()


class RigidObject(BatchEntity):
    """One rigid body with one shape, in N environments.

    `dynamic` bodies are simulated, `kinematic` ones move only by `set_local_pose`, `static` ones
    stand still unless `set_local_pose` moves them.

    Args:
        cfg: Its config (kept as given).
        uid: Its name in the scene.
        host: The simulation.
    """

    cfg: RigidObjectCfg

    def __init__(self, cfg: RigidObjectCfg, uid: str, host: Host) -> None:
        super().__init__(cfg, uid, host)
        self._inertia = RigidInertia(self.binding, cfg)
        self._data = RigidBodyData(self)

    def bind(self, engine: Engine, index: EntityIndex) -> None:
        """Set the engine and the body's indices. Called once, by the simulation."""
        super().bind(engine, index)
        self._inertia.bind()

    @property
    def is_static(self) -> bool:
        """Whether the body never moves."""
        return self.cfg.body_type == "static"

    @property
    def is_non_dynamic(self) -> bool:
        """Whether forces do not move the body."""
        return self.cfg.body_type != "dynamic"

    @property
    def body_data(self) -> RigidBodyData | None:
        """Reads of the body; None for a static one, as in EmbodiChain."""
        return None if self.is_static else self._data

    @property
    def body_state(self) -> torch.Tensor:
        """(N, 13): pose 7, linear velocity 3, angular velocity 3."""
        return torch.cat([self._data.pose, self._data.vel], dim=1)

    def _need_dynamic(self, what: str) -> slice:
        dofs = self._inertia.dofs
        if dofs is None:
            raise ValueError(f"{self.uid} is {self.cfg.body_type}: {what} needs body_type: dynamic")
        return dofs

    # -- velocity and force --------------------------------------------------------------------

    def read_velocity(self) -> tuple[F64, F64]:
        """Linear and angular velocity, (N, 3) each, world axes; zeros unless dynamic."""
        dofs = self._inertia.dofs
        if dofs is None:
            zero = np.zeros((self.num_instances, 3))
            return zero, zero
        qvel = self.engine.state("qvel")[:, dofs]
        # A free joint's angular velocity is in the body's frame, its linear one in the world's.
        return qvel[:, :3], quat_rotate(self.read_pose()[1], qvel[:, 3:])

    def read_acceleration(self) -> tuple[F64, F64]:
        """Linear and angular acceleration of the last physics step, (N, 3) each, world axes."""
        dofs = self._inertia.dofs
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
        """`clear_dynamics` for checked indices."""
        dofs = self._inertia.dofs
        if dofs is None:
            return
        self.engine.write("qvel", 0.0, ids, dofs)
        self.engine.write("qacc_warmstart", 0.0, ids, dofs)
        body = self.entity.root_body_id
        if self.engine.state("xfrc_applied")[:, 6 * body : 6 * body + 6].any():
            self.engine.write("xfrc_applied", 0.0, ids, slice(6 * body, 6 * body + 6))

    # -- mass, inertia, damping --------------------------------------------------------------------

    def get_mass(self, env_ids: Any = None) -> torch.Tensor:
        """(n,) kg."""
        return to_tensor(self._inertia.read(self._ids(env_ids)[0])[0])

    def set_mass(self, mass: Any, env_ids: Any = None) -> None:
        """Set the mass (n,) in kg; the inertia scales with it, so the body stays consistent.

        Raises:
            ValueError: If a mass is not positive.
        """
        self._need_dynamic("set_mass")
        ids, rows = self._ids(env_ids)
        new = as_rows(np.reshape(mass, (-1, 1)), rows, 1, f"{self.uid}: mass")[:, 0]
        if (new <= 0).any():
            raise ValueError(f"{self.uid}: mass must be positive, got {new.min()}")
        self._inertia.write_mass(new, ids)

    def write_mass(self, mass: F64, ids: EnvIndex | None, inertia: bool = True) -> None:
        """Set the mass from checked arrays; see `RigidInertia.write_mass`."""
        self._inertia.write_mass(mass, ids, inertia)

    def write_inertia_scale(self, factor: F64, ids: EnvIndex | None) -> None:
        """Scale the inertia by checked factors (n,); see `RigidInertia.write_inertia_scale`."""
        self._inertia.write_inertia_scale(factor, ids)

    def get_inertia(self, env_ids: Any = None) -> torch.Tensor:
        """(n, 3) principal moments of inertia, kg m^2."""
        return to_tensor(self._inertia.read(self._ids(env_ids)[0])[1])

    def set_inertia(self, inertia: Any, env_ids: Any = None) -> None:
        """Set the principal moments of inertia (n, 3) in kg m^2.

        Raises:
            ValueError: If a moment is not positive or the triangle inequality fails.
        """
        self._need_dynamic("set_inertia")
        ids, rows = self._ids(env_ids)
        new = as_rows(inertia, rows, 3, f"{self.uid}: inertia")
        if (new <= 0).any() or (2 * new.max(axis=1) > new.sum(axis=1) + 1e-12).any():
            raise ValueError(
                f"{self.uid}: moments must be positive, the largest at most the sum "
                "of the other two"
            )
        self._inertia.write_inertia(new, ids)

    def get_damping(self, env_ids: Any = None) -> torch.Tensor:
        """(n, 2) linear and angular damping, 1/s."""
        ids, _ = self._ids(env_ids)
        damping = self._inertia.read_damping()
        return to_tensor(damping if ids is None else damping[ids])

    def set_damping(self, damping: Any, env_ids: Any = None) -> None:
        """Set linear and angular damping, (n, 2) in 1/s."""
        self._need_dynamic("set_damping")
        ids, rows = self._ids(env_ids)
        self._inertia.write_damping(as_rows(damping, rows, 2, f"{self.uid}: damping"), ids)

    def set_com_pose(self, com_pose: Any, env_ids: Any = None) -> None:
        """Set the centre-of-mass frame in the body's frame, (n, 7)."""
        self._need_dynamic("set_com_pose")
        ids, rows = self._ids(env_ids)
        pose = self._pose_rows(com_pose, rows)
        body = self.entity.root_body_id
        self.engine.write_model("body_ipos", pose[:, :3], ids, slice(3 * body, 3 * body + 3))
        self.engine.write_model("body_iquat", pose[:, 3:], ids, slice(4 * body, 4 * body + 4))
        self.engine.set_const_later(ids)

    # -- size ------------------------------------------------------------------------------------

    @property
    def solid(self) -> Solid:
        """The shape at other sizes; see `RigidInertia.solid`."""
        return self._inertia.solid

    def write_scale(self, scale: F64, ids: EnvIndex | None, fixed_density: bool = True) -> None:
        """Scale the shape by checked factors (n, 3); see `RigidInertia.write_scale`."""
        self._inertia.write_scale(scale, ids, fixed_density)

    def get_body_scale(self, env_ids: Any = None) -> torch.Tensor:
        """(n, 3) scale of the shape."""
        ids, _ = self._ids(env_ids)
        scale = np.asarray(self.cfg.body_scale, np.float64) * self._inertia.read_scale()
        return to_tensor(scale if ids is None else scale[ids])

    def set_body_scale(self, scale: Any, env_ids: Any = None) -> None:
        """Set the shape's scale (n, 3); mass and inertia follow at the same density.

        Raises:
            ValueError: If the shape is a mesh or a plane, or cannot be scaled so.
        """
        ids, rows = self._ids(env_ids)
        wanted = as_rows(scale, rows, 3, f"{self.uid}: scale")
        relative = wanted / np.asarray(self.cfg.body_scale, np.float64)
        self.solid.check(relative)
        self.write_scale(relative, ids)

    # -- contact and looks -----------------------------------------------------------------------

    def get_friction(self, env_ids: Any = None) -> torch.Tensor:
        """(n,) sliding friction coefficient."""
        ids, _ = self._ids(env_ids)
        geom = int(self.entity.geom_ids[0])
        values = self.engine.model_field("geom_friction")[:, 3 * geom]
        return to_tensor(values if ids is None else values[ids])

    def set_friction(self, friction: Any, env_ids: Any = None) -> None:
        """Set the sliding friction coefficient, (n,); a contact takes the larger of its two."""
        ids, rows = self._ids(env_ids)
        new = as_rows(np.reshape(friction, (-1, 1)), rows, 1, f"{self.uid}: friction")
        if (new < 0).any():
            raise ValueError(f"{self.uid}: friction must not be negative, got {new.min()}")
        for geom in self.entity.geom_ids:
            self.engine.write_model(
                "geom_friction", new, ids, slice(3 * int(geom), 3 * int(geom) + 1)
            )

    def enable_collision(self, enable: Any, env_ids: Any = None) -> None:
        """Switch contacts on or off, (n,) booleans."""
        ids, rows = self._ids(env_ids)
        on = bool_rows(enable, rows, f"{self.uid}: enable").astype(np.float64)[:, None]
        model, body = self.engine.model, self.entity.root_body_id
        groups = [("geom", int(g)) for g in self.entity.geom_ids] + [("body", body)]
        for kind, index in groups:
            for field in ("contype", "conaffinity"):
                name = f"{kind}_{field}"
                value = int(getattr(model, name)[index])
                self.engine.write_model(name, on * value, ids, slice(index, index + 1))

    def get_user_ids(self) -> torch.Tensor:
        """(N,) id of the body in segmentation images: its MuJoCo body id."""
        return torch.full((self.num_instances,), self.entity.root_body_id, dtype=torch.int32)

    def set_visible(self, visible: bool = True) -> None:
        """Draw the body or not, in pictures of every environment."""
        for geom in self.entity.geom_ids:
            column = slice(4 * int(geom) + 3, 4 * int(geom) + 4)
            alpha = float(self.engine.model.geom_rgba[geom, 3]) if visible else 0.0
            self.engine.write_model("geom_rgba", alpha, None, column)

    # -- whole simulations -------------------------------------------------------------------------

    def take_over(self, ids: EnvIndex | None, fields: Mapping[str, NDArray[Any]]) -> None:
        """Read size, inertia and damping out of a model; see `RigidInertia.take_over`."""
        self._inertia.take_over(ids, fields)

    def state_dict(self) -> dict[str, F64]:
        """Values that are in no model field (copies)."""
        return self._inertia.state_dict()

    def load_state_dict(self, state: dict[str, F64]) -> None:
        """Continue exactly where `state_dict` was taken; the engine restores model fields."""
        self._inertia.load_state_dict(state)

    set_body_type = not_available("set_body_type", "the body type is compiled into the model")
    set_attrs = not_available("set_attrs", "use set_mass, set_friction, set_damping, set_inertia")
    set_collision_filter = not_available("set_collision_filter", "environments never share a world")
    set_physical_visible = not_available("set_physical_visible", "use set_visible")
    set_visual_material = not_available("set_visual_material", "declare shape.visual_material")
    get_vertices = not_available("get_vertices", "it comes with sensors and meshes")
    get_triangles = not_available("get_triangles", "it comes with sensors and meshes")
