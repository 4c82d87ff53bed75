"""`RigidProperties`: mass, inertia, size, friction and damping of one rigid body per environment.

Checked setters are for users, `write_...` doors without checks are for terms. What a scaled shape
weighs is in `solids.py`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

from embodichain.lab.sim.compiler.inertia import inertia_about_axes
from embodichain.lab.sim.objects._arrays import as_rows, bool_rows, to_tensor
from embodichain.lab.sim.objects.entity import BatchEntity
from embodichain.lab.sim.objects.solids import Solid

if TYPE_CHECKING:
    from embodichain.lab.sim.cfg import RigidObjectCfg
    from embodichain.lab.sim.compiler.index import EntityIndex
    from embodichain.lab.sim.engine.base import F64, Engine, EnvIndex
    from embodichain.lab.sim.host import Host

__all__ = ["RigidProperties"]


class RigidProperties(BatchEntity):
    """What the model says of a rigid body, which may differ between environments."""

    cfg: RigidObjectCfg

    def __init__(self, cfg: RigidObjectCfg, uid: str, host: Host) -> None:
        super().__init__(cfg, uid, host)
        self._damping: F64 = np.zeros((1, 2))
        self._scale: F64 = np.ones((1, 3))
        self._mass0 = 0.0
        self._inertia: F64 = np.zeros((1, 3))  # at the compiled mass and the present scale
        self._solid: Solid | None = None

    def bind(self, engine: Engine, index: EntityIndex) -> None:
        """Learn where the compiled model keeps this body."""
        super().bind(engine, index)
        count, model, body = self.num_instances, engine.model, index.root_body_id
        damping = [self.cfg.attrs.linear_damping, self.cfg.attrs.angular_damping]
        self._damping = np.tile(np.asarray(damping, np.float64), (count, 1))
        self._scale = np.ones((count, 3))
        self._mass0 = float(model.body_mass[body])
        self._inertia = np.tile(model.body_inertia[body], (count, 1))

    @property
    def is_static(self) -> bool:
        """Whether the body never moves."""
        return self.cfg.body_type == "static"

    @property
    def is_non_dynamic(self) -> bool:
        """Whether forces do not move the body."""
        return self.cfg.body_type != "dynamic"

    def _dofs(self) -> slice | None:
        start = self.entity.free_qvel_adr
        return slice(start, start + 6) if start >= 0 else None

    def _need_dynamic(self, what: str) -> slice:
        dofs = self._dofs()
        if dofs is None:
            raise ValueError(f"{self.uid} is {self.cfg.body_type}: {what} needs body_type: dynamic")
        return dofs

    def model_values(self, field: str, columns: slice) -> NDArray[Any]:
        """(N, k) per-environment values of a flattened model field; a copy."""
        return self.engine.model_field(field)[:, columns].copy()

    # -- mass and inertia ------------------------------------------------------------------------

    def write_mass(self, mass: F64, ids: EnvIndex | None, inertia: bool = True) -> None:
        """Set the mass (n,) in kg, and with it inertia and damping; the door for terms.

        Args:
            mass: Positive.
            ids: (n,) environments, or None for all.
            inertia: False leaves the inertia as it is: another distribution of mass.
        """
        moments = self._inertia if ids is None else self._inertia[ids]
        self._write_inertial(ids, mass, moments * (mass / self._mass0)[:, None], inertia)

    def write_inertia_scale(self, factor: F64, ids: EnvIndex | None) -> None:
        """Scale the inertia that belongs to the present mass and size by (n,) factors."""
        mass = self._inertial(ids)[0]
        moments = self._inertia if ids is None else self._inertia[ids]
        scaled = moments * (mass / self._mass0 * factor)[:, None]
        self._write_inertial(ids, mass, scaled)

    def _write_inertial(
        self, ids: EnvIndex | None, mass: F64, moments: F64, inertia: bool = True
    ) -> None:
        body = self.entity.root_body_id
        engine = self.engine
        engine.write_model("body_mass", mass[:, None], ids, slice(body, body + 1))
        if inertia:
            engine.write_model("body_inertia", moments, ids, slice(3 * body, 3 * body + 3))
        self._write_damping(ids, mass, moments if inertia else self._inertial(ids)[1])
        engine.set_const_later(ids)

    def _write_damping(self, ids: EnvIndex | None, mass: F64, moments: F64) -> None:
        """Keep velocities decaying at the same rates; as the compiler's `damping_of`."""
        dofs = self._dofs()
        if dofs is None:
            return
        rate = self._damping if ids is None else self._damping[ids]
        values = np.empty((len(mass), 6))
        values[:, :3] = (rate[:, 0] * mass)[:, None]
        iquat = self.engine.model.body_iquat[self.entity.root_body_id]
        values[:, 3:] = rate[:, 1:] * inertia_about_axes(iquat, moments)
        self.engine.write_model("dof_damping", values, ids, dofs)

    def _inertial(self, ids: EnvIndex | None) -> tuple[F64, F64]:
        body = self.entity.root_body_id
        mass = self.model_values("body_mass", slice(body, body + 1))[:, 0]
        inertia = self.model_values("body_inertia", slice(3 * body, 3 * body + 3))
        return (mass, inertia) if ids is None else (mass[ids], inertia[ids])

    def get_mass(self, env_ids: Any = None) -> torch.Tensor:
        """(n,) kg."""
        return to_tensor(self._inertial(self._ids(env_ids)[0])[0])

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
        self.write_mass(new, ids)

    def get_inertia(self, env_ids: Any = None) -> torch.Tensor:
        """(n, 3) principal moments of inertia, kg m^2."""
        return to_tensor(self._inertial(self._ids(env_ids)[0])[1])

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
        mass = self._inertial(ids)[0]
        self._inertia[slice(None) if ids is None else ids] = new * (self._mass0 / mass)[:, None]
        self._write_inertial(ids, mass, new)

    def get_damping(self, env_ids: Any = None) -> torch.Tensor:
        """(n, 2) linear and angular damping, 1/s."""
        ids, _ = self._ids(env_ids)
        self.entity  # noqa: B018  (compiles, which fills the values)
        return to_tensor(self._damping if ids is None else self._damping[ids])

    def set_damping(self, damping: Any, env_ids: Any = None) -> None:
        """Set linear and angular damping, (n, 2) in 1/s."""
        self._need_dynamic("set_damping")
        ids, rows = self._ids(env_ids)
        self._damping[slice(None) if ids is None else ids] = as_rows(
            damping, rows, 2, f"{self.uid}: damping"
        )
        self._write_damping(ids, *self._inertial(ids))

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
        """What the shape weighs at other sizes.

        Raises:
            ValueError: If the shape has no size that could change: a mesh or a plane.
        """
        if self._solid is None:
            self._solid = Solid.of(self.uid, self.engine.model, int(self.entity.geom_ids[0]))
        return self._solid

    def write_scale(self, scale: F64, ids: EnvIndex | None, fixed_density: bool = True) -> None:
        """Scale the declared shape by (n, 3) factors, and mass and inertia with it.

        Args:
            scale: Along the shape's own axes.
            ids: (n,) environments, or None for all.
            fixed_density: Whether the mass follows the volume; else it is the compiled one.
        """
        solid, where = self.solid, slice(None) if ids is None else ids
        size, volume, moments = solid.scaled(scale)
        self._scale[where] = scale
        engine, body = self.engine, self.entity.root_body_id
        engine.write_model("geom_size", size, ids, slice(3 * solid.geom, 3 * solid.geom + 3))
        if self.is_non_dynamic:
            engine.set_const_later(ids)
            return
        self._inertia[where] = engine.model.body_inertia[body] * moments
        mass = self._mass0 * volume if fixed_density else np.full(len(scale), self._mass0)
        self.write_mass(mass, ids)

    def get_body_scale(self, env_ids: Any = None) -> torch.Tensor:
        """(n, 3) scale of the shape."""
        ids, _ = self._ids(env_ids)
        self.entity  # noqa: B018  (compiles, which fills the values)
        scale = np.asarray(self.cfg.body_scale, np.float64) * self._scale
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
        values = self.model_values("geom_friction", slice(3 * geom, 3 * geom + 1))[:, 0]
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
        """Read size, inertia and damping out of a model that environments were given.

        Args:
            ids: (n,) environments, or None for all.
            fields: Model fields, (size,) each, of all these environments; absent ones are as
                compiled.
        """
        where: Any = slice(None) if ids is None else ids
        model, body = self.engine.model, self.entity.root_body_id

        def pair(name: str, columns: slice) -> tuple[F64, F64]:
            compiled = np.asarray(getattr(model, name), np.float64).reshape(-1)[columns]
            given = np.asarray(fields.get(name, getattr(model, name)), np.float64)
            return given.reshape(-1)[columns], compiled

        mass, _ = pair("body_mass", slice(body, body + 1))
        inertia, _ = pair("body_inertia", slice(3 * body, 3 * body + 3))
        self._inertia[where] = inertia * (self._mass0 / mass) if mass[0] > 0 else inertia
        geom = int(self.entity.geom_ids[0])
        size, compiled = pair("geom_size", slice(3 * geom, 3 * geom + 3))
        self._scale[where] = np.divide(size, compiled, out=np.ones(3), where=compiled > 0)
        dofs = self._dofs()
        if dofs is None:
            return
        damping, compiled = pair("dof_damping", dofs)
        declared = [self.cfg.attrs.linear_damping, self.cfg.attrs.angular_damping]
        about = inertia_about_axes(model.body_iquat[body], inertia[None])[0]
        rate = damping[0] / mass[0], damping[3] / about[0]
        same = np.isclose(rate, declared, rtol=1e-9)
        self._damping[where] = np.where(same, declared, rate)

    def state_dict(self) -> dict[str, F64]:
        """What stands in no model field (copies)."""
        self.entity  # noqa: B018  (compiles, which fills the values)
        return {
            "damping": self._damping.copy(),
            "scale": self._scale.copy(),
            "inertia": self._inertia.copy(),
        }

    def load_state_dict(self, state: dict[str, F64]) -> None:
        """Continue exactly where `state_dict` was taken; the engine restores model fields."""
        self._damping[...] = state["damping"]
        self._scale[...] = state["scale"]
        self._inertia[...] = state["inertia"]
