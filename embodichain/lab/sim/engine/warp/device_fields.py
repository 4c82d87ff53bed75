"""`DeviceFields`: model fields that differ between environments, in Warp's memory on its device.

Importing this module imports Warp (extra ``gpu``).
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import torch
from numpy.typing import NDArray

from embodichain.lab.sim.engine.api import F64, Columns
from embodichain.lab.sim.engine.cpu.cpu_engine import entries
from embodichain.lab.sim.engine.device.device_array import DeviceArray, on_device
from embodichain.lab.sim.engine.fields import DERIVED_FIELDS, ModelFields, compiled_field
from embodichain.lab.sim.engine.warp.warp_worlds import (
    LEAST_TOLERANCE,
    NO_LIMIT,
    PLACES,
    WarpWorlds,
)
from embodichain.utils.math import quat_multiply, quat_rotate, quat_to_matrix

__all__ = ["DeviceFields"]

_CONSTANTS = (
    "body_subtreemass", "geom_aabb", "geom_rbound", "tendon_length0", "eq_data", "cam_pos0",
    "cam_poscom0", "cam_mat0", "light_pos0", "light_poscom0", "light_dir0", "dof_invweight0",
    "body_invweight0", "tendon_invweight0", "actuator_acc0",
)  # fmt: skip
"""What `mujoco_warp.set_const` writes. Of a field that all worlds share it would write the values
of any one of them."""
_FORCES = ("actuator_forcelimited", "actuator_forcerange")


class DeviceFields:
    """Model fields of N worlds.

    A field gets values for each world when it is first written or viewed.

    Args:
        worlds: The worlds on the device.
        host: The fields of the batch on the host; expanded as those here are, but not written.
        model: The compiled scene.
        count: N.
        device: The device of the tensors.

    Attributes:
        moved: Whether `place_geoms` has something to do.
        has_constants: Whether constants were computed that may differ between worlds.
        revision: Increases when fields get values for each world: Warp's arrays are replaced.
    """

    def __init__(
        self,
        worlds: WarpWorlds,
        host: ModelFields,
        model: mujoco.MjModel,
        count: int,
        device: torch.device,
    ) -> None:
        self._worlds = worlds
        self._host = host
        self._model = model
        self._count = count
        self._device = device
        self._views: dict[str, DeviceArray] = {}
        self._unlimited = torch.tensor([-NO_LIMIT, NO_LIMIT], device=device)
        is_welded = model.body_weldid[model.geom_bodyid] == 0
        self._fixed_geoms: NDArray[np.int64] = np.flatnonzero(is_welded)
        self.moved = False
        self.has_constants = False
        self.revision = 0

    def view(self, name: str) -> DeviceArray:
        """(N, size) values of a field.

        Raises:
            ValueError: If there is no such field; suggests the closest.
            ConfigError: If it cannot differ between worlds in Warp.
        """
        view = self._views.get(name)
        if view is None:
            self._host.view(name)  # raises, and expands the field there
            view = DeviceArray(self._make_field(name).view(self._count, -1))
            self._views[name] = view
            self.revision += 1
        return view

    def _make_field(self, name: str) -> torch.Tensor:
        """Values of a field for each world: Warp's, or others where physics does not read them."""
        if name not in _FORCES:  # physics reads what `_put_forces` makes of these
            tensor = self._worlds.own_field(name)
            if tensor is not None:
                return tensor
            self._worlds.require_unused(name)
        default = self._host.default(name)
        return on_device(default, self._device).tensor.repeat(self._count, 1)

    @property
    def written_names(self) -> list[str]:
        """Names of the fields that were written or viewed."""
        return list(self._views)

    def written(self, name: str) -> DeviceArray | None:
        """(N, size) values of a field that was written or viewed; None of another."""
        return self._views.get(name)

    def values(self, name: str) -> Any:
        """(N, ...) values of a field that may differ, (1, ...) on the host of another."""
        compiled = compiled_field(self._model, name)
        if name not in self._views and not (self.has_constants and name in _CONSTANTS):
            return compiled[None]
        return self.view(name).reshape(self._count, *compiled.shape)

    def write(self, name: str, values: Any, env_ids: Any, columns: Columns) -> None:
        """Set columns of a field; arguments as of `Engine.write_model`."""
        if name in DERIVED_FIELDS and self._worlds.own_field(name) is None:
            return
        if isinstance(values, np.ndarray) and values.ndim:
            if name not in self._views and (values == self._host.default(name)[columns]).all():
                return  # as compiled
            values = on_device(values, self._device)
        if isinstance(env_ids, np.ndarray):
            env_ids = on_device(env_ids, self._device)
        view = self.view(name)
        view[entries(env_ids, columns)] = values
        if name in _FORCES:
            self._put_forces()
        elif name == "opt.tolerance":
            view.tensor.clamp_(min=LEAST_TOLERANCE)
        elif name in ("opt.wind", "opt.density", "opt.viscosity"):
            self._worlds.enable_fluid()
        self.moved |= name in PLACES

    def _put_forces(self) -> None:
        """Flags of limited actuators are shared by all worlds: the others get a wide range."""
        limited, ranges = (self.view(name).tensor for name in _FORCES)
        shape = (*limited.shape, 2)
        is_limited = limited[..., None] != 0
        ranges = torch.where(is_limited, ranges.view(shape), self._unlimited.expand(shape))
        self._worlds.limit_forces(ranges)

    def set_const(self) -> None:
        """Compute the constants that depend on other fields, of all worlds."""
        if not self.has_constants:
            self.has_constants = True
            self.revision += 1
            for name in _CONSTANTS:
                self._worlds.own_field(name)
        self._worlds.set_const()

    def place_geoms(self, positions: Any, matrices: Any, bodies: tuple[Any, Any]) -> None:
        """Set the poses of geoms that cannot move if what they depend on was written.

        Warp computes them only once, with the compiled model.

        Args:
            positions: (N, ngeom, 3) of all geoms, written.
            matrices: (N, ngeom, 3, 3) likewise.
            bodies: (N, nbody, 3) positions and (N, nbody, 4) orientations of bodies.
        """
        self.moved = False
        geoms = self._fixed_geoms
        owner = self._model.geom_bodyid[geoms].astype(np.int64)
        body_positions, body_quats = bodies
        body_pos = body_positions[:, owner]
        body_quat = body_quats[:, owner]
        geom_pos: Any = self.view("geom_pos").reshape(self._count, -1, 3)[:, geoms]
        geom_quat: Any = self.view("geom_quat").reshape(self._count, -1, 4)[:, geoms]
        positions[:, geoms] = body_pos + quat_rotate(body_quat, geom_pos)
        matrices[:, geoms] = quat_to_matrix(quat_multiply(body_quat, geom_quat))

    def host(self) -> dict[str, F64]:
        """Copy the fields to the host, (N, size) each; waits for the device."""
        return {
            name: values.host()
            for name, values in self._views.items()
            if name not in DERIVED_FIELDS
        }
