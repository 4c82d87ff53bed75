"""`BatchEntity`: what every handle has - a uid, a config, one simulated thing in N environments."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from embodichain.lab.sim.body_motion import BodyMotion
from embodichain.lab.sim.host import Handle, Host
from embodichain.lab.sim.objects._arrays import as_env_ids, as_rows, to_tensor
from embodichain.utils.math import matrix_to_pose, normalize_quat, pose_to_matrix

if TYPE_CHECKING:
    from embodichain.lab.sim.cfg import ObjectBaseCfg
    from embodichain.lab.sim.compiler.index import EntityIndex
    from embodichain.lab.sim.engine.base import F64, EnvIndex

__all__ = ["BatchEntity"]


class BatchEntity(Handle["EntityIndex"]):
    """One entity in N environments.

    Args:
        cfg: Its config (kept as given).
        uid: Its name in the scene.
        host: The simulation.
    """

    def __init__(self, cfg: ObjectBaseCfg, uid: str, host: Host) -> None:
        super().__init__(uid, host)
        self.cfg = cfg
        self._motions: dict[int, BodyMotion] = {}

    @property
    def entity(self) -> EntityIndex:
        """The entity's indices in the compiled model; compiles the scene at first use."""
        return self.binding.index

    def reset(self, env_ids: Any = None) -> None:
        """Give the entity its configured state: root, joints and drive targets, no velocity."""
        self.binding.host.reset_objects_state(env_ids, only=(self.uid,))

    # -- root pose -----------------------------------------------------------------------------

    def _ids(self, env_ids: Any) -> tuple[EnvIndex | None, int]:
        ids = as_env_ids(env_ids, self.num_instances)
        return ids, self.num_instances if ids is None else len(ids)

    def _pose_rows(self, pose: Any, rows: int) -> F64:
        """Return (rows, 7) float64 with unit quaternions from (rows, 7) or (rows, 4, 4)."""
        shape = tuple(np.shape(pose))
        if len(shape) == 3 and shape[1:] == (4, 4):
            flat = pose.reshape(shape[0], 16)
            matrix = as_rows(flat, rows, 16, f"{self.uid}: pose").reshape(rows, 4, 4)
            return matrix_to_pose(matrix)
        if len(shape) != 2 or shape[1] != 7:
            raise ValueError(
                f"{self.uid}: pose must have shape ({rows}, 7) (x, y, z, qw, qx, qy, qz) or "
                f"({rows}, 4, 4), got {shape}"
            )
        array = as_rows(pose, rows, 7, f"{self.uid}: pose").copy()
        array[:, 3:] = normalize_quat(array[:, 3:])
        return array

    def write_pose(
        self, pos: F64, quat: F64 | None = None, env_ids: EnvIndex | None = None
    ) -> None:
        """Set the root pose from checked numpy arrays.

        Args:
            pos: (n, 3) metres in the environment's frame.
            quat: (n, 4) unit wxyz, or None to leave the orientation.
            env_ids: (n,) sorted unique int64, or None for all.
        """
        engine, index = self.engine, self.entity
        if index.mocap_id >= 0:
            start = 3 * index.mocap_id
            engine.write("mocap_pos", pos, env_ids, slice(start, start + 3))
            if quat is not None:
                start = 4 * index.mocap_id
                engine.write("mocap_quat", quat, env_ids, slice(start, start + 4))
            return
        start = index.free_qpos_adr
        if start >= 0:
            engine.write("qpos", pos, env_ids, slice(start, start + 3))
            if quat is not None:
                engine.write("qpos", quat, env_ids, slice(start + 3, start + 7))
            return
        start = index.root_body_id
        engine.write_model("body_pos", pos, env_ids, slice(3 * start, 3 * start + 3))
        if quat is not None:
            engine.write_model("body_quat", quat, env_ids, slice(4 * start, 4 * start + 4))

    def read_pose(self) -> tuple[F64, F64]:
        """Root position (N, 3) and wxyz orientation (N, 4): live views, do not write or keep."""
        root = self.motion(self.entity.root_body_id)
        return root.position(), root.orientation()

    def motion(self, body: int) -> BodyMotion:
        """Motion of a body of the entity, by MuJoCo's id: one object for all who read it."""
        found = self._motions.get(body)
        if found is None:
            found = self._motions[body] = BodyMotion(self.engine, self.entity, body)
        return found

    def get_local_pose(self, to_matrix: bool = False) -> torch.Tensor:
        """Return the root pose in the environment's own frame, float32.

        Args:
            to_matrix: Whether to return (N, 4, 4) matrices instead of (N, 7) vectors
                (x, y, z, qw, qx, qy, qz).
        """
        pose = np.concatenate(self.read_pose(), axis=1)
        return to_tensor(pose_to_matrix(pose) if to_matrix else pose)

    def set_local_pose(self, pose: Any, env_ids: Any = None) -> None:
        """Set the root pose in the environment's own frame.

        Args:
            pose: (n, 7) x, y, z, qw, qx, qy, qz, or (n, 4, 4). Quaternions are normalized.
            env_ids: The n environments (sorted unique, or a mask); None is all N.

        Raises:
            ValueError: If the shape does not match ``env_ids`` or a value is not finite.
        """
        ids, rows = self._ids(env_ids)
        array = self._pose_rows(pose, rows)
        self.write_pose(array[:, :3], array[:, 3:], ids)
