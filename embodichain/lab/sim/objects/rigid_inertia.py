"""Mass, inertia, damping and size of one rigid body per environment; formulas of solids."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.compiler.rigid_objects import inertia_about_axes
from embodichain.lab.sim.engine.base import F64

if TYPE_CHECKING:
    from embodichain.lab.sim.cfg import RigidObjectCfg
    from embodichain.lab.sim.compiler.index import EntityIndex
    from embodichain.lab.sim.engine.base import F64, EnvIndex
    from embodichain.lab.sim.host import Binding

__all__ = ["RigidInertia", "Solid"]

_GEOM = mujoco.mjtGeom
_NAMES = {
    int(_GEOM.mjGEOM_BOX): "box",
    int(_GEOM.mjGEOM_SPHERE): "sphere",
    int(_GEOM.mjGEOM_ELLIPSOID): "ellipsoid",
    int(_GEOM.mjGEOM_CYLINDER): "cylinder",
    int(_GEOM.mjGEOM_CAPSULE): "capsule",
}


@dataclass(frozen=True, eq=False)
class Solid:
    """One primitive geom.

    Attributes:
        uid: Its entity.
        kind: ``box``, ``sphere``, ``ellipsoid``, ``cylinder`` or ``capsule``.
        geom: Its id in the model.
        size: (3,) its compiled half sizes in metres: see MuJoCo's `geom_size`.
        axes: (3,) which axis of the geom each principal axis of the body is.
    """

    uid: str
    kind: str
    geom: int
    size: F64
    axes: NDArray[np.int64]

    @staticmethod
    def of(uid: str, model: mujoco.MjModel, geom: int) -> Solid:
        """The shape of a geom.

        Raises:
            ValueError: If it has no size that could differ between environments.
        """
        kind = _NAMES.get(int(model.geom_type[geom]))
        if kind is None:
            what = _GEOM(int(model.geom_type[geom])).name.removeprefix("mjGEOM_").lower()
            raise ValueError(
                f"{uid} is a {what}, whose size is compiled into the model's assets: only "
                f"{', '.join(_NAMES.values())} have a size per environment"
            )
        principal, own = np.zeros(9), np.zeros(9)
        mujoco.mju_quat2Mat(principal, model.body_iquat[model.geom_bodyid[geom]])
        mujoco.mju_quat2Mat(own, model.geom_quat[geom])
        aligned = np.abs(principal.reshape(3, 3).T @ own.reshape(3, 3))
        return Solid(uid, kind, geom, model.geom_size[geom].copy(), aligned.argmax(axis=1))

    @property
    def equal_axes(self) -> tuple[int, ...]:
        """Axes whose scales must be equal for the shape to stay what it is."""
        return {"sphere": (0, 1, 2), "cylinder": (0, 1), "capsule": (0, 1)}.get(self.kind, ())

    def check(self, scale: F64) -> None:
        """Refuse scales (n, 3) that are not positive or make another kind of shape.

        Raises:
            ValueError: Says which.
        """
        if not (scale > 0).all():
            raise ValueError(f"{self.uid}: scales must be positive, got {scale.min()}")
        equal = list(self.equal_axes)
        if equal and (scale[:, equal] != scale[:, equal[:1]]).any():
            axes = ", ".join("xyz"[axis] for axis in equal)
            raise ValueError(f"{self.uid}: a {self.kind} scales equally along {axes}")

    def scaled(self, scale: F64) -> tuple[F64, F64, F64]:
        """Sizes (n, 3), and volume (n,) and moments at equal mass (n, 3) over the compiled ones.

        Args:
            scale: (n, 3) factors along the geom's axes.
        """
        if self.kind in ("box", "ellipsoid"):
            size = self.size * scale
        elif self.kind == "sphere":
            size = self.size * scale[:, :1]
        else:
            size = self.size * scale[:, [0, 2, 2]]
        volume = _volume(self.kind, size) / _volume(self.kind, self.size[None])
        moments = _moments(self.kind, size) / _moments(self.kind, self.size[None])
        return size, volume, moments[:, self.axes]


def _volume(kind: str, size: F64) -> F64:
    """Up to a constant factor, (n,)."""
    a, b, c = size[:, 0], size[:, 1], size[:, 2]
    if kind == "sphere":
        return a * a * a
    if kind == "cylinder":
        return a * a * b
    if kind == "capsule":
        return a * a * (2.0 * b + 4.0 / 3.0 * a)
    return a * b * c


def _moments(kind: str, size: F64) -> F64:
    """About the geom's axes per mass, up to a constant factor; (n, 3)."""
    a, b, c = size[:, 0], size[:, 1], size[:, 2]
    if kind == "sphere":
        x = y = z = a * a
    elif kind == "cylinder":
        x = y = (3.0 * a * a + 4.0 * b * b) / 12.0
        z = 0.5 * a * a
    elif kind == "capsule":
        ball = 4.0 / 3.0 * a / (2.0 * b + 4.0 / 3.0 * a)  # its share of the mass
        tube = 1.0 - ball
        x = y = tube * (3.0 * a * a + 4.0 * b * b) / 12.0 + ball * (
            0.4 * a * a + b * b + 0.75 * a * b
        )
        z = tube * 0.5 * a * a + ball * 0.4 * a * a
    else:
        x, y, z = b * b + c * c, a * a + c * c, a * a + b * b
    return np.stack([x, y, z], axis=1)


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
