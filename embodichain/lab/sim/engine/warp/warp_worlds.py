"""`WarpWorlds`: N worlds of one model on a device of Warp, copied from and to arrays on the host.

Warp computes in float32. Importing this module imports Warp.
"""

from __future__ import annotations

import copy
import logging
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import mujoco_warp as mjw
import numpy as np
import torch
import warp as wp
from numpy.typing import NDArray

from embodichain.lab.sim.engine.api import F64
from embodichain.lab.sim.engine.fields import DERIVED_FIELDS, compiled_field, row_layout
from embodichain.lab.sim.engine.warp.warp_support import start_warp
from embodichain.utils.errors import ConfigError, Problem

__all__ = [
    "LEAST_TOLERANCE",
    "NO_LIMIT",
    "PLACES",
    "Counts",
    "WarpWorlds",
    "measured_sizes",
]

_log = logging.getLogger(__name__)
_AUTORESET = int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
_LOOKS = ("mat_", "light_", "cam_", "geom_castshadow", "geom_group", "site_rgba", "site_matid")
"""Beginnings of fields that only pictures read; some of them only those drawn on the host."""
PLACES = frozenset({"geom_pos", "geom_quat", "body_pos", "body_quat"})
NO_LIMIT = 1e30
"""Force range of actuators without a limit, where others have one, N or Nm."""
_MANY, _FEW = 4096, 16
"""Memory of a measurement, and the least memory of a simulation."""
_FIRST_GROUP = wp.types.vector(length=6, dtype=float)(1, 0, 0, 0, 0, 0)
LEAST_TOLERANCE = 1e-6
"""Of the solver in float32, as `mujoco_warp.put_model` sets it."""


@wp.kernel  # type: ignore[untyped-decorator]
def _actuator_velocity(
    counts: wp.array2d[int],
    starts: wp.array2d[int],
    dofs: wp.array2d[int],
    moment: wp.array2d[float],
    qvel: wp.array2d[float],
    velocity: wp.array2d[float],
) -> None:
    world, actuator = wp.tid()  # type: ignore[misc]
    start = starts[world, actuator]
    total = float(0.0)  # noqa: UP018  (a variable of Warp)
    for k in range(counts[world, actuator]):
        total += moment[world, start + k] * qvel[world, dofs[world, start + k]]
    velocity[world, actuator] = total


class Counts(NamedTuple):
    """Numbers of one position stage.

    Attributes:
        contacts: Contacts of all worlds.
        pairs: Pairs of geoms near each other in all worlds; they use the memory of contacts.
        rows: (N,) rows of constraints.
        overflow: (N,) bits of `mujoco_warp.OverflowType`.
    """

    contacts: int
    pairs: int
    rows: NDArray[np.int32]
    overflow: NDArray[np.int32]


class WarpWorlds:
    """N worlds of one model on a device.

    Args:
        model: The compiled scene, in which `unsupported` finds nothing.
        count: N.
        device: ``cpu``, ``cuda`` or ``cuda:N``.
        nconmax: Contacts for each world, from a memory shared by all; None is Warp's estimate.
        njmax: Rows of constraints for each world; None is Warp's estimate.

    Attributes:
        nconmax, njmax: The limits in use.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        count: int,
        device: str = "cpu",
        nconmax: int | None = None,
        njmax: int | None = None,
    ) -> None:
        start_warp()
        self._count = count
        self._device = wp.get_device(device)
        self._compiled = model
        self._layout = row_layout(model)
        host = copy.copy(model)
        host.opt.disableflags &= ~_AUTORESET  # Warp has no such flag, and never resets
        _say_where_kernels_are()
        with wp.ScopedDevice(self._device):
            self._model = mjw.put_model(host)
            self._model.opt.warn_overflow = 0  # `counts` reports it
            self._data = mjw.make_data(host, nworld=count, nconmax=nconmax, njmax=njmax)
        self.nconmax = int(self._data.naconmax) // count
        self.njmax = int(self._data.njmax)
        self._groups: dict[bytes, Any] = {}
        self._own: set[str] = set()  # model fields with values for each world
        self._all_limited = False
        self._limited = np.tile(model.actuator_forcelimited != 0, (count, 1))
        self._ranges = np.tile(model.actuator_forcerange, (count, 1, 1))

    # -- states ------------------------------------------------------------------------------------

    def upload(self, rows: F64) -> None:
        """Set the states of all worlds from integration-state rows (N, nstate)."""
        for columns, array in self._components():
            array.assign(_as_type(rows[:, columns], array))

    def download(self, name: str) -> NDArray[Any]:
        """A state component of all worlds, (N, width)."""
        values: NDArray[Any] = getattr(self._data, name).numpy()
        return values.reshape(self._count, -1)

    def _components(self) -> Iterator[tuple[slice, Any]]:
        for name, columns in self._layout.items():
            if columns.stop > columns.start:
                yield columns, getattr(self._data, name)

    def read(self, name: str, out: F64) -> None:
        """Copy a field of `mjData` into an array (N, ...) as `mujoco.batch` shapes it."""
        out[...] = getattr(self._data, name).numpy().reshape(out.shape)

    def view(self, name: str, width: int | None = None) -> torch.Tensor:
        """A field of `mjData` of all worlds as a tensor, (N, ...) or (N, width); shares memory."""
        tensor: torch.Tensor = wp.to_torch(getattr(self._data, name))
        return tensor if width is None else tensor.view(self._count, width)

    def width(self, name: str) -> int | None:
        """Numbers of a field of `mjData` in one world; None if Warp has no such field."""
        array = getattr(self._data, name, None)
        if not isinstance(array, wp.array) or not array.shape or array.shape[0] != self._count:
            return None
        return int(np.prod(array.numpy().shape[1:]))

    # -- physics -----------------------------------------------------------------------------------

    def step(self, nstep: int, after_each: Callable[[], None] | None = None) -> None:
        """Advance all worlds; see `counts` for overflows.

        Args:
            nstep: Number of steps.
            after_each: Called after each of them.
        """
        with wp.ScopedDevice(self._device):
            self._data.overflow.zero_()
            for _ in range(nstep):
                mjw.step(self._model, self._data)
                if after_each is not None:
                    after_each()

    def forward(self) -> None:
        """Compute all stages of all worlds; see `counts` for overflows."""
        with wp.ScopedDevice(self._device):
            self._data.overflow.zero_()
            mjw.forward(self._model, self._data)

    def kinematics(
        self, *, centres: bool = True, cameras: bool = True, velocities: bool = True
    ) -> None:
        """Compute poses of bodies, geoms and sites.

        Args:
            centres: Also ``subtree_com`` and ``cdof``, on which velocities depend.
            cameras: Also those of cameras and lights.
            velocities: Also ``cvel`` and ``cdof_dot``.
        """
        model, data = self._model, self._data
        with wp.ScopedDevice(self._device):
            mjw.kinematics(model, data)
            if centres or velocities:
                mjw.com_pos(model, data)
            if cameras:
                mjw.camlight(model, data)
            if velocities:
                mjw.com_vel(model, data)

    def position_and_velocity(self) -> None:
        """Compute the position and velocity stages with their sensors."""
        model, data = self._model, self._data
        with wp.ScopedDevice(self._device):
            self.positions()
            data.sensordata.zero_()
            mjw.sensor_pos(model, data)
            mjw.fwd_velocity(model, data)
            mjw.sensor_vel(model, data)

    def actuation(self, *, cameras: bool = True, velocities: bool = True) -> None:
        """Compute forces of actuators, and what they depend on; no contacts.

        Args:
            cameras: Also poses of cameras and lights, see `kinematics`.
            velocities: Also velocities of bodies.
        """
        model, data = self._model, self._data
        self.kinematics(cameras=cameras, velocities=velocities)
        with wp.ScopedDevice(self._device):
            mjw.tendon(model, data)
            mjw.transmission(model, data)
            if self._compiled.jnt_actgravcomp.any():  # computed with the passive forces
                mjw.fwd_velocity(model, data)
            else:
                inputs = [
                    data.moment_rownnz,
                    data.moment_rowadr,
                    data.moment_colind,
                    data.actuator_moment,
                    data.qvel,
                    data.actuator_velocity,
                ]
                wp.launch(_actuator_velocity, data.moment_rownnz.shape, inputs)
            mjw.fwd_actuation(model, data)

    def positions(self) -> None:
        """Compute the position stage: contacts and constraints."""
        with wp.ScopedDevice(self._device):
            self._data.overflow.zero_()
            mjw.fwd_position(self._model, self._data)

    def counts(self) -> Counts:
        """Numbers of the last position stage, and overflows since the last computation began."""
        data = self._data
        return Counts(
            contacts=int(data.nacon.numpy()[0]),
            pairs=int(data.ncollision.numpy()[0]),
            rows=data.nefc.numpy().copy(),
            overflow=data.overflow.numpy().copy(),
        )

    def contacts(self) -> NDArray[np.int64]:
        """(n, 3) world and two geom ids of each contact of the last position stage, sorted."""
        count = self.counts().contacts
        contact = self._data.contact
        ids = np.column_stack([contact.worldid.numpy()[:count], contact.geom.numpy()[:count]])
        ids[:, 1:].sort(axis=1)
        return np.asarray(ids[np.lexsort(ids.T[::-1])], np.int64)

    def want_constraint_forces(self) -> None:
        """Also compute ``cacc``, ``cfrc_int`` and ``cfrc_ext`` from now on."""
        self._model.opt.run_rne_postconstraint = True

    def rays(
        self, origins: NDArray[np.float32], directions: NDArray[np.float32], geoms: Any
    ) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        """Intersect rays with geoms at the current kinematics.

        Args:
            origins: (N, R, 3) metres.
            directions: (N, R, 3).
            geoms: (ngeom,) mask of geoms that can be hit.

        Returns:
            Distances (N, R) in lengths of the direction and geom ids (N, R), -1 for none; normals
            (N, R, 3), 0 for none.
        """
        device = str(self._device)
        hits = self.cast(
            torch.from_numpy(origins).to(device), torch.from_numpy(directions).to(device), geoms
        )
        distance, geom, normal = (part.cpu().numpy() for part in hits)
        return distance, geom, normal

    def cast(
        self, origins: torch.Tensor, directions: torch.Tensor, geoms: NDArray[np.bool_]
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Intersect rays as `rays` does, with contiguous float32 tensors on the device."""
        model = self._model
        count, each = origins.shape[:2]
        key = geoms.tobytes()
        distance = torch.empty((count, each), device=origins.device)
        geom = torch.empty((count, each), dtype=torch.int32, device=origins.device)
        normal = torch.empty((count, each, 3), device=origins.device)
        none = torch.full((each,), -1, dtype=torch.int32, device=origins.device)
        lengths = torch.linalg.vector_norm(directions, dim=-1)
        units = directions / lengths[..., None]
        with wp.ScopedDevice(self._device):
            if key not in self._groups:  # geoms are chosen by group
                self._groups[key] = wp.array(np.where(geoms, 0, 5), dtype=int)
            compiled_group = model.geom_group
            model.geom_group = self._groups[key]
            try:
                mjw.rays(
                    model,
                    self._data,
                    wp.from_torch(origins, wp.vec3),
                    wp.from_torch(units, wp.vec3),
                    _FIRST_GROUP,
                    True,
                    wp.from_torch(none),
                    wp.from_torch(distance),
                    wp.from_torch(geom),
                    wp.from_torch(normal, wp.vec3),
                )
            finally:
                model.geom_group = compiled_group
        is_hit = geom >= 0
        return (
            torch.where(is_hit, distance / lengths, -1.0),
            geom,
            torch.where(is_hit[..., None], normal, 0.0),
        )

    # -- pictures ----------------------------------------------------------------------------------

    def render_context(self, **options: Any) -> Any:
        """Make what `mujoco_warp.render` needs of the scene, a `RenderContext`."""
        with wp.ScopedDevice(self._device):
            return mjw.create_render_context(self._compiled, self._count, **options)

    def refit(self, context: Any) -> None:
        """Move a context's boxes around geoms to their poses."""
        with wp.ScopedDevice(self._device):
            mjw.refit_bvh(self._model, self._data, context)

    def render(self, context: Any) -> None:
        """Draw the cameras of a context in all worlds, into its arrays."""
        with wp.ScopedDevice(self._device):
            mjw.render(self._model, self._data, context)

    # -- the model ---------------------------------------------------------------------------------

    def put_fields(self, fields: Mapping[str, NDArray[Any]]) -> bool:
        """Set model fields (N, ...) of all worlds.

        Returns:
            Whether poses of geoms that cannot move may have changed; see `put_poses_of_geoms`.

        Raises:
            ConfigError: If a field of physics cannot differ between worlds in Warp.
        """
        with wp.ScopedDevice(self._device):
            for name, values in fields.items():
                self._put(name, values)
        model = self._model
        for name in ("wind", "density", "viscosity"):
            if f"opt.{name}" in fields:
                model.has_fluid |= bool(fields[f"opt.{name}"].any())
        return not PLACES.isdisjoint(fields)

    def put_poses_of_geoms(self, positions: F64, matrices: F64) -> None:
        """Set the poses of all geoms, (N, ngeom, 3) and (N, ngeom, 9).

        Warp computes those of geoms that cannot move only once, with the compiled model.
        """
        for array, values in (
            (self._data.geom_xpos, positions),
            (self._data.geom_xmat, matrices),
        ):
            array.assign(_as_type(values, array))

    def _put(self, name: str, values: NDArray[Any]) -> None:
        owner: Any = self._model.opt if name.startswith("opt.") else self._model
        field = name.removeprefix("opt.")
        array = getattr(owner, field, None)
        if name in ("actuator_forcelimited", "actuator_forcerange"):
            return self._put_forces(name, values)
        if isinstance(array, wp.array) and _is_batched(owner, field):
            if name == "opt.tolerance":
                values = np.maximum(values, LEAST_TOLERANCE)
            shape = (self._count, *array.shape[1:])
            if array.shape == shape:
                array.assign(_as_type(values, array))
            else:
                of_worlds = wp.empty(shape, dtype=array.dtype)
                of_worlds.assign(_as_type(values, of_worlds))
                setattr(owner, field, of_worlds)
            return None
        # Of the derived fields that Warp does not have, some are longer in the model.
        if name in DERIVED_FIELDS or (values == compiled_field(self._compiled, name)).all():
            return None
        return self.require_unused(name)

    def require_unused(self, name: str) -> None:
        """Check that a field that cannot differ between worlds in Warp is not one of physics.

        Raises:
            ConfigError: If it is.
        """
        if name.startswith(_LOOKS):
            return
        raise ConfigError(
            [
                Problem(
                    "sim.engine",
                    f"the model field {name!r} cannot differ between environments in MuJoCo Warp: "
                    "use sim.engine=mujoco, or leave out what changes it",
                )
            ]
        )

    def own_field(self, name: str) -> torch.Tensor | None:
        """A model field of all worlds, (N, ...): a tensor that shares memory.

        The first call gives each world values of its own, in another array.

        Returns:
            None if it cannot differ between worlds in Warp, or is empty.
        """
        owner: Any = self._model.opt if name.startswith("opt.") else self._model
        field = name.removeprefix("opt.")
        array = getattr(owner, field, None)
        if not isinstance(array, wp.array) or not _is_batched(owner, field) or not array.size:
            return None
        if field not in self._own:
            shared = wp.to_torch(array)
            of_worlds = shared.expand(self._count, *shared.shape[1:]).clone()
            # Memory of torch, so that its stream orders what uses it.
            setattr(owner, field, wp.from_torch(of_worlds, array.dtype))
            self._own.add(field)
        return wp.to_torch(getattr(owner, field))

    def limit_forces(self, ranges: torch.Tensor) -> None:
        """Limit the forces of all actuators, (N, nu, 2)."""
        limits = self.own_field("actuator_forcerange")
        if limits is None:
            raise ValueError("the model has no actuators")
        limits.copy_(ranges)
        if not self._all_limited:
            self._all_limited = True
            wp.to_torch(self._model.actuator_forcelimited).fill_(True)

    def enable_fluid(self) -> None:
        """Compute forces of the medium from now on."""
        self._model.has_fluid = True

    def set_const(self) -> None:
        """Compute the constants of all worlds that depend on other fields of the model."""
        with wp.ScopedDevice(self._device):
            mjw.set_const(self._model, self._data)

    def _put_forces(self, name: str, values: NDArray[Any]) -> None:
        """Flags of limited actuators are shared by all worlds: the others get a wide range."""
        if name == "actuator_forcelimited":
            self._limited = np.asarray(values, np.bool_)
        else:
            self._ranges = np.asarray(values, np.float64)
        wide = np.array([-NO_LIMIT, NO_LIMIT])
        ranges = np.where(self._limited[..., None], self._ranges, wide).astype(np.float32)
        model = self._model
        flags = self._limited.any(axis=0)
        model.actuator_forcelimited = wp.array(flags, dtype=model.actuator_forcelimited.dtype)
        model.actuator_forcerange = wp.array(ranges, dtype=model.actuator_forcerange.dtype)


def measured_sizes(model: mujoco.MjModel, rows: F64) -> dict[str, int]:
    """Twice the memory that the worst of some states needs.

    Args:
        model: The compiled scene.
        rows: (n, nstate) integration-state rows.

    Returns:
        ``nconmax`` and ``njmax`` of `WarpWorlds`, for each world.
    """
    worlds = WarpWorlds(model, 1, "cpu", _MANY, _MANY)
    near = 0
    constraints = 0
    for row in rows:
        worlds.upload(row[None])
        worlds.positions()
        counts = worlds.counts()
        near = max(near, counts.contacts, counts.pairs)
        constraints = max(constraints, int(counts.rows.max()))
    return {"nconmax": max(2 * near, _FEW), "njmax": max(2 * constraints, _FEW)}


def _is_batched(owner: Any, field: str) -> bool:
    """Whether a field of Warp's model can have a value for each world."""
    spec = type(owner).__dataclass_fields__[field].type
    shape: tuple[Any, ...] = getattr(spec, "shape", ())
    return shape[:1] == ("*",)


def _as_type(values: NDArray[Any], array: Any) -> NDArray[Any]:
    """Values in the shape and the type of numbers of a Warp array, contiguous."""
    inner = getattr(array.dtype, "_shape_", ())  # of vectors and matrices
    dtype = wp.dtype_to_numpy(getattr(array.dtype, "_wp_scalar_type_", array.dtype))
    return np.ascontiguousarray(values, dtype).reshape(*array.shape, *inner)


def _say_where_kernels_are() -> None:
    """Log that kernels will be compiled, if this version of Warp has compiled none here."""
    folder = Path(str(wp.config.kernel_cache_dir))
    if not folder.exists() or not any(folder.iterdir()):
        _log.warning("MuJoCo Warp compiles its kernels into %s: minutes, the first time", folder)
