"""Fields of a batch: `row_layout` of state rows; `ModelFields`, that differ between environments.

`ModelFields` tracks which fields are expanded, in which environments derived constants are out of
date, and whether all environments are reset to the same row.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from mujoco import batch as mjbatch
from numpy.typing import NDArray

from embodichain.lab.sim.engine.api import EnvIndex
from embodichain.utils.suggest import did_you_mean

__all__ = ["DERIVED_FIELDS", "ModelFields", "compiled_field", "row_layout"]

_COMPONENTS = {
    "time": "TIME",
    "qpos": "QPOS",
    "qvel": "QVEL",
    "act": "ACT",
    "history": "HISTORY",
    "qacc_warmstart": "WARMSTART",
    "ctrl": "CTRL",
    "qfrc_applied": "QFRC_APPLIED",
    "xfrc_applied": "XFRC_APPLIED",
    "eq_active": "EQ_ACTIVE",
    "mocap_pos": "MOCAP_POS",
    "mocap_quat": "MOCAP_QUAT",
    "userdata": "USERDATA",
    "plugin_state": "PLUGIN",
    "plastic": "PLASTIC",
}


def row_layout(model: mujoco.MjModel) -> dict[str, slice]:
    """Return the columns of every state component within an integration-state row.

    The order of components is MuJoCo's: ascending bits of `mjtState` within `mjSTATE_INTEGRATION`.
    """
    bits = {
        int(getattr(mujoco.mjtState, f"mjSTATE_{suffix}")): name
        for name, suffix in _COMPONENTS.items()
        if hasattr(mujoco.mjtState, f"mjSTATE_{suffix}")
    }
    layout: dict[str, slice] = {}
    start = 0
    for position in range(32):
        bit = 1 << position
        if int(mujoco.mjtState.mjSTATE_INTEGRATION) & bit:
            size = mujoco.mj_stateSize(model, bit)
            layout[bits.get(bit, f"state_{position}")] = slice(start, start + size)
            start += size
    return layout


def compiled_field(model: mujoco.MjModel, name: str) -> NDArray[Any]:
    """The values of a model field: of `MjModel`, or ``opt.NAME``."""
    owner: Any = model
    for part in name.split("."):
        owner = getattr(owner, part)
    return np.asarray(owner)


# fmt: off
DERIVED_FIELDS = frozenset(
    {
        "body_treeid", "body_sameframe", "body_subtreemass", "body_invweight0", "body_margin",
        "body_contype", "body_conaffinity", "bvh_aabb", "jnt_actuatorid", "dof_invweight0",
        "dof_M0", "dof_length", "tree_bodyadr", "tree_bodynum", "tree_dofadr", "tree_dofnum",
        "geom_sameframe", "geom_aabb", "geom_rbound", "site_sameframe", "cam_poscom0",
        "cam_pos0", "cam_mat0", "light_poscom0", "light_pos0", "light_dir0", "flexedge_length0",
        "flexedge_invweight0", "efm0_dofid", "efm0_L_rownnz", "efm0_L_rowadr", "efm0_L_colind",
        "efm0_L", "efmC_perm", "flexedge_J_rownnz", "flexedge_J_rowadr", "flexedge_J_colind",
        "tendon_actuatorid", "tendon_treenum", "tendon_treeid", "ten_J_rownnz", "ten_J_rowadr",
        "ten_J_colind", "tendon_length0", "tendon_invweight0", "actuator_acc0",
        "actuator_length0", "eq_data", "geom_fluid", "tree_sleep_policy",
    }
)
# fmt: on
"""Fields that `mj_setConst` writes: `MJSETCONST_ARRAYS` of MuJoCo 4.0.0's `mjxmacro.h`."""
_RESET_FIELDS = frozenset(
    {"qpos0", "body_pos", "body_quat", "body_mocapid", "eq_active0", "opt.timestep"}
)
_RESET_WORDS = ("history", "delay", "plastic", "plugin", "sleep", "interval")
"""Parts of names of fields that `mj_resetData` reads, besides qpos0, poses of mocap bodies and
active constraints: initial buffers of delays, histories and plastic deformation."""


class ModelFields:
    """The expanded model fields of a batch, as flattened rows.

    Args:
        batch: The batch.
        num_envs: Its number of environments.

    Attributes:
        resets_alike: Whether every environment is still reset to the same row.
        stale: Whether constants are out of date in any environment.
    """

    def __init__(self, batch: mjbatch.Batch, num_envs: int) -> None:
        self._batch = batch
        self._num_envs = num_envs
        self._views: dict[str, NDArray[Any]] = {}
        self._internal: dict[str, NDArray[Any]] = {}
        self._compiled: dict[str, NDArray[Any]] = {}
        self._stale: NDArray[np.bool_] = np.zeros(num_envs, np.bool_)
        self.stale = False
        self.resets_alike = True

    @property
    def any(self) -> bool:
        """Whether environments may have different models."""
        return bool(self._views)

    def _expand(self, name: str) -> NDArray[Any]:
        return self._batch.expand(name).reshape(self._num_envs, -1)

    def view(self, name: str) -> NDArray[Any]:
        """(N, size) live values of a field.

        Raises:
            ValueError: If there is no such field; suggests the closest.
        """
        view = self._views.get(name)
        if view is None:
            if name not in mjbatch.MODEL_FIELDS:
                raise ValueError(
                    f"no model field {name!r} that can differ between environments."
                    f"{did_you_mean(name, mjbatch.MODEL_FIELDS)}"
                )
            view = self._expand(name)
            self._views[name] = view
            if name in _RESET_FIELDS or any(word in name for word in _RESET_WORDS):
                self.resets_alike = False
        return view

    def values(self, name: str) -> NDArray[Any]:
        """(N, ...) values of an expanded field, (1, ...) of another."""
        if name in mjbatch.MODEL_FIELDS:
            values: NDArray[Any] | None = self._batch.expanded(name)
            if values is not None:
                return values
        compiled = self._compiled.get(name)
        if compiled is None:
            compiled = compiled_field(self._batch.model, name)[None]
            if compiled.ndim > 1:  # a view of the model's memory, unlike a single number
                self._compiled[name] = compiled
        return compiled

    def internal(self, name: str) -> NDArray[Any]:
        """(N, size) live values of a field that the engine changes for one call of the batch.

        The field does not count as expanded.
        """
        view = self._internal.get(name)
        if view is None:
            view = self._expand(name)
            self._internal[name] = view
        return view

    def expanded(self) -> dict[str, NDArray[Any]]:
        """Name -> (N, ...) values of all expanded fields, derived ones included."""
        only_internal = self._internal.keys() - self._views.keys()
        fields: dict[str, NDArray[Any]] = {}
        for name in sorted(mjbatch.MODEL_FIELDS - only_internal):
            values = self._batch.expanded(name)
            if values is not None:
                fields[name] = values
        return fields

    def default(self, name: str) -> NDArray[Any]:
        """(size,) compiled values of a field, as many as `view` has."""
        # The batch keeps bounding volumes of bodies only, which precede those of meshes.
        return compiled_field(self._batch.model, name).reshape(-1)[: self.view(name).shape[1]]

    # -- derived constants -------------------------------------------------------------------------

    def mark(self, env_ids: EnvIndex | None) -> None:
        """Mark the constants of these environments as out of date."""
        self.stale = True
        self._stale[slice(None) if env_ids is None else env_ids] = True

    def take_stale(self) -> EnvIndex | None:
        """Return environments with constants out of date (None is all) and clear the marks."""
        ids = None if self._stale.all() else np.flatnonzero(self._stale)
        self._stale[:] = False
        self.stale = False
        return ids
