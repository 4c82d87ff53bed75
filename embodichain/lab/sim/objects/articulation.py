"""`Articulation`: handle over one jointed mechanism in N environments."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

from embodichain.lab.sim.objects._arrays import (
    Columns,
    as_rows,
    columns_of,
    names_matching,
    to_tensor,
)
from embodichain.lab.sim.objects.articulation_data import ArticulationData
from embodichain.lab.sim.objects.articulation_links import ArticulationLinks
from embodichain.lab.sim.objects.drives import ActuatorControls, Drives
from embodichain.lab.sim.objects.entity import BatchEntity
from embodichain.lab.sim.objects.joint_state import JointState
from embodichain.lab.sim.unavailable import not_available
from embodichain.utils.math import pose_to_matrix
from embodichain.utils.suggest import did_you_mean

if TYPE_CHECKING:
    from embodichain.lab.sim.cfg import ArticulationCfg
    from embodichain.lab.sim.compiler.articulation import ParsedArticulation
    from embodichain.lab.sim.compiler.index import EntityIndex
    from embodichain.lab.sim.engine.base import F64, Engine, EnvIndex
    from embodichain.lab.sim.host import Host

__all__ = ["Articulation"]

Ids = NDArray[np.int64]


class Articulation(BatchEntity):
    """One jointed mechanism in N environments: D one-degree joints in qpos order, L links.

    Ball joints are simulated, but no joint array has a column for them.

    Args:
        cfg: Its config (kept as given).
        parsed: Its file, read.
        host: The simulation.

    Attributes:
        parsed: Names, limits and initial values.
        drives: Gains and targets of the joints' drives.
        links: Poses, velocities and masses of the links.
    """

    cfg: ArticulationCfg

    def __init__(self, cfg: ArticulationCfg, parsed: ParsedArticulation, host: Host) -> None:
        super().__init__(cfg, parsed.uid, host)
        self.parsed = parsed
        self._state = JointState(self.binding, len(parsed.joint_names))
        self.drives = Drives(self.binding, parsed, self._state)
        self.links = ArticulationLinks(self.binding, parsed.link_names)
        self._controls = ActuatorControls(self.binding, self.drives)
        self._data = ArticulationData(
            self.binding, self._state, self.drives, self.links, self.get_local_pose
        )
        self._all = np.arange(len(parsed.joint_names))
        self._driven: Ids = self._all
        self._ctrl: Columns = slice(0)

    def bind(self, engine: Engine, index: EntityIndex) -> None:
        """Set the engine and the articulation's indices. Called once, by the simulation."""
        super().bind(engine, index)
        controls = np.asarray(index.ctrl_ids, np.int64)
        self._driven = self._all if (controls >= 0).all() else np.flatnonzero(controls >= 0)
        self._ctrl = columns_of(controls[self._driven])
        for part in (self._state, self._controls, self.drives):
            part.bind()

    def destroy(self) -> None:
        """Drop the engine and the model of the file; names and limits remain."""
        super().destroy()
        self.parsed = self.drives.parsed = self.parsed.without_model()

    @property
    def body_data(self) -> ArticulationData:
        """Reads of joints, root and links."""
        return self._data

    # -- names ---------------------------------------------------------------------------------

    @property
    def dof(self) -> int:
        """D."""
        return len(self.parsed.joint_names)

    @property
    def joint_names(self) -> list[str]:
        """Names of the D joints, in qpos order."""
        return list(self.parsed.joint_names)

    @property
    def all_joint_names(self) -> list[str]:
        """Same as `joint_names`: fixed joints are gone after parsing."""
        return self.joint_names

    @property
    def mimic_ids(self) -> list[int]:
        """Joints that follow another one."""
        return list(self.parsed.mimic_ids)

    @property
    def mimic_parents(self) -> list[int]:
        """The joint each of `mimic_ids` follows."""
        return list(self.parsed.mimic_parents)

    @property
    def mimic_multipliers(self) -> list[float]:
        """Slope of each mimic joint."""
        return list(self.parsed.mimic_multipliers)

    @property
    def mimic_offsets(self) -> list[float]:
        """Offset of each mimic joint, rad or m."""
        return list(self.parsed.mimic_offsets)

    @property
    def active_joint_ids(self) -> list[int]:
        """Joints that do not mimic another one."""
        return self.get_joint_ids(remove_mimic=True)

    @property
    def active_joint_names(self) -> list[str]:
        """Names of `active_joint_ids`."""
        return [self.parsed.joint_names[i] for i in self.active_joint_ids]

    @property
    def active_dof(self) -> int:
        """Number of `active_joint_ids`."""
        return len(self.active_joint_ids)

    @property
    def link_names(self) -> list[str]:
        """Names of the L links, parents before children."""
        return list(self.parsed.link_names)

    @property
    def root_link_name(self) -> str:
        """Name of the root link."""
        return self.parsed.root_link_name

    @property
    def actuator_names(self) -> list[str]:
        """Names of the M controls: the actuator's, with ``.INPUT`` where it has several."""
        return list(self.parsed.control_names)

    def find_joints(self, patterns: str | Sequence[str]) -> list[int]:
        """Indices of joints whose names a regex matches in full, in joint order.

        Raises:
            ValueError: If a pattern matches nothing; lists the joints.
        """
        return names_matching(patterns, self.parsed.joint_names, f"joint of {self.uid}")

    def find_links(self, patterns: str | Sequence[str]) -> list[int]:
        """Indices of links whose names a regex matches in full; see `find_joints`."""
        return names_matching(patterns, self.parsed.link_names, f"link of {self.uid}")

    def find_actuators(self, patterns: str | Sequence[str]) -> list[int]:
        """Indices of controls whose names a regex matches in full; see `find_joints`."""
        return names_matching(patterns, self.parsed.control_names, f"actuator of {self.uid}")

    def get_joint_ids(self, name: str | None = None, remove_mimic: bool = False) -> list[int]:
        """Joint indices of a control part, or of the whole articulation.

        Raises:
            ValueError: If there is no such part; lists the parts.
        """
        parts = self.parsed.control_parts
        if name is not None and name not in parts:
            raise ValueError(
                f"{self.uid} has no control part {name!r}; there are: "
                f"{', '.join(parts) or 'none'}.{did_you_mean(name, parts)}"
            )
        ids = range(self.dof) if name is None else parts[name]
        return [i for i in ids if not remove_mimic or i not in self.parsed.mimic_ids]

    def _indices(self, ids: Any, count: int, what: str) -> Ids:
        found = np.asarray(ids.tolist() if isinstance(ids, torch.Tensor) else ids, np.int64)
        found = found.reshape(-1)
        if ((found < 0) | (found >= count)).any():
            raise ValueError(f"{self.uid}: {what} must be in [0, {count}), got {found.tolist()}")
        return found

    def _joints(self, joint_ids: Any, name: str | None = None) -> Ids:
        if name is not None:
            return np.asarray(self.get_joint_ids(name), np.int64)
        return self._all if joint_ids is None else self._indices(joint_ids, self.dof, "joint_ids")

    # -- reads of joints: (N, D) float64, live views or copies, not to be written or kept ----------

    def read_qpos(self) -> F64:
        """(N, D) joint positions."""
        return self._state.qpos()

    def read_qvel(self) -> F64:
        """(N, D) joint velocities."""
        return self._state.qvel()

    def read_qf(self) -> F64:
        """(N, D) drive effort of the last physics step, without passive damping."""
        return self._state.qf()

    def read_efforts(self) -> F64:
        """(N, D) `read_qf`; efforts set by `set_qf` since the last physics step are read as set."""
        return self._state.efforts()

    # -- joints --------------------------------------------------------------------------------

    def get_qpos(self, name: str | None = None, target: bool = False) -> torch.Tensor:
        """Joint positions (N, k), or their drive targets."""
        values = self._data.target_qpos if target else self._data.qpos
        return values[:, self.get_joint_ids(name)]

    def get_qvel(self, name: str | None = None, target: bool = False) -> torch.Tensor:
        """Joint velocities (N, k), or their drive targets."""
        values = self._data.target_qvel if target else self._data.qvel
        return values[:, self.get_joint_ids(name)]

    def get_qf(self, name: str | None = None) -> torch.Tensor:
        """Joint efforts (N, k): what `set_qf` has set, until a physics step.

        After a step, and where nothing was set, they are what the drives gave in the last physics
        step; an effort that was set still acts then, but is not counted.
        """
        return self._data.qf[:, self.get_joint_ids(name)]

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
        joints = None if joint_ids is None and name is None else self._joints(joint_ids, name)
        width = self.dof if joints is None else len(joints)
        values = as_rows(qpos, rows, width, f"{self.uid}: qpos", shared=True)
        if target:
            self.write_target(values, joints, ids)
        else:
            self.write_qpos(values, joints, ids)

    def write_target(
        self, values: F64, joints: Ids | None = None, ids: EnvIndex | None = None
    ) -> None:
        """Set drive targets (n, k) from checked arrays; without ``joints`` of all with a drive."""
        self.entity  # noqa: B018  (compiles, which fills the columns)
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
        self, values: F64, joints: Ids | None = None, ids: EnvIndex | None = None
    ) -> None:
        """Set joint positions (n, k) from checked arrays, clamped to the limits."""
        joints = self._all if joints is None else joints
        columns = np.asarray(self.entity.qpos_adr, np.int64)[joints]
        clamped = self.drives.limits.clamp(values, joints, ids)
        self.engine.write("qpos", clamped, ids, columns_of(columns))

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
        values = as_rows(qf, rows, len(joints), f"{self.uid}: qf", shared=True)
        self._state.set_efforts(values, joints, ids)

    def get_qpos_limits(self, name: str | None = None) -> torch.Tensor:
        """(N, k, 2) lower and upper limits."""
        return self._data.qpos_limits[:, self._joints(None, name)]

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
        gains = {"stiffness": stiffness, "damping": damping, "max_effort": max_effort}
        others = {"max_velocity": max_velocity, "friction": friction, "armature": armature}
        self.drives.set(ids, rows, self._joints(joint_ids), **gains, **others)

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
        d, rows = self.drives, np.arange(self.num_instances) if ids is None else ids
        where = np.ix_(rows, self._joints(joint_ids))
        first = to_tensor(d.stiffness[where]), to_tensor(d.damping[where])
        limits = to_tensor(d.max_effort[where]), to_tensor(d.max_velocity[where])
        return *first, *limits, to_tensor(d.friction[where])

    # -- controls ------------------------------------------------------------------------------

    @property
    def ctrl_limits(self) -> torch.Tensor:
        """(M, 2) lower and upper controls, infinite where nothing limits them.

        MuJoCo clamps controls of the file's actuators, a drive its target to the joint's limits.
        """
        return to_tensor(self.parsed.ctrl_limits)

    def _picked(self, actuator_ids: Any, names: str | Sequence[str] | None) -> Ids:
        if names is not None:
            actuator_ids = self.find_actuators(names)
        count = len(self.parsed.control_names)
        if actuator_ids is None:
            return np.arange(count)
        return self._indices(actuator_ids, count, "actuator_ids")

    def get_ctrl(
        self, actuator_ids: Any = None, names: str | Sequence[str] | None = None
    ) -> torch.Tensor:
        """(N, k) controls, by index or by regex over `actuator_names`; all M without a choice."""
        return to_tensor(self.read_ctrl()[:, self._picked(actuator_ids, names)])

    def set_ctrl(
        self,
        ctrl: Any,
        actuator_ids: Any = None,
        env_ids: Any = None,
        names: str | Sequence[str] | None = None,
    ) -> None:
        """Set controls; they stay until they are overwritten or the environment is reset.

        Args:
            ctrl: (n, k) in the actuators' units, or (k,) for all n environments.
            actuator_ids: The k controls; None is all M.
            env_ids: The n environments; None is all N.
            names: Regexes over `actuator_names`, instead of ``actuator_ids``.

        Raises:
            ValueError: If a shape, an index or a value is wrong, or a regex matches nothing.
        """
        ids, rows = self._ids(env_ids)
        which = self._picked(actuator_ids, names)
        values = as_rows(ctrl, rows, len(which), f"{self.uid}: ctrl", shared=True)
        self.write_ctrl(values, which, ids)

    def read_ctrl(self) -> F64:
        """(N, M) controls: a live view or a copy; do not write or keep."""
        return self._controls.read()

    def write_ctrl(
        self, values: F64, which: Ids, ids: EnvIndex | None = None, seconds: float | None = None
    ) -> None:
        """Set controls (n, k) from checked arrays; see `ActuatorControls.write`."""
        self._controls.write(values, which, ids, seconds)

    # -- links ---------------------------------------------------------------------------------

    def body_of(self, link: str | None) -> int:
        """MuJoCo body id of a link; None is the root link. See `ArticulationLinks.body_of`."""
        return self.links.body_of(link)

    def get_link_pose(
        self, link_name: str, env_ids: Any = None, to_matrix: bool = False
    ) -> torch.Tensor:
        """Pose of a link in the environment's frame, (n, 7) or (n, 4, 4)."""
        body = self.body_of(link_name)
        ids, _ = self._ids(env_ids)
        pose = self.links.pose(body) if ids is None else self.links.pose(body)[ids]
        return to_tensor(pose_to_matrix(pose) if to_matrix else pose)

    def get_link_vel(self, link_name: str, env_ids: Any = None) -> torch.Tensor:
        """(n, 6) linear velocity of the link's origin, then angular velocity, world axes."""
        velocity, (ids, _) = self.links.velocity(self.body_of(link_name)), self._ids(env_ids)
        return to_tensor(velocity if ids is None else velocity[ids])

    def link_velocity(self, body: int) -> torch.Tensor:
        """(N, 6) `get_link_vel` of a MuJoCo body."""
        return to_tensor(self.links.velocity(body))

    def get_mass(self, link_names: Sequence[str] | None = None) -> torch.Tensor:
        """(N, k) link masses in kg."""
        return to_tensor(self.links.masses(self.links.bodies_of(link_names)))

    def set_mass(
        self, mass: Any, link_names: Sequence[str] | None = None, env_ids: Any = None
    ) -> None:
        """Set link masses (n, k) in kg; each link's inertia scales with its mass."""
        ids, rows = self._ids(env_ids)
        bodies = self.links.bodies_of(link_names)
        new = as_rows(mass, rows, len(bodies), f"{self.uid}: mass")
        if (new <= 0).any():
            raise ValueError(f"{self.uid}: masses must be positive, got {new.min()}")
        self.links.write_mass(new, bodies, ids)

    def write_mass(
        self, mass: F64, bodies: Ids, ids: EnvIndex | None, inertia: bool = True
    ) -> None:
        """Set masses from checked arrays; see `ArticulationLinks.write_mass`."""
        self.links.write_mass(mass, bodies, ids, inertia)

    def write_inertia(self, factor: F64, bodies: Ids, ids: EnvIndex | None) -> None:
        """Scale inertias by checked factors; see `ArticulationLinks.write_inertia`."""
        self.links.write_inertia(factor, bodies, ids)

    def clear_dynamics(self, env_ids: Any = None) -> None:
        """Stop all joints and the root, and remove applied efforts."""
        ids, _ = self._ids(env_ids)
        dofs = np.asarray(self.entity.dof_adr, np.int64)
        start = self.entity.free_qvel_adr
        if start >= 0:
            dofs = np.concatenate([np.arange(start, start + 6), dofs])
        for field in ("qvel", "qacc_warmstart", "qfrc_applied"):
            self.engine.write(field, 0.0, ids, dofs)

    def forget_targets(self, ids: EnvIndex | None) -> None:
        """Note that a reset has given environments (n,), or all, their initial row."""
        self.drives.clear(ids)
        self._state.forget_efforts(ids)

    set_fix_base = not_available("set_fix_base", "declare fix_base: it is compiled into the model")
    set_self_collision = not_available("set_self_collision", "declare disable_self_collision")
    set_link_physical_attr = not_available(
        "set_link_physical_attr", "declare attrs; set_mass works"
    )
