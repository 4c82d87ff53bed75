"""`RigidObject`: handle of one rigid body in N environments."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

from embodichain.lab.sim.compiler.geoms.shape_geoms import inertia_about_axes
from embodichain.lab.sim.objects.entity import BatchEntity
from embodichain.lab.sim.objects.rigid_body_data import RigidBodyData
from embodichain.lab.sim.objects.solid import Solid
from embodichain.utils.arrays import (
    as_env_ids,
    field_values,
    may_be_set,
    rows_at,
    tensor_of,
    to_tensor,
)
from embodichain.utils.math import quat_conjugate, quat_rotate, rotate
from embodichain.utils.plugins import with_missing_members

if TYPE_CHECKING:
    from embodichain.lab.sim.cfg import RigidObjectCfg
    from embodichain.lab.sim.compiler.index import EntityIndex
    from embodichain.lab.sim.engine.api import Engine, EnvIndex
    from embodichain.lab.sim.objects.sim_context import SimContext
    from embodichain.utils.array_types import Floats

__all__ = ["RigidObject"]


@with_missing_members
class RigidObject(BatchEntity):
    """One rigid body with one shape, or in each environment one of several, in N environments.

    `dynamic` bodies are simulated; `kinematic` and `static` ones move only by `set_local_pose`.
    Setters keep mass, inertia and damping of the body consistent.

    Args:
        cfg: Its config (not modified).
        uid: Its name in the scene.
        host: The simulation.
    """

    cfg: RigidObjectCfg

    def __init__(self, cfg: RigidObjectCfg, uid: str, host: SimContext) -> None:
        super().__init__(cfg, uid, host)
        self._data = RigidBodyData(self)
        count = self.num_instances
        attrs = cfg.attrs
        self._declared_damping = np.array([attrs.linear_damping, attrs.angular_damping], np.float64)
        full = host.arrays.full
        self._damping: Floats = host.arrays.put(np.tile(self._declared_damping, (count, 1)))  # 1/s
        self._scale: Floats = full((count, 3), 1.0)  # relative to the compiled size
        self._zeros: Floats = full((count, 3), 0.0)
        self._mass0: Floats = full(count, 0.0)  # of the present shape as compiled
        self._inertia: Floats = full((count, 3), 0.0)  # at that mass and the current scale
        self._solid: Solid | None = None
        self._variant: NDArray[np.int64] = full(count, 0, np.int64)  # index of the present shape

    def bind(self, engine: Engine, index: EntityIndex) -> None:
        """Set the engine and the body's indices. Called once, by the simulation."""
        super().bind(engine, index)
        self._mass0[:] = engine.model.body_mass[index.root_body_id]
        self._inertia[:] = engine.model.body_inertia[index.root_body_id]
        if index.variants is not None:
            self.write_shape(np.zeros(self.num_instances, np.int64), None)

    def _repr_facts(self) -> dict[str, Any]:
        """Return the kind of body and its shape."""
        return {"body_type": self.cfg.body_type, "shape": self.cfg.shape.shape_type}

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
    def _dofs(self) -> slice | None:
        """The 6 columns of the body's free joint in qvel; None if it is not dynamic."""
        start = self.index.free_qvel_adr
        return slice(start, start + 6) if start >= 0 else None

    def _need_dynamic(self, what: str) -> slice:
        dofs = self._dofs
        if dofs is None:
            raise ValueError(f"{self.uid} is {self.cfg.body_type}: {what} needs body_type: dynamic")
        return dofs

    def _columns(self, width: int) -> slice:
        """Columns of the body in a flattened field with ``width`` numbers per body."""
        body = self.index.root_body_id
        return slice(width * body, width * body + width)

    # -- velocity and force --------------------------------------------------------------------

    def read_velocity(self) -> tuple[Floats, Floats]:
        """Linear and angular velocity, (N, 3) each, world axes; zeros unless dynamic."""
        if self._dofs is None:
            return self._zeros, self._zeros
        root = self.motion(self.index.root_body_id)
        return root.linear_velocity(), root.angular_velocity()

    def read_acceleration(self) -> tuple[Floats, Floats]:
        """Linear and angular acceleration of the last physics step, (N, 3) each, world axes."""
        if self._dofs is None:
            return self._zeros, self._zeros
        qacc = self.engine.acceleration("qacc")[:, self._dofs]
        # A free joint's angular part is in body axes, its linear part in world axes.
        return qacc[:, :3], rotate(self.motion(self.index.root_body_id).axes(), qacc[:, 3:])

    def write_velocity(
        self, linear: Floats | None, angular: Floats | None, ids: EnvIndex | None
    ) -> None:
        """Set velocities (n, 3) of a dynamic body, world axes, from checked arrays; None keeps."""
        start = self._need_dynamic("a velocity").start
        if linear is not None:
            self.engine.write("qvel", linear, ids, slice(start, start + 3))
        if angular is not None:
            # A free joint's angular velocity is in body axes, its linear velocity in world axes.
            orientation = self.read_pose()[1][self._rows(ids)]
            in_body = quat_rotate(quat_conjugate(orientation), angular)
            self.engine.write("qvel", in_body, ids, slice(start + 3, start + 6))

    def apply_wrench(
        self,
        force: Floats | None,
        torque: Floats | None,
        point: Floats | None,
        ids: EnvIndex | None,
    ) -> None:
        """Add a force and a torque (n, 3) to those applied, from checked arrays.

        Args:
            force: N, world axes, or None.
            torque: N m, world axes, or None.
            point: Where the force acts, in the environment's frame; None is the centre of mass.
            ids: (n,) environments, or None for all.
        """
        rows = self._rows(ids)
        columns = self._columns(6)
        applied = self.engine.state("xfrc_applied")[rows, columns].copy()
        added = np.zeros_like(applied)
        if force is not None:
            added[:, :3] = force
        if torque is not None:
            added[:, 3:] = torque
        if point is not None:
            centre_of_mass = self.engine.derived("xipos")[rows, self.index.root_body_id]
            added[:, 3:] += np.cross(point - centre_of_mass, added[:, :3])
        self.engine.write("xfrc_applied", added + applied, ids, columns)

    def stop(self, ids: EnvIndex | None) -> None:
        """Like `clear_dynamics`, for checked indices."""
        dofs = self._dofs
        if dofs is None:
            return
        self.engine.write("qvel", 0.0, ids, dofs)
        self.engine.write("qacc_warmstart", 0.0, ids, dofs)
        if may_be_set(self.engine.state("xfrc_applied")[:, self._columns(6)]):
            self.engine.write("xfrc_applied", 0.0, ids, self._columns(6))

    # -- mass, inertia, damping --------------------------------------------------------------------

    def read_inertia(self, ids: EnvIndex | None = None) -> tuple[Floats, Floats]:
        """Mass (n,) in kg and principal moments (n, 3) in kg m^2 (copies)."""
        rows = slice(None) if ids is None else ids
        mass = self.engine.model_field("body_mass")[rows, self.index.root_body_id].copy()
        return mass, self.engine.model_field("body_inertia")[rows, self._columns(3)].copy()

    def write_mass(self, mass: Floats, ids: EnvIndex | None, inertia: bool = True) -> None:
        """Set the mass (n,) in kg from checked arrays, and adapt the damping.

        The inertia scales with the mass, unless ``inertia`` is False.
        """
        rows = self._rows(ids)
        moments = self._inertia[rows] * (mass / self._mass0[rows])[:, None]
        self._write_inertia(ids, mass, moments if inertia else None)

    def write_inertia_scale(self, factor: Floats, ids: EnvIndex | None) -> None:
        """Set the inertia to checked factors (n,) times that of the current mass and size."""
        rows = self._rows(ids)
        mass, _ = self.read_inertia(ids)
        moments = self._inertia[rows] * (mass / self._mass0[rows] * factor)[:, None]
        self._write_inertia(ids, mass, moments)

    def write_inertia(self, moments: Floats, ids: EnvIndex | None) -> None:
        """Set principal moments of inertia (n, 3) in kg m^2 from checked arrays."""
        rows = self._rows(ids)
        mass, _ = self.read_inertia(ids)
        self._inertia[rows] = moments * (self._mass0[rows] / mass)[:, None]
        self._write_inertia(ids, mass, moments)

    def _write_inertia(self, ids: EnvIndex | None, mass: Floats, moments: Floats | None) -> None:
        self.engine.write_model("body_mass", mass[:, None], ids, self._columns(1))
        if moments is not None:
            self.engine.write_model("body_inertia", moments, ids, self._columns(3))
        self._damp(ids)
        self.engine.set_const_later(ids)

    def _damp(self, ids: EnvIndex | None) -> None:
        """Adapt the damping to keep decay rates of velocities; see the compiler's `damping_of`."""
        if self._dofs is None:
            return
        rate = self._damping[self._rows(ids)]
        mass, moments = self.read_inertia(ids)
        linear = np.broadcast_to((rate[:, 0] * mass)[:, None], (len(mass), 3))
        angular = rate[:, 1:] * self._about_axes(moments, self._rows(ids))
        values = np.concatenate([linear, angular], axis=1)
        self.engine.write_model("dof_damping", values, ids, self._dofs)

    def _about_axes(self, moments: Floats, rows: Any) -> Floats:
        """(n, 3) diagonal of the inertia tensor in the body's axes; see `inertia_about_axes`."""
        variants = self.index.variants
        if variants is None:
            iquat = self.engine.model.body_iquat[self.index.root_body_id]
            return inertia_about_axes(iquat, moments)
        present = self._variant[rows][:, None]
        diagonals = moments
        for number, iquat in enumerate(variants.iquat):
            diagonals = np.where(present == number, inertia_about_axes(iquat, moments), diagonals)
        return diagonals

    def read_damping(self) -> Floats:
        """(N, 2) linear and angular damping, 1/s: do not write or store."""
        return self._damping

    def write_damping(self, damping: Floats, ids: EnvIndex | None) -> None:
        """Set linear and angular damping (n, 2) in 1/s from checked arrays."""
        self._damping[self._rows(ids)] = damping
        self._damp(ids)

    def read_com_pose(self, compiled: bool = False) -> Floats:
        """(N, 7) centre-of-mass frame in the body's frame, current or compiled."""
        if compiled:
            model = self.engine.model
            body = self.index.root_body_id
            row = np.concatenate([model.body_ipos[body], model.body_iquat[body]])
            return np.tile(row, (self.num_instances, 1))
        pos = self.engine.model_field("body_ipos")[:, self._columns(3)]
        quat = self.engine.model_field("body_iquat")[:, self._columns(4)]
        return np.concatenate([pos, quat], axis=1)

    def write_com_pose(self, pose: Floats, ids: EnvIndex | None) -> None:
        """Set the centre-of-mass frame in the body's frame, (n, 7), from checked arrays."""
        self.engine.write_model("body_ipos", pose[:, :3], ids, self._columns(3))
        self.engine.write_model("body_iquat", pose[:, 3:], ids, self._columns(4))
        self.engine.set_const_later(ids)

    # -- shape and size --------------------------------------------------------------------------

    @property
    def shape_names(self) -> tuple[str, ...]:
        """Names of the shapes that the object may have; empty without `any_of`."""
        variants = self.index.variants
        return () if variants is None else variants.names

    def read_shape(self) -> NDArray[np.int64]:
        """(N,) index of the present shape: do not write or store."""
        return self._variant

    def write_shape(self, chosen: NDArray[np.int64], ids: EnvIndex | None) -> None:
        """Give the object the shapes with these indices (n,), from checked arrays."""
        variants = self.index.variants
        if variants is None:
            raise ValueError(f"{self.uid} has one shape: declare others in any_of")
        geoms = self.index.geom_ids
        body = self.index.root_body_id
        rows = self._rows(ids)
        mass = rows_at(variants.mass, chosen)
        inertia = rows_at(variants.inertia, chosen)
        put = self.sim.arrays.of
        self._variant[rows] = put(chosen)
        self._mass0[rows] = put(mass)
        self._inertia[rows] = put(inertia)
        # The geoms of all shapes exist in every environment: only those of the chosen one collide
        # and are drawn.
        write = self.engine.write_model
        one_each = slice(int(geoms[0]), int(geoms[-1]) + 1)
        write("geom_contype", rows_at(variants.contype, chosen), ids, one_each)
        write("geom_conaffinity", rows_at(variants.conaffinity, chosen), ids, one_each)
        write("geom_matid", rows_at(variants.materials, chosen), ids, one_each)
        write("geom_rgba", rows_at(variants.alpha, chosen), ids, 4 * geoms + 3)
        write("body_user", chosen[:, None], ids, slice(body, body + 1))
        write("body_ipos", rows_at(variants.ipos, chosen), ids, self._columns(3))
        write("body_iquat", rows_at(variants.iquat, chosen), ids, self._columns(4))
        self._write_inertia(ids, mass, inertia)

    @property
    def solid(self) -> Solid:
        """The shape's formulas for other sizes.

        Raises:
            ValueError: If the shape is a mesh or a plane, which cannot change size, or not the
                only one.
        """
        if self._solid is None:
            geoms = self.index.geom_ids.tolist()
            solids = [Solid.of(self.uid, self.engine.model, geom) for geom in geoms]
            if len(solids) != 1:
                message = f"{self.uid} has {len(solids)} shapes: only a single one has a size"
                raise ValueError(f"{message} per environment")
            self._solid = solids[0]
        return self._solid

    def read_scale(self) -> Floats:
        """(N, 3) scale of the shape along its axes."""
        return np.asarray(self.cfg.body_scale) * self._scale

    def write_scale(self, scale: Floats, ids: EnvIndex | None, fixed_density: bool = True) -> None:
        """Scale the declared shape and its inertia by checked factors (n, 3) along its axes.

        With fixed density the mass scales with the volume; else it is the compiled one.
        """
        solid = self.solid
        rows = self._rows(ids)
        size, volume, moments = solid.scaled(scale)
        self._scale[rows] = scale
        columns = slice(3 * solid.geom, 3 * solid.geom + 3)
        self.engine.write_model("geom_size", size, ids, columns)
        if self._dofs is None:
            self.engine.set_const_later(ids)
            return
        self._inertia[rows] = self.engine.model.body_inertia[self.index.root_body_id] * moments
        mass = self._mass0[rows]
        if fixed_density:
            mass = mass * volume
        self.write_mass(mass, ids)

    # -- contact and looks -----------------------------------------------------------------------

    def read_friction(self) -> Floats:
        """(N,) sliding friction coefficient."""
        return self.engine.model_field("geom_friction")[:, 3 * int(self.index.geom_ids[0])]

    def write_friction(self, friction: Floats, ids: EnvIndex | None) -> None:
        """Set the sliding friction (n, 1) from checked arrays."""
        for geom in self.index.geom_ids.tolist():
            self.engine.write_model("geom_friction", friction, ids, slice(3 * geom, 3 * geom + 1))

    def write_collision(self, on: Floats, ids: EnvIndex | None) -> None:
        """Switch contacts on (1) or off (0), (n, 1), from checked arrays."""
        geoms = self.index.geom_ids
        body = self.index.root_body_id
        variants = self.index.variants
        for name in ("contype", "conaffinity"):
            bits = getattr(self.engine.model, f"geom_{name}")[None, geoms]
            if variants is not None:
                bits = getattr(variants, name)[self._variant[self._rows(ids)]]
            for column, geom in enumerate(geoms.tolist()):
                value = on * bits[:, column : column + 1]
                self.engine.write_model(f"geom_{name}", value, ids, slice(geom, geom + 1))
            value = on * np.bitwise_or.reduce(bits.astype(np.int64), axis=1)[:, None]
            self.engine.write_model(f"body_{name}", value, ids, slice(body, body + 1))

    def set_visible(self, visible: bool = True) -> None:
        """Show or hide the body when rendering, in all environments."""
        geoms = self.index.geom_ids
        variants = self.index.variants
        alpha = self.engine.model.geom_rgba[None, geoms, 3]
        if variants is not None:
            alpha = variants.alpha[self._variant]
        for column, geom in enumerate(geoms.tolist()):
            value = alpha[:, column : column + 1] if visible else 0.0
            self.engine.write_model("geom_rgba", value, None, slice(4 * geom + 3, 4 * geom + 4))

    # -- whole simulations -------------------------------------------------------------------------

    def load_fields(self, ids: EnvIndex | None, fields: Mapping[str, NDArray[Any]]) -> None:
        """Read size, inertia and damping from model fields that were loaded into environments.

        Args:
            ids: (n,) environments, or None for all.
            fields: The loaded fields, (size,) each, equal in these environments; others are as
                compiled.
        """
        rows = self._rows(ids)
        model = self.engine.model
        variants = self.index.variants
        iquat = model.body_iquat[self.index.root_body_id]
        if variants is not None:
            present = int(field_values(model, fields, "body_user", self._columns(1))[0][0])
            self._variant[rows] = present
            self._mass0[rows] = variants.mass[present]
            iquat = variants.iquat[present]
        mass, _ = field_values(model, fields, "body_mass", self._columns(1))
        inertia, _ = field_values(model, fields, "body_inertia", self._columns(3))
        mass0 = self._mass0[rows][:, None]
        self._inertia[rows] = inertia * (mass0 / mass) if mass[0] > 0 else inertia
        if len(self.index.geom_ids):
            geom = int(self.index.geom_ids[0])
            columns = slice(3 * geom, 3 * geom + 3)
            size, compiled = field_values(model, fields, "geom_size", columns)
            self._scale[rows] = np.divide(size, compiled, out=np.ones(3), where=compiled > 0)
        if self._dofs is None:
            return
        damping, _ = field_values(model, fields, "dof_damping", self._dofs)
        about = inertia_about_axes(iquat, inertia[None])[0]
        rate = (damping[0] / mass[0], damping[3] / about[0])
        # A rate that was not drawn is the declared one, to the bit.
        same = np.isclose(rate, self._declared_damping, rtol=1e-9)
        self._damping[rows] = np.where(same, self._declared_damping, rate)

    def state_dict(self) -> dict[str, NDArray[Any]]:
        """Values that no model field contains (copies)."""
        self.index  # noqa: B018  (compiles, which sets the inertia)
        state = {"damping": self._damping, "scale": self._scale, "inertia": self._inertia}
        copies: dict[str, NDArray[Any]] = {name: values.copy() for name, values in state.items()}
        if self.index.variants is not None:
            copies["shape"] = self._variant.copy()
        return copies

    def load_state_dict(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Continue exactly where `state_dict` was taken; the engine restores model fields."""
        self._damping[...] = state["damping"]
        self._scale[...] = state["scale"]
        self._inertia[...] = state["inertia"]
        if self.index.variants is not None:
            self._variant[...] = state["shape"]
            self._mass0[...] = rows_at(self.index.variants.mass, self._variant)

    # -- for users: tensors in and out, checked; see `Handle` ----------------------------------

    @property
    def body_state(self) -> torch.Tensor:
        """(N, 13) pose (7), linear velocity (3), angular velocity (3)."""
        return torch.cat([self._data.pose, self._data.vel], dim=1)

    def set_velocity(self, lin_vel: Any = None, ang_vel: Any = None, env_ids: Any = None) -> None:
        """Set velocities of a dynamic body.

        Args:
            lin_vel: (n, 3) m/s, world axes, or None to keep it.
            ang_vel: (n, 3) rad/s, world axes, or None to keep it.
            env_ids: The n environments; None is all N.
        """
        self._need_dynamic("set_velocity")
        ids = as_env_ids(env_ids, self.num_instances)
        linear = None if lin_vel is None else self._checked(lin_vel, 3, ids, "lin_vel")[0]
        angular = None if ang_vel is None else self._checked(ang_vel, 3, ids, "ang_vel")[0]
        self.write_velocity(linear, angular, ids)

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
        ids = as_env_ids(env_ids, self.num_instances)
        forces = None if force is None else self._checked(force, 3, ids, "force")[0]
        torques = None if torque is None else self._checked(torque, 3, ids, "torque")[0]
        points = None if pos is None else self._checked(pos, 3, ids, "pos")[0]
        self.apply_wrench(forces, torques, points, ids)

    def clear_dynamics(self, env_ids: Any = None) -> None:
        """Stop the body and remove applied forces."""
        self.stop(as_env_ids(env_ids, self.num_instances))

    def get_mass(self, env_ids: Any = None) -> torch.Tensor:
        """(n,) kg."""
        return to_tensor(self.read_inertia()[0][self._rows(env_ids)])

    def set_mass(self, mass: Any, env_ids: Any = None) -> None:
        """Set the mass (n,) in kg; the inertia scales with it.

        Raises:
            ValueError: If a mass is not positive.
        """
        self._need_dynamic("set_mass")
        new, ids = self._checked(np.reshape(mass, (-1, 1)), 1, env_ids, "mass")
        if (least := self.sim.arrays.host(new).min(initial=np.inf)) <= 0:
            raise ValueError(f"{self.uid}: mass must be positive, got {least}")
        self.write_mass(new[:, 0], ids)

    def get_inertia(self, env_ids: Any = None) -> torch.Tensor:
        """(n, 3) principal moments of inertia, kg m^2."""
        return to_tensor(self.read_inertia()[1][self._rows(env_ids)])

    def set_inertia(self, inertia: Any, env_ids: Any = None) -> None:
        """Set the principal moments of inertia (n, 3) in kg m^2.

        Raises:
            ValueError: If a moment is not positive or the triangle inequality fails.
        """
        self._need_dynamic("set_inertia")
        new, ids = self._checked(inertia, 3, env_ids, "inertia")
        moments = self.sim.arrays.host(new)
        largest = moments.max(axis=1)
        if (moments <= 0).any() or (2 * largest > moments.sum(axis=1) + 1e-12).any():
            raise ValueError(
                f"{self.uid}: moments must be positive, the largest at most the sum "
                "of the other two"
            )
        self.write_inertia(new, ids)

    def get_damping(self, env_ids: Any = None) -> torch.Tensor:
        """(n, 2) linear and angular damping, 1/s."""
        return to_tensor(self.read_damping()[self._rows(env_ids)])

    def set_damping(self, damping: Any, env_ids: Any = None) -> None:
        """Set linear and angular damping, (n, 2) in 1/s."""
        self._need_dynamic("set_damping")
        self.write_damping(*self._checked(damping, 2, env_ids, "damping"))

    def set_com_pose(self, com_pose: Any, env_ids: Any = None) -> None:
        """Set the centre-of-mass frame in the body's frame, (n, 7)."""
        self._need_dynamic("set_com_pose")
        self.write_com_pose(*self._pose_rows(com_pose, env_ids, "pose"))

    def get_shape(self, env_ids: Any = None) -> torch.Tensor:
        """(n,) int64 index in `shape_names` of the present shape; 0 without `any_of`."""
        return tensor_of(self.read_shape()[self._rows(env_ids)].copy())

    def set_shape(self, shape: Any, env_ids: Any = None) -> None:
        """Give the object another of its shapes: (n,) indices in `shape_names`.

        Mass, inertia and centre of mass become those of the shape; the pose does not change.

        Raises:
            ValueError: If the object has no `any_of`, or there is no such shape.
        """
        names = self.shape_names
        chosen, ids = self._checked(np.asarray(shape).reshape(-1, 1), 1, env_ids, "shape")
        if not names:
            raise ValueError(f"{self.uid} has one shape: declare others in any_of")
        numbers = chosen[:, 0].astype(np.int64)
        if (numbers != chosen[:, 0]).any() or not ((numbers >= 0) & (numbers < len(names))).all():
            message = f"indices of the shapes {', '.join(names)}, got {np.unique(chosen).tolist()}"
            raise ValueError(f"{self.uid}: shape must be {message}")
        self.write_shape(numbers, ids)

    def get_body_scale(self, env_ids: Any = None) -> torch.Tensor:
        """(n, 3) scale of the shape."""
        return to_tensor(self.read_scale()[self._rows(env_ids)])

    def set_body_scale(self, scale: Any, env_ids: Any = None) -> None:
        """Set the shape's scale (n, 3); mass and inertia change at constant density.

        Raises:
            ValueError: If the shape is a mesh or a plane, or these factors would change its kind.
        """
        scales, ids = self._checked(scale, 3, env_ids, "scale")
        relative = scales / np.asarray(self.cfg.body_scale, np.float64)
        self.solid.check(relative)
        self.write_scale(relative, ids)

    def get_friction(self, env_ids: Any = None) -> torch.Tensor:
        """(n,) sliding friction coefficient."""
        return to_tensor(self.read_friction()[self._rows(env_ids)])

    def set_friction(self, friction: Any, env_ids: Any = None) -> None:
        """Set the sliding friction (n,); a contact takes the larger value of its two bodies.

        A static object that was given no friction lets others decide: this has no effect on it.
        """
        new, ids = self._checked(np.reshape(friction, (-1, 1)), 1, env_ids, "friction")
        if (new < 0).any():
            raise ValueError(f"{self.uid}: friction must not be negative, got {new.min()}")
        self.write_friction(new, ids)

    def enable_collision(self, enable: Any, env_ids: Any = None) -> None:
        """Switch contacts on or off, (n,) booleans."""
        flags = np.asarray(enable)
        if flags.dtype != np.bool_ or flags.ndim != 1:
            raise ValueError(f"{self.uid}: enable must be booleans (n,), got {flags.shape}")
        self.write_collision(*self._checked(flags[:, None], 1, env_ids, "enable"))

    def get_user_ids(self) -> torch.Tensor:
        """(N,) id of the body in segmentation images: its MuJoCo body id."""
        return torch.full((self.num_instances,), self.index.root_body_id, dtype=torch.int32)
