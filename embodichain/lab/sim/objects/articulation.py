"""`Articulation`: handle over one jointed mechanism in N environments."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

from embodichain.lab.sim.objects._arrays import (
    Columns,
    as_rows,
    columns_of,
    stacked_view,
    to_tensor,
)
from embodichain.lab.sim.objects.actuators import ActuatedJoints
from embodichain.lab.sim.objects.articulation_data import ArticulationData
from embodichain.lab.sim.objects.drives import Drives
from embodichain.lab.sim.objects.entity import not_available
from embodichain.lab.sim.objects.link_masses import LinkMasses
from embodichain.lab.sim.objects.set_efforts import SetEfforts
from embodichain.utils.math import cross, pose_to_matrix

if TYPE_CHECKING:
    from embodichain.lab.sim.cfg import ArticulationCfg
    from embodichain.lab.sim.compiler import EntityIndex, ParsedArticulation
    from embodichain.lab.sim.engine.base import F64, Engine, EnvIndex
    from embodichain.lab.sim.sim_manager import SimulationManager

__all__ = ["Articulation"]


class Articulation(LinkMasses, ActuatedJoints):
    """One jointed mechanism in N environments: D one-degree joints in qpos order, L links.

    Ball joints are simulated but stand in none of the joint arrays.
    """

    cfg: ArticulationCfg

    def __init__(
        self, cfg: ArticulationCfg, parsed: ParsedArticulation, sim: SimulationManager
    ) -> None:
        super().__init__(cfg, parsed, sim)
        self.drives = Drives(self)
        self._data = ArticulationData(self)
        self._qpos: Columns = slice(0)
        self.dofs: Columns = slice(0)
        self._all = np.arange(len(parsed.joint_names))
        self._driven: NDArray[np.int64] = self._all
        self._ctrl: Columns = slice(0)
        self._moving: F64 | None = None
        self.set_efforts = SetEfforts(len(parsed.joint_names))

    def bind(self, engine: Engine, index: EntityIndex) -> None:
        """Learn where the compiled model keeps this articulation."""
        super().bind(engine, index)
        self._qpos, self.dofs = columns_of(index.qpos_adr), columns_of(index.dof_adr)
        controls = np.asarray(index.ctrl_ids, np.int64)
        self._driven = self._all if (controls >= 0).all() else np.flatnonzero(controls >= 0)
        self._ctrl = columns_of(controls[self._driven])
        # qf is a field of the acceleration stage: ask for it before the first step. Whoever asks
        # first has it computed, which may move what was read before.
        engine.acceleration("qfrc_actuator")
        self.drives.bind()
        self._moving = stacked_view(self.read_qpos(), self.read_qvel())

    def destroy(self) -> None:
        """Drop the handle's hold on the engine, and on its rows."""
        super().destroy()
        self._moving = None

    @property
    def body_data(self) -> ArticulationData:
        """Reads of joints, root and links."""
        return self._data

    # -- numpy doors (float64, all environments) ---------------------------------------------------

    def read_qpos(self) -> F64:
        """(N, D) joint positions: a live view or a copy; do not write or keep."""
        engine = self.engine
        return engine.state("qpos")[:, self._qpos]

    def read_qvel(self) -> F64:
        """(N, D) joint velocities: a live view or a copy; do not write or keep."""
        engine = self.engine
        return engine.state("qvel")[:, self.dofs]

    def read_qf(self) -> F64:
        """(N, D) drive effort of the last physics step; passive damping is not in it."""
        return self.engine.acceleration_now("qfrc_actuator")[:, self.dofs]

    def read_efforts(self) -> F64:
        """(N, D) `read_qf`; what `set_qf` has set since the last physics step is read as it was."""
        efforts = self.read_qf()
        if not self.set_efforts:
            return efforts
        applied = self.engine.state("qfrc_applied")[:, self.dofs]
        return self.set_efforts.over(efforts, applied, self._time())

    def _time(self) -> F64:
        return self.engine.state("time").reshape(-1)

    def proprioception(
        self, joint_ids: Columns | None = None
    ) -> tuple[tuple[torch.Tensor, ...], NDArray[np.float32]]:
        """(qpos, qvel, qf), each (N, k) float32, and (3, N, k) that they are views of."""
        motion, qf = self._motion(), self.read_efforts()
        if joint_ids is not None:
            motion, qf = motion[:, :, joint_ids], qf[:, joint_ids]
        out = np.empty((3, *qf.shape), np.float32)
        out[:2], out[2] = motion, qf
        return tuple(map(torch.from_numpy, out)), out

    def _motion(self) -> F64:
        """(2, N, D) joint positions and velocities: a live view or a copy; do not write or keep."""
        if self._moving is None:
            return np.stack([self.read_qpos(), self.read_qvel()])
        return self._moving

    def link_velocity(self, body: int) -> torch.Tensor:
        """(N, 6) linear velocity of a body's origin, then angular velocity, world axes.

        MuJoCo's `cvel` is (angular, linear) at the centre of mass of the kinematic tree; moved to
        the origin by v = v_com + w x (origin - com).
        """
        engine = self.engine
        cvel = engine.derived("cvel")[:, body]
        com = engine.derived("subtree_com")[:, int(engine.model.body_rootid[body])]
        arm = engine.derived("xpos")[:, body] - com
        angular = cvel[:, :3]
        return to_tensor(np.concatenate([cvel[:, 3:] + cross(angular, arm), angular], axis=1))

    # -- joints --------------------------------------------------------------------------------

    def _joints(self, joint_ids: Any, name: str | None = None) -> NDArray[np.int64] | None:
        if name is not None:
            return np.asarray(self.get_joint_ids(name), np.int64)
        if joint_ids is None:
            return None
        if isinstance(joint_ids, torch.Tensor):
            joint_ids = joint_ids.tolist()
        ids = np.asarray(joint_ids, np.int64).reshape(-1)
        if ((ids < 0) | (ids >= self.dof)).any():
            raise ValueError(
                f"{self.uid}: joint_ids must be in [0, {self.dof}), got {ids.tolist()}"
            )
        return ids

    def get_qpos(self, name: str | None = None, target: bool = False) -> torch.Tensor:
        """Joint positions (N, k), or their drive targets."""
        values = self._data.target_qpos if target else self._data.qpos
        return values if name is None else values[:, self.get_joint_ids(name)]

    def get_qvel(self, name: str | None = None, target: bool = False) -> torch.Tensor:
        """Joint velocities (N, k), or their drive targets."""
        values = self._data.target_qvel if target else self._data.qvel
        return values if name is None else values[:, self.get_joint_ids(name)]

    def get_qf(self, name: str | None = None) -> torch.Tensor:
        """Joint efforts (N, k): what `set_qf` has set, until a physics step.

        After a step, and where nothing was set, they are what the drives gave in the last physics
        step; an effort that was set still acts then, but is not counted.
        """
        values = self._data.qf
        return values if name is None else values[:, self.get_joint_ids(name)]

    def set_qpos(
        self,
        qpos: Any,
        joint_ids: Any = None,
        env_ids: Any = None,
        target: bool = True,
        name: str | None = None,
    ) -> None:
        """Set drive targets, or teleport the joints. Both are clamped to the joints' limits.

        Args:
            qpos: (n, k) rad or m, or (k,) for all n environments.
            joint_ids: The k joints; None is all of them (with ``target``, all that have a drive).
            env_ids: The n environments; None is all N.
            target: True sets the PD drives' targets, False the positions themselves.
            name: A control part, instead of ``joint_ids``.

        Raises:
            ValueError: If a shape, an index or a value is wrong, or a joint has no drive.
        """
        ids, rows = self._ids(env_ids)
        joints = self._joints(joint_ids, name)
        width = self.dof if joints is None else len(joints)
        values = as_rows(qpos, rows, width, f"{self.uid}: qpos", shared=True)
        if target:
            self.write_target(values, joints, ids)
        else:
            self.write_qpos(values, joints, ids)

    def write_target(
        self, values: F64, joints: NDArray[np.int64] | None = None, ids: EnvIndex | None = None
    ) -> None:
        """Set drive targets (n, k) from checked arrays: the door for action terms."""
        if self._bound is None:
            self._sim.compile()
        if joints is None:
            joints, columns = self._driven, self._ctrl
            if joints is not self._all:
                if not len(joints):
                    self.drives.columns(self._all)
                values = values[:, joints]
        else:
            columns = columns_of(self.drives.columns(joints))
        self.drives.write_target_qpos(values, joints, columns, ids)

    def write_qpos(
        self, values: F64, joints: NDArray[np.int64] | None = None, ids: EnvIndex | None = None
    ) -> None:
        """Set joint positions (n, k) from checked arrays, clamped to the limits."""
        if self._bound is None:
            self._sim.compile()
        columns = self._qpos
        if joints is not None:
            columns = np.asarray(self.entity.qpos_adr, np.int64)[joints]
        low, high = self.drives.limits.of(self._all if joints is None else joints, ids)
        clamped = np.minimum(np.maximum(values, low), high)
        self.engine.write("qpos", clamped, ids, columns)

    def set_qvel(
        self,
        qvel: Any,
        joint_ids: Any = None,
        env_ids: Any = None,
        target: bool = True,
        name: str | None = None,
    ) -> None:
        """Set drive velocity targets, or the velocities themselves; arguments as `set_qpos`."""
        ids, rows = self._ids(env_ids)
        joints = self._joints(joint_ids, name)
        joints = self._all if joints is None else joints
        values = as_rows(qvel, rows, len(joints), f"{self.uid}: qvel", shared=True)
        if target:
            self.drives.write_target_qvel(values, joints, ids)
        else:
            dofs = np.asarray(self.entity.dof_adr, np.int64)[joints]
            self.engine.write("qvel", values, ids, dofs)

    def set_qf(
        self, qf: Any, joint_ids: Any = None, env_ids: Any = None, name: str | None = None
    ) -> None:
        """Apply joint efforts (n, k) in N m or N beside the drives, until overwritten or reset.

        `get_qf` reads them back until the next physics step.
        """
        ids, rows = self._ids(env_ids)
        joints = self._joints(joint_ids, name)
        joints = self._all if joints is None else joints
        values = as_rows(qf, rows, len(joints), f"{self.uid}: qf", shared=True)
        dofs = np.asarray(self.entity.dof_adr, np.int64)[joints]
        self.engine.write("qfrc_applied", values, ids, dofs)
        self.set_efforts.mark(self._time(), joints, ids)

    def get_qpos_limits(self, name: str | None = None) -> torch.Tensor:
        """(N, k, 2) lower and upper limits."""
        values = self._data.qpos_limits
        return values if name is None else values[:, self.get_joint_ids(name)]

    def set_joint_drive(
        self,
        stiffness: Any = None,
        damping: Any = None,
        max_effort: Any = None,
        max_velocity: Any = None,
        friction: Any = None,
        armature: Any = None,
        joint_ids: Any = None,
        env_ids: Any = None,
    ) -> None:
        """Set gains per environment; each value has shape (n, k), None leaves it.

        Raises:
            ValueError: If a shape is wrong, a value is negative or a joint has no drive.
        """
        ids, rows = self._ids(env_ids)
        joints = self._joints(joint_ids)
        self.drives.set(
            ids,
            rows,
            self._all if joints is None else joints,
            stiffness=stiffness,
            damping=damping,
            max_effort=max_effort,
            max_velocity=max_velocity,
            friction=friction,
            armature=armature,
        )

    def get_joint_drive(
        self, joint_ids: Any = None, env_ids: Any = None
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
        """Stiffness, damping, max_effort, max_velocity and friction, each (n, k).

        The armature is `body_data.joint_armature`.

        Args:
            joint_ids: The k joints; None is all of them.
            env_ids: The n environments; None is all N.
        """
        ids, _ = self._ids(env_ids)
        joints = self._joints(joint_ids)
        d, rows = self.drives, np.arange(self.num_instances) if ids is None else ids
        where = np.ix_(rows, self._all if joints is None else joints)
        first = to_tensor(d.stiffness[where]), to_tensor(d.damping[where])
        limits = to_tensor(d.max_effort[where]), to_tensor(d.max_velocity[where])
        return *first, *limits, to_tensor(d.friction[where])

    # -- links ---------------------------------------------------------------------------------

    def get_link_pose(
        self, link_name: str, env_ids: Any = None, to_matrix: bool = False
    ) -> torch.Tensor:
        """Pose of a link in the environment's frame, (n, 7) or (n, 4, 4)."""
        body = self.body_of(link_name)
        ids, rows = self._ids(env_ids)
        pos, quat = self.engine.derived("xpos")[:, body], self.engine.derived("xquat")[:, body]
        out = np.empty((rows, 7), np.float32)
        out[:, :3] = pos if ids is None else pos[ids]
        out[:, 3:] = quat if ids is None else quat[ids]
        pose = torch.from_numpy(out)
        return pose_to_matrix(pose) if to_matrix else pose

    def get_link_vel(self, link_name: str, env_ids: Any = None) -> torch.Tensor:
        """(n, 6) linear velocity of the link's origin, then angular velocity, world axes."""
        ids, _ = self._ids(env_ids)
        velocity = self.link_velocity(self.body_of(link_name))
        return velocity if ids is None else velocity[torch.from_numpy(ids)]

    def clear_dynamics(self, env_ids: Any = None) -> None:
        """Stop all joints and the root, and remove applied efforts."""
        ids, _ = self._ids(env_ids)
        dofs = np.asarray(self.entity.dof_adr, np.int64)
        start = self.entity.free_qvel_adr
        if start >= 0:
            dofs = np.concatenate([np.arange(start, start + 6), dofs])
        for field in ("qvel", "qacc_warmstart", "qfrc_applied"):
            self.engine.write(field, 0.0, ids, dofs)

    def reset(self, env_ids: Any = None) -> None:
        """Give root and joints their configured state, drives their targets, no velocity."""
        self._sim.reset_objects_state(env_ids, only=(self.uid,))

    set_fix_base = not_available("set_fix_base", "declare fix_base: it is compiled into the model")
    set_self_collision = not_available("set_self_collision", "declare disable_self_collision")
    set_link_physical_attr = not_available(
        "set_link_physical_attr", "declare attrs; set_mass works"
    )
