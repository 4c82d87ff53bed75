"""`RigidInertia`: mass, inertia, damping and size of one rigid body per environment."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.compiler.inertia import inertia_about_axes
from embodichain.lab.sim.objects.solids import Solid

if TYPE_CHECKING:
    from embodichain.lab.sim.cfg import RigidObjectCfg
    from embodichain.lab.sim.compiler.index import EntityIndex
    from embodichain.lab.sim.engine.base import F64, EnvIndex
    from embodichain.lab.sim.host import Binding

__all__ = ["RigidInertia"]


class RigidInertia:
    """Writes that keep mass, inertia and damping of a body consistent, from checked arrays.

    Args:
        binding: The body's place in the simulation.
        cfg: Its config.
    """

    def __init__(self, binding: Binding[EntityIndex], cfg: RigidObjectCfg) -> None:
        self._binding = binding
        self._cfg = cfg
        self._damping: F64 = np.zeros((1, 2))
        self._scale: F64 = np.ones((1, 3))
        self._mass0 = 0.0
        self._inertia: F64 = np.zeros((1, 3))  # at the compiled mass and the present scale
        self._solid: Solid | None = None

    def bind(self) -> None:
        """Take over the compiled values; called once the scene is compiled."""
        model, body = self._binding.engine.model, self._binding.index.root_body_id
        count, attrs = self._binding.num_envs, self._cfg.attrs
        damping = np.asarray([attrs.linear_damping, attrs.angular_damping], np.float64)
        self._damping = np.tile(damping, (count, 1))
        self._scale = np.ones((count, 3))
        self._mass0 = float(model.body_mass[body])
        self._inertia = np.tile(model.body_inertia[body], (count, 1))

    @property
    def dofs(self) -> slice | None:
        """The 6 columns of the body's free joint in qvel; None if it is not dynamic."""
        start = self._binding.index.free_qvel_adr
        return slice(start, start + 6) if start >= 0 else None

    @property
    def solid(self) -> Solid:
        """The body's shape at other sizes.

        Raises:
            ValueError: If the shape has no size that could change: a mesh or a plane.
        """
        if self._solid is None:
            model, index = self._binding.engine.model, self._binding.index
            self._solid = Solid.of(self._binding.uid, model, int(index.geom_ids[0]))
        return self._solid

    def read(self, ids: EnvIndex | None = None) -> tuple[F64, F64]:
        """Mass (n,) in kg and principal moments (n, 3) in kg m^2 (copies)."""
        engine, body = self._binding.engine, self._binding.index.root_body_id
        mass = engine.model_field("body_mass")[:, body].copy()
        inertia = engine.model_field("body_inertia")[:, 3 * body : 3 * body + 3].copy()
        return (mass, inertia) if ids is None else (mass[ids], inertia[ids])

    def read_damping(self) -> F64:
        """(N, 2) linear and angular damping, 1/s; do not write."""
        self._binding.index  # noqa: B018  (compiles, which fills the values)
        return self._damping

    def read_scale(self) -> F64:
        """(N, 3) scale over the compiled size; do not write."""
        self._binding.index  # noqa: B018  (compiles, which fills the values)
        return self._scale

    def write_mass(self, mass: F64, ids: EnvIndex | None, inertia: bool = True) -> None:
        """Set the mass (n,) in kg, and with it inertia and damping.

        Args:
            mass: Positive.
            ids: (n,) environments, or None for all.
            inertia: False leaves the inertia as it is: another distribution of mass.
        """
        moments = self._inertia if ids is None else self._inertia[ids]
        self._write(ids, mass, moments * (mass / self._mass0)[:, None], inertia)

    def write_inertia(self, moments: F64, ids: EnvIndex | None) -> None:
        """Set the principal moments (n, 3) in kg m^2 that belong to the present mass."""
        mass = self.read(ids)[0]
        self._inertia[slice(None) if ids is None else ids] = moments * (self._mass0 / mass)[:, None]
        self._write(ids, mass, moments)

    def write_inertia_scale(self, factor: F64, ids: EnvIndex | None) -> None:
        """Scale the inertia that belongs to the present mass and size by (n,) factors."""
        mass = self.read(ids)[0]
        moments = self._inertia if ids is None else self._inertia[ids]
        self._write(ids, mass, moments * (mass / self._mass0 * factor)[:, None])

    def write_damping(self, damping: F64, ids: EnvIndex | None) -> None:
        """Set linear and angular damping, (n, 2) in 1/s."""
        self._binding.index  # noqa: B018  (compiles, which fills the values)
        self._damping[slice(None) if ids is None else ids] = damping
        self._damp(ids, *self.read(ids))

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
        engine, body = self._binding.engine, self._binding.index.root_body_id
        engine.write_model("geom_size", size, ids, slice(3 * solid.geom, 3 * solid.geom + 3))
        if self.dofs is None:
            engine.set_const_later(ids)
            return
        self._inertia[where] = engine.model.body_inertia[body] * moments
        mass = self._mass0 * volume if fixed_density else np.full(len(scale), self._mass0)
        self.write_mass(mass, ids)

    def _write(self, ids: EnvIndex | None, mass: F64, moments: F64, inertia: bool = True) -> None:
        engine, body = self._binding.engine, self._binding.index.root_body_id
        engine.write_model("body_mass", mass[:, None], ids, slice(body, body + 1))
        if inertia:
            engine.write_model("body_inertia", moments, ids, slice(3 * body, 3 * body + 3))
        self._damp(ids, mass, moments if inertia else self.read(ids)[1])
        engine.set_const_later(ids)

    def _damp(self, ids: EnvIndex | None, mass: F64, moments: F64) -> None:
        """Keep velocities decaying at the same rates; see the compiler's `damping_of`."""
        if self.dofs is None:
            return
        engine = self._binding.engine
        rate = self._damping if ids is None else self._damping[ids]
        values = np.empty((len(mass), 6))
        values[:, :3] = (rate[:, 0] * mass)[:, None]
        iquat = engine.model.body_iquat[self._binding.index.root_body_id]
        values[:, 3:] = rate[:, 1:] * inertia_about_axes(iquat, moments)
        engine.write_model("dof_damping", values, ids, self.dofs)

    # -- whole simulations -------------------------------------------------------------------------

    def take_over(self, ids: EnvIndex | None, fields: Mapping[str, NDArray[Any]]) -> None:
        """Read size, inertia and damping out of a model that environments were given.

        Args:
            ids: (n,) environments, or None for all.
            fields: Model fields, (size,) each, of all these environments; absent ones are as
                compiled.
        """
        where: Any = slice(None) if ids is None else ids
        index = self._binding.index
        model, body = self._binding.engine.model, index.root_body_id

        def pair(name: str, columns: slice) -> tuple[F64, F64]:
            compiled = np.asarray(getattr(model, name), np.float64).reshape(-1)[columns]
            given = np.asarray(fields.get(name, getattr(model, name)), np.float64)
            return given.reshape(-1)[columns], compiled

        mass, _ = pair("body_mass", slice(body, body + 1))
        inertia, _ = pair("body_inertia", slice(3 * body, 3 * body + 3))
        self._inertia[where] = inertia * (self._mass0 / mass) if mass[0] > 0 else inertia
        geom = int(index.geom_ids[0])
        size, compiled = pair("geom_size", slice(3 * geom, 3 * geom + 3))
        self._scale[where] = np.divide(size, compiled, out=np.ones(3), where=compiled > 0)
        if self.dofs is None:
            return
        damping, compiled = pair("dof_damping", self.dofs)
        declared = [self._cfg.attrs.linear_damping, self._cfg.attrs.angular_damping]
        about = inertia_about_axes(model.body_iquat[body], inertia[None])[0]
        rate = damping[0] / mass[0], damping[3] / about[0]
        same = np.isclose(rate, declared, rtol=1e-9)
        self._damping[where] = np.where(same, declared, rate)

    def state_dict(self) -> dict[str, F64]:
        """Values that are in no model field (copies)."""
        damping, scale = self.read_damping().copy(), self.read_scale().copy()
        return {"damping": damping, "scale": scale, "inertia": self._inertia.copy()}

    def load_state_dict(self, state: dict[str, F64]) -> None:
        """Continue exactly where `state_dict` was taken; the engine restores model fields."""
        self._damping[...] = state["damping"]
        self._scale[...] = state["scale"]
        self._inertia[...] = state["inertia"]
