"""`Handle` of one entity or sensor in N environments; `BatchEntity`, a handle with a pose."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING, Any, Generic, Self, TypeVar, overload

import numpy as np

from embodichain.lab.sim.reads.body_motion import BodyMotion
from embodichain.lab.sim.reads.frames import BodyFrames, link_frame
from embodichain.utils.arrays import as_env_ids, as_rows, as_tensor, is_host, to_tensor
from embodichain.utils.math import matrix_to_pose, normalize_quat, pose_to_matrix
from embodichain.utils.short_repr import short_repr

if TYPE_CHECKING:
    import torch
    from numpy.typing import NDArray

    from embodichain.lab.sim.cfg import ObjectBaseCfg
    from embodichain.lab.sim.compiler.index import EntityIndex
    from embodichain.lab.sim.engine.api import Engine, EnvIndex
    from embodichain.lab.sim.objects.sim_context import SimContext
    from embodichain.utils.array_types import Floats

__all__ = ["BatchEntity", "Handle", "TensorRead", "TensorReads"]

Index = TypeVar("Index")


class Handle(Generic[Index]):
    """A named entity, light or sensor in N environments of a simulation.

    A handle has one set of methods, `read_...` and `write_...`, on arrays where the simulation has
    them (`Floats`), for environments that were checked (`EnvIndex`). What users call (`get_...`,
    `set_...`) is a thin layer over it: it checks shapes, environments and values, and takes and
    returns float32 tensors.

    Args:
        uid: Its name.
        host: The simulation.

    Attributes:
        sim: The simulation.
        num_instances: N.
        device: Device of the tensors that reads return.
    """

    def __init__(self, uid: str, host: SimContext) -> None:
        self.uid = uid
        self.sim = host
        self.num_instances = host.num_envs
        self.device = host.device

    def __repr__(self) -> str:
        """Return class, name, N and what it consists of, in one line."""
        return short_repr(self, self.uid, num_envs=self.num_instances, **self._repr_facts())

    def _repr_facts(self) -> dict[str, Any]:
        """Return what its `repr` says besides name and N; empty facts are left out."""
        return {}

    @property
    def host(self) -> SimContext:
        """The older name of `sim`."""
        return self.sim

    def bind(self, engine: Engine, index: Index) -> None:
        """Set the engine and the indices in the compiled model. Called once, by the simulation."""
        self.engine = engine
        self.index = index

    @cached_property
    def engine(self) -> Engine:
        """The engine; compiles the scene at first use.

        Raises:
            RuntimeError: If the simulation was destroyed.
        """
        return self.sim.engine

    @cached_property
    def index(self) -> Index:
        """Indices in the compiled model; compiles the scene at first use.

        Raises:
            RuntimeError: If the handle was removed from the scene, or the simulation destroyed.
        """
        self.sim.compile()  # calls `bind`
        if "index" not in self.__dict__:
            raise RuntimeError(f"{self.uid} was removed from the scene before it was compiled")
        return self.__dict__["index"]

    def destroy(self) -> None:
        """Drop the reference to the engine."""
        self.__dict__.pop("engine", None)

    def _checked(
        self, values: Any, width: int, env_ids: Any, what: str, **options: bool
    ) -> tuple[Floats, EnvIndex | None]:
        """Return values (n, width) and their n environments; options as in `as_rows`.

        Users' values are copied to the simulation's device.
        """
        arrays = self.sim.arrays
        if arrays.on_device and is_host(values):
            values = arrays.of(as_tensor(values).to(arrays.device))
        ids = as_env_ids(env_ids, self.num_instances)
        rows = self.num_instances if ids is None else len(ids)
        return as_rows(values, rows, width, f"{self.uid}: {what}", **options), ids

    def _rows(self, env_ids: Any) -> Any:
        """Numpy index of the rows of environments."""
        ids = as_env_ids(env_ids, self.num_instances)
        return slice(None) if ids is None else ids


class TensorRead:
    """An attribute of `TensorReads`: returns a new float32 tensor of what a handle reads."""

    def __init__(self, read: Callable[[Any], NDArray[Any]]) -> None:
        self._read = read

    @overload
    def __get__(self, instance: None, cls: type) -> Self: ...

    @overload
    def __get__(self, instance: TensorReads, cls: type) -> torch.Tensor: ...

    def __get__(self, instance: TensorReads | None, cls: type) -> Self | torch.Tensor:
        return self if instance is None else to_tensor(self._read(instance.owner))


class TensorReads:
    """Reads of a handle, each a `TensorRead`.

    Args:
        owner: The handle.
    """

    def __init__(self, owner: BatchEntity) -> None:
        self.owner = owner

    def __repr__(self) -> str:
        """Return class, name of the handle, N and the names of all reads, in one line."""
        reads = [name for name, read in vars(type(self)).items() if isinstance(read, TensorRead)]
        return short_repr(self, self.owner.uid, num_envs=self.owner.num_instances, reads=reads)


class BatchEntity(Handle["EntityIndex"]):
    """One entity in N environments.

    Args:
        cfg: Its config (not modified).
        uid: Its name in the scene.
        host: The simulation.
    """

    def __init__(self, cfg: ObjectBaseCfg, uid: str, host: SimContext) -> None:
        super().__init__(uid, host)
        self.cfg = cfg
        self._motions: dict[BodyFrames, BodyMotion] = {}

    def destroy(self) -> None:
        """Drop the references to the engine."""
        super().destroy()
        for motion in self._motions.values():
            motion.release()
        self._motions.clear()

    @property
    def entity(self) -> EntityIndex:
        """The older name of `index`."""
        return self.index

    def reset(self, env_ids: Any = None) -> None:
        """Reset the entity to its configured root pose, joints and targets, at zero velocity."""
        self.sim.reset_objects_state(env_ids, only=(self.uid,))

    @cached_property
    def row_columns(self) -> NDArray[np.int64]:
        """Sorted columns of the entity in the state row."""
        engine = self.engine
        index = self.index
        model = engine.model
        joints = np.flatnonzero(np.isin(model.jnt_bodyid, index.body_ids))  # ball and free as well
        dofs = np.flatnonzero(np.isin(model.dof_jntid, joints))
        ends = np.append(model.jnt_qposadr, model.nq)
        mocap = np.arange(index.mocap_id, index.mocap_id + 1) if index.mocap_id >= 0 else dofs[:0]
        columns = {
            "qpos": [np.arange(ends[joint], ends[joint + 1]) for joint in joints],
            **dict.fromkeys(("qvel", "qacc_warmstart", "qfrc_applied"), [dofs]),
            "act": [index.own_act_ids],
            "ctrl": [index.own_ctrl_ids],
            "xfrc_applied": [6 * body + np.arange(6) for body in index.body_ids],
            "mocap_pos": [3 * row + np.arange(3) for row in mocap],
            "mocap_quat": [4 * row + np.arange(4) for row in mocap],
        }
        parts = []
        for name, groups in columns.items():
            start = engine.component(name).start
            parts += [start + group for group in groups]
        return np.unique(np.concatenate(parts).astype(np.int64))

    # -- root pose -----------------------------------------------------------------------------

    def write_pose(
        self, pos: Floats, quat: Floats | None = None, env_ids: EnvIndex | None = None
    ) -> None:
        """Set the root position (n, 3) and, if given, orientation (n, 4) from checked arrays."""
        index = self.index
        if index.mocap_id >= 0:
            write = self.engine.write
            pos_field = "mocap_pos"
            pos_start = 3 * index.mocap_id
            quat_field = "mocap_quat"
            quat_start = 4 * index.mocap_id
        elif index.free_qpos_adr >= 0:
            write = self.engine.write
            pos_field = "qpos"
            pos_start = index.free_qpos_adr
            quat_field = "qpos"
            quat_start = index.free_qpos_adr + 3
        else:
            # Nothing moves it in physics: its pose is a part of the model.
            write = self.engine.write_model
            pos_field = "body_pos"
            pos_start = 3 * index.root_body_id
            quat_field = "body_quat"
            quat_start = 4 * index.root_body_id
        write(pos_field, pos, env_ids, slice(pos_start, pos_start + 3))
        if quat is not None:
            write(quat_field, quat, env_ids, slice(quat_start, quat_start + 4))

    def read_pose(self) -> tuple[Floats, Floats]:
        """Root position (N, 3) and wxyz orientation (N, 4): live views, do not write or store."""
        root = self.motion(self.index.root_body_id)
        return root.position(), root.orientation()

    def motion(self, body: int) -> BodyMotion:
        """Motion of a body of the entity, by MuJoCo's id; one shared object per body."""
        return self.motion_of(link_frame(body))

    def motion_of(self, frame: BodyFrames) -> BodyMotion:
        """Motion of one frame of the entity; one shared object per frame."""
        motion = self._motions.get(frame)
        if motion is None:
            motion = BodyMotion(self.engine, self.index, frame)
            self._motions[frame] = motion
        return motion

    # -- for users: tensors in and out, checked; see `Handle` ----------------------------------

    def get_local_pose(self, to_matrix: bool = False) -> torch.Tensor:
        """Root pose in the environment's frame: (N, 7) x, y, z, qw, qx, qy, qz, or (N, 4, 4)."""
        pose = np.concatenate(self.read_pose(), axis=1)
        return to_tensor(pose_to_matrix(pose) if to_matrix else pose)

    def set_local_pose(self, pose: Any, env_ids: Any = None) -> None:
        """Set the root pose in the environment's frame.

        Args:
            pose: (n, 7) x, y, z, qw, qx, qy, qz, or (n, 4, 4). Quaternions are normalized.
            env_ids: The n environments (sorted unique, or a mask); None is all N.

        Raises:
            ValueError: If the shape does not match ``env_ids`` or a value is not finite.
        """
        array, ids = self._pose_rows(pose, env_ids, "pose")
        self.write_pose(array[:, :3], array[:, 3:], ids)

    def _pose_rows(self, pose: Any, env_ids: Any, what: str) -> tuple[Floats, EnvIndex | None]:
        """Return (n, 7) float64 with unit quaternions from (n, 7) or (n, 4, 4)."""
        ids = as_env_ids(env_ids, self.num_instances)
        shape = tuple(np.shape(pose))
        if len(shape) == 3 and shape[1:] == (4, 4):
            flat, _ = self._checked(pose.reshape(shape[0], 16), 16, ids, what)
            return matrix_to_pose(flat.reshape(-1, 4, 4)), ids
        if len(shape) != 2 or shape[1] != 7:
            count = self.num_instances if ids is None else len(ids)
            raise ValueError(
                f"{self.uid}: {what} must have shape ({count}, 7) (x, y, z, qw, qx, qy, qz) or "
                f"({count}, 4, 4), got {shape}"
            )
        array = self._checked(pose, 7, ids, what)[0].copy()
        array[:, 3:] = normalize_quat(array[:, 3:])
        return array, ids
