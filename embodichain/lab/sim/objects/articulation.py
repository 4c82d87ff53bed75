"""`Articulation`: handle of one jointed mechanism in N environments."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

from embodichain.lab.sim.compiler.names import match
from embodichain.lab.sim.objects.articulation_data import ArticulationData
from embodichain.lab.sim.objects.drives import GAINS, Drives
from embodichain.lab.sim.objects.frame_reads import FrameReads
from embodichain.utils.arrays import as_env_ids, columns_of, to_tensor
from embodichain.utils.plugins import with_missing_members
from embodichain.utils.suggest import did_you_mean

if TYPE_CHECKING:
    from embodichain.lab.sim.cfg import ArticulationCfg
    from embodichain.lab.sim.compiler.index import EntityIndex
    from embodichain.lab.sim.compiler.robot.parsed_articulation import ParsedArticulation
    from embodichain.lab.sim.engine.api import Columns, Engine, EnvIndex
    from embodichain.lab.sim.objects.sim_context import SimContext
    from embodichain.utils.array_types import Floats

__all__ = ["Articulation"]

Ids = NDArray[np.int64]


@with_missing_members
class Articulation(FrameReads):
    """One jointed mechanism in N environments: D one-degree joints in qpos order, L links.

    Ball joints are simulated, but have no columns in joint arrays.

    Args:
        cfg: Its config (not modified).
        parsed: Its file and config, parsed.
        host: The simulation.

    Attributes:
        parsed: Names, limits and initial values.
        drives: Gains and targets of the joints' drives.
        body_data: Reads of joints, root and links.
        dof: D.
        joint_names: (D,) in qpos order.
        all_joint_names: Same as `joint_names`: parsing removes fixed joints.
        mimic_ids, mimic_parents: Joints that follow another one, and the joints they follow.
        mimic_multipliers, mimic_offsets: Slope and offset (rad or m) of each mimic joint.
        active_joint_ids, active_joint_names, active_dof: All but mimic joints.
        link_names: (L,) parents before children.
        root_link_name: The root link.
        actuator_names: (M,) names of controls: the actuator's, with ``.INPUT`` if it has several.
    """

    cfg: ArticulationCfg

    def __init__(self, cfg: ArticulationCfg, parsed: ParsedArticulation, host: SimContext) -> None:
        super().__init__(cfg, parsed.uid, host)
        self.parsed = parsed
        self.joint_names = self.all_joint_names = list(parsed.joint_names)
        self.dof = len(self.joint_names)
        self.mimic_ids = list(parsed.mimic_ids)
        self.mimic_parents = list(parsed.mimic_parents)
        self.mimic_multipliers = list(parsed.mimic_multipliers)
        self.mimic_offsets = list(parsed.mimic_offsets)
        self.active_joint_ids = self.get_joint_ids(remove_mimic=True)
        self.active_joint_names = [self.joint_names[i] for i in self.active_joint_ids]
        self.active_dof = len(self.active_joint_ids)
        self.link_names = list(parsed.link_names)
        self.root_link_name = parsed.root_link_name
        self.actuator_names = list(parsed.control_names)
        self.drives = Drives(self, parsed)
        self.body_data = ArticulationData(self)
        self._all: Ids = np.arange(self.dof)
        # Live views of the joints' columns, where these are evenly spaced.
        self._qpos: Floats | None = None
        self._qvel: Floats | None = None
        # (N, D) simulated seconds at which efforts were set by hand; NaN where they were not.
        self._effort_times: Floats | None = None

    def bind(self, engine: Engine, index: EntityIndex) -> None:
        """Set the engine and the articulation's indices. Called once, by the simulation."""
        super().bind(engine, index)
        self._qpos_columns = columns_of(index.qpos_adr)
        self._dofs = columns_of(index.dof_adr)
        self._controls = columns_of(index.own_ctrl_ids)
        if isinstance(self._qpos_columns, slice):
            self._qpos = engine.state("qpos")[:, self._qpos_columns]
        if isinstance(self._dofs, slice):
            self._qvel = engine.state("qvel")[:, self._dofs]
        # The first request of an acceleration field computes it, so make it here.
        engine.acceleration("qfrc_actuator")
        self.drives.bind()

    def destroy(self) -> None:
        """Release the engine and the file's model; names and limits remain."""
        super().destroy()
        self._qpos = self._qvel = None
        self.parsed = self.drives.parsed = self.parsed.without_model()

    def _repr_facts(self) -> dict[str, Any]:
        """Return the joints and the number of links."""
        return {"joints": self.joint_names, "links": len(self.link_names)}

    # -- names ---------------------------------------------------------------------------------

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
        return [i for i in ids if not remove_mimic or i not in self.mimic_ids]

    def _indices(self, ids: Any, count: int, what: str) -> Ids:
        if isinstance(ids, torch.Tensor):
            ids = ids.tolist()
        indices = np.asarray(ids, np.int64).reshape(-1)
        if ((indices < 0) | (indices >= count)).any():
            raise ValueError(f"{self.uid}: {what} must be in [0, {count}), got {indices.tolist()}")
        return indices

    def _joints(self, joint_ids: Any, name: str | None = None) -> Ids:
        if name is not None:
            return np.asarray(self.get_joint_ids(name), np.int64)
        return self._all if joint_ids is None else self._indices(joint_ids, self.dof, "joint_ids")

    # -- reads of joints: (N, D), live views or copies: do not write or store ---------------------

    def read_qpos(self) -> Floats:
        """(N, D) joint positions, rad or m."""
        if self._qpos is not None:
            return self._qpos
        return self.engine.state("qpos")[:, self._qpos_columns]

    def read_qvel(self) -> Floats:
        """(N, D) joint velocities, rad/s or m/s."""
        if self._qvel is not None:
            return self._qvel
        return self.engine.state("qvel")[:, self._dofs]

    def read_qacc(self) -> Floats:
        """(N, D) joint accelerations of the last physics step, rad/s^2 or m/s^2."""
        return self.engine.acceleration("qacc")[:, self._dofs]

    def read_qf(self) -> Floats:
        """(N, D) drive effort of the last physics step, without passive damping; N m or N."""
        return self.engine.acceleration("qfrc_actuator")[:, self._dofs]

    def read_efforts(self) -> Floats:
        """(N, D) `read_qf`, or the effort set by `set_qf` if set since the last physics step."""
        efforts = self.read_qf()
        if self._effort_times is None:
            return efforts
        applied = self.engine.state("qfrc_applied")[:, self._dofs]
        return np.where(self._effort_times == self.engine.state("time"), applied, efforts)

    # -- writes of joints ----------------------------------------------------------------------

    def write_target(
        self, values: Floats, joints: Ids | None = None, ids: EnvIndex | None = None
    ) -> None:
        """Set drive targets (n, k) from checked arrays; None is all joints with a drive."""
        self.index  # noqa: B018  (compiles, which fills the columns)
        drives = self.drives
        if joints is not None:
            columns: Columns = drives.control_columns_of(joints)
        else:
            joints = drives.joints
            columns = drives.control_columns
            if len(joints) < self.dof:
                values = values[:, joints]
                if not len(joints):
                    drives.columns(self._all)  # raises
        drives.write_target_qpos(values, joints, columns, ids)

    def write_qpos(
        self, values: Floats, joints: Ids | None = None, ids: EnvIndex | None = None
    ) -> None:
        """Set joint positions (n, k) from checked arrays, clamped to the limits."""
        joints = self._all if joints is None else joints
        columns = columns_of(self.index.qpos_adr[joints])
        self.engine.write("qpos", self.drives.limits.clamp(values, joints, ids), ids, columns)

    def write_qvel(
        self, values: Floats, joints: Ids | None = None, ids: EnvIndex | None = None
    ) -> None:
        """Set joint velocities (n, k) from checked arrays."""
        joints = self._all if joints is None else joints
        self.engine.write("qvel", values, ids, self.index.dof_adr[joints])

    def write_qf(
        self, values: Floats, joints: Ids | None = None, ids: EnvIndex | None = None
    ) -> None:
        """Apply joint efforts (n, k) in N m or N from checked arrays; see `set_qf`."""
        joints = self._all if joints is None else joints
        self.engine.write("qfrc_applied", values, ids, self.index.dof_adr[joints])
        if self._effort_times is None:
            self._effort_times = np.full((self.num_instances, self.dof), np.nan)
        rows = np.arange(self.num_instances) if ids is None else ids
        self._effort_times[rows[:, None], joints] = self.engine.state("time")[rows]

    # -- controls ------------------------------------------------------------------------------

    def find_actuators(self, patterns: str | Sequence[str]) -> list[int]:
        """Indices of controls with names that a regex matches in full, ascending.

        Raises:
            ValueError: If a pattern matches nothing; lists the controls.
        """
        if isinstance(patterns, str):
            patterns = [patterns]
        matching_actuators: set[int] = set()
        for pattern in patterns:
            ids, problems = match(pattern, self.actuator_names, f"actuator of {self.uid}", "")
            if problems:
                raise ValueError(problems[0].message)
            matching_actuators.update(ids)
        return sorted(matching_actuators)

    def _picked(self, actuator_ids: Any, names: str | Sequence[str] | None) -> Ids:
        count = len(self.actuator_names)
        if names is not None:
            actuator_ids = self.find_actuators(names)
        elif actuator_ids is None:
            return np.arange(count)
        return self._indices(actuator_ids, count, "actuator_ids")

    def read_ctrl(self) -> Floats:
        """(N, M) controls: a live view or a copy; do not write or store."""
        return self.engine.state("ctrl")[:, self._controls]

    def write_ctrl(
        self, values: Floats, which: Ids, ids: EnvIndex | None = None, seconds: float | None = None
    ) -> None:
        """Set controls (n, k) from checked arrays, in the actuators' units.

        Args:
            values: The controls.
            which: (k,) indices in `actuator_names`: the file's actuators, then drives.
            ids: (n,) environments, or None for all.
            seconds: If given, targets of drives move at most `max_velocity` times this.
        """
        columns = self.index.own_ctrl_ids[which]
        values = self.drives.take_controls(values, columns, ids, seconds)
        self.engine.write("ctrl", values, ids, columns_of(columns))

    # -- links ---------------------------------------------------------------------------------

    def body_of(self, link: str | None) -> int:
        """MuJoCo body id of a link, by its name or one of the config's `names`; None is the root.

        Raises:
            ValueError: If there is no such link; lists the links.
        """
        if link is None:
            return self.index.root_body_id
        names = self.link_names
        alias = self.parsed.aliases.get(link)
        if alias is not None and alias.kind == "link" and len(alias.frames) == 1:
            link = alias.frames[0]
        if link not in names:
            aliases = [name for name, alias in self.parsed.aliases.items() if alias.kind == "link"]
            choices = ", ".join(names)
            if aliases:
                choices += f"; names: {', '.join(aliases)}"
            hint = did_you_mean(link, [*aliases, *names])
            raise ValueError(f"{self.uid} has no link {link!r}; there are: {choices}.{hint}")
        return int(self.index.body_ids[names.index(link)])

    def read_mass(self, bodies: Ids) -> Floats:
        """(N, k) masses in kg of bodies (k,), by MuJoCo's ids."""
        return self.engine.model_field("body_mass")[:, bodies]

    def write_mass(
        self, mass: Floats, bodies: Ids, ids: EnvIndex | None, inertia: bool = True
    ) -> None:
        """Set masses (n, k) in kg of bodies (k,), by MuJoCo's ids, from checked arrays.

        Inertias scale with the masses, unless ``inertia`` is False.
        """
        self.engine.write_model("body_mass", mass, ids, bodies)
        if inertia:
            self.write_inertia(mass / self.engine.model.body_mass[bodies], bodies, ids)
        else:
            self.engine.set_const_later(ids)

    def write_inertia(self, factor: Floats, bodies: Ids, ids: EnvIndex | None) -> None:
        """Set inertias of bodies (k,) to (n, k) times the compiled ones."""
        moments = self.engine.model.body_inertia[bodies] * factor[:, :, None]
        columns = (3 * bodies[:, None] + np.arange(3)).reshape(-1)
        self.engine.write_model("body_inertia", moments.reshape(len(factor), -1), ids, columns)
        self.engine.set_const_later(ids)

    def stop(self, ids: EnvIndex | None) -> None:
        """Like `clear_dynamics`, for checked indices."""
        dofs = self.index.dof_adr
        start = self.index.free_qvel_adr
        if start >= 0:
            dofs = np.concatenate([np.arange(start, start + 6), dofs])
        for field in ("qvel", "qacc_warmstart", "qfrc_applied"):
            self.engine.write(field, 0.0, ids, dofs)

    def forget_targets(self, ids: EnvIndex | None) -> None:
        """Clear targets, and efforts of `set_qf`, after a reset of environments (n,), or all."""
        self.drives.clear(ids)
        if self._effort_times is not None:
            self._effort_times[slice(None) if ids is None else ids] = np.nan

    # -- for users: tensors in and out, checked; see `Handle` ----------------------------------

    def get_qpos(self, name: str | None = None, target: bool = False) -> torch.Tensor:
        """Joint positions (N, k), or their drive targets."""
        values = self.drives.read_target_qpos() if target else self.read_qpos()
        return to_tensor(values[:, self.get_joint_ids(name)])

    def set_qpos(
        self,
        qpos: Any,
        joint_ids: Any = None,
        env_ids: Any = None,
        target: bool = True,
        name: str | None = None,
    ) -> None:
        """Set drive targets, or teleport the joints. Both are clamped to the joints' limits.

        The default, EmbodiChain's, sets targets: physics moves the joints there, and `get_qpos`
        returns where they are. `write_joint_state` puts them there at once.

        Args:
            qpos: (n, k) rad or m, or (k,) for all n environments.
            joint_ids: The k joints; None is all of them (with ``target``, all with a drive).
            env_ids: The n environments; None is all N.
            target: True sets the PD drives' targets, False the joint positions.
            name: A control part, instead of ``joint_ids``.

        Raises:
            ValueError: If a shape, an index or a value is wrong, or a joint has no drive.
        """
        joints = None if joint_ids is None and name is None else self._joints(joint_ids, name)
        width = self.dof if joints is None else len(joints)
        values, ids = self._checked(qpos, width, env_ids, "qpos", shared=True)
        if target:
            self.write_target(values, joints, ids)
        else:
            self.write_qpos(values, joints, ids)

    def write_joint_state(
        self,
        qpos: Any,
        qvel: Any = None,
        joint_ids: Any = None,
        env_ids: Any = None,
        name: str | None = None,
    ) -> None:
        """Set joint positions and velocities at once; drive targets follow.

        `get_qpos` and `get_qvel` then return what is given, also beyond the limits of joints; the
        position targets, which are clamped to them, follow. `set_qpos` sets targets alone.

        Args:
            qpos: (n, k) rad or m, or (k,) for all n environments.
            qvel: Likewise, rad/s or m/s; None is at rest.
            joint_ids: The k joints; None is all of them, mimic joints too.
            env_ids: The n environments; None is all N.
            name: A control part, instead of ``joint_ids``.

        Raises:
            ValueError: If a shape, an index or a value is wrong; nothing is then written.
        """
        joints = self._joints(joint_ids, name)
        values, ids = self._checked(qpos, len(joints), env_ids, "qpos", shared=True)
        rates: Any = 0.0
        if qvel is not None:
            rates, _ = self._checked(qvel, len(joints), env_ids, "qvel", shared=True)
        index = self.index
        self.engine.write("qpos", values, ids, columns_of(index.qpos_adr[joints]))
        self.engine.write("qvel", rates, ids, columns_of(index.dof_adr[joints]))
        driven = np.flatnonzero(np.isin(joints, self.drives.joints))
        if len(driven):
            self.write_target(values[:, driven], joints[driven], ids)

    def get_qvel(self, name: str | None = None, target: bool = False) -> torch.Tensor:
        """Joint velocities (N, k), or their drive targets."""
        values = self.drives.target_qvel if target else self.read_qvel()
        return to_tensor(values[:, self.get_joint_ids(name)])

    def set_qvel(
        self,
        qvel: Any,
        joint_ids: Any = None,
        env_ids: Any = None,
        target: bool = True,
        name: str | None = None,
    ) -> None:
        """Set drive velocity targets, or joint velocities; arguments as for `set_qpos`."""
        joints = self._joints(joint_ids, name)
        values, ids = self._checked(qvel, len(joints), env_ids, "qvel", shared=True)
        if target:
            self.drives.write_target_qvel(values, joints, ids)
        else:
            self.write_qvel(values, joints, ids)

    def get_qf(self, name: str | None = None) -> torch.Tensor:
        """Joint efforts (N, k): those set by `set_qf`, until the next physics step.

        After a step, and where none were set, they are the drives' efforts in the last physics
        step, without efforts set by `set_qf`, which still act.
        """
        return to_tensor(self.read_efforts()[:, self.get_joint_ids(name)])

    def set_qf(
        self, qf: Any, joint_ids: Any = None, env_ids: Any = None, name: str | None = None
    ) -> None:
        """Apply joint efforts (n, k) in N m or N, added to the drives', until overwritten or reset.

        `get_qf` reads them back until the next physics step.
        """
        joints = self._joints(joint_ids, name)
        values, ids = self._checked(qf, len(joints), env_ids, "qf", shared=True)
        self.write_qf(values, joints, ids)

    def get_qpos_limits(self, name: str | None = None) -> torch.Tensor:
        """(N, k, 2) lower and upper limits."""
        return to_tensor(self.drives.limits.values[:, self._joints(None, name)])

    def get_joint_drive(
        self, joint_ids: Any = None, env_ids: Any = None
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
        """Stiffness, damping, max_effort, max_velocity and friction, each (n, k).

        The armature is `body_data.joint_armature`.
        """
        rows = self._rows(env_ids)
        joints = self._joints(joint_ids)
        drives = self.drives

        def pick(values: Floats) -> torch.Tensor:
            return to_tensor(values[rows][:, joints])

        return (
            pick(drives.stiffness),
            pick(drives.damping),
            pick(drives.max_effort),
            pick(drives.max_velocity),
            pick(drives.friction),
        )

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
        """Set gains per environment; each value has shape (n, k), None keeps the current one.

        Raises:
            ValueError: If a shape is wrong, a value is negative or a joint has no drive.
        """
        joints = self._joints(joint_ids)
        gains = (stiffness, damping, max_effort, max_velocity, friction, armature)
        for name, value in zip(GAINS, gains, strict=True):
            if value is None:
                continue
            array, ids = self._checked(value, len(joints), env_ids, name, finite=False)
            if not (self.sim.arrays.host(array) >= 0).all():
                raise ValueError(f"{self.uid}: {name} must not be negative or NaN")
            self.drives.write(name, array, ids, joints)

    @property
    def ctrl_limits(self) -> torch.Tensor:
        """(M, 2) lower and upper limits of controls, infinite where there is none.

        MuJoCo clamps controls of the file's actuators; targets of drives are clamped to the joint's
        limits.
        """
        return to_tensor(self.parsed.ctrl_limits)

    def get_ctrl(
        self, actuator_ids: Any = None, names: str | Sequence[str] | None = None
    ) -> torch.Tensor:
        """(N, k) controls, by index or by regex over `actuator_names`; by default all M."""
        return to_tensor(self.read_ctrl()[:, self._picked(actuator_ids, names)])

    def set_ctrl(
        self,
        ctrl: Any,
        actuator_ids: Any = None,
        env_ids: Any = None,
        names: str | Sequence[str] | None = None,
    ) -> None:
        """Set controls; they stay until they are overwritten or the environment is reset.

        The meaning of a control depends on the actuator (`embodichain show`): a force, a position
        or velocity target, a muscle's excitation.

        Args:
            ctrl: (n, k) in the actuators' units, or (k,) for all n environments.
            actuator_ids: The k controls; None is all M.
            env_ids: The n environments; None is all N.
            names: Regexes over `actuator_names`, instead of ``actuator_ids``.

        Raises:
            ValueError: If a shape, an index or a value is wrong, or a regex matches nothing.
        """
        which = self._picked(actuator_ids, names)
        values, ids = self._checked(ctrl, len(which), env_ids, "ctrl", shared=True)
        self.write_ctrl(values, which, ids)

    def get_mass(self, link_names: Sequence[str] | None = None) -> torch.Tensor:
        """(N, k) link masses in kg."""
        return to_tensor(self.read_mass(self._bodies_of(link_names)))

    def set_mass(
        self, mass: Any, link_names: Sequence[str] | None = None, env_ids: Any = None
    ) -> None:
        """Set link masses (n, k) in kg; each link's inertia scales with its mass."""
        bodies = self._bodies_of(link_names)
        new, ids = self._checked(mass, len(bodies), env_ids, "mass")
        if (least := self.sim.arrays.host(new).min(initial=np.inf)) <= 0:
            raise ValueError(f"{self.uid}: masses must be positive, got {least}")
        self.write_mass(new, bodies, ids)

    def clear_dynamics(self, env_ids: Any = None) -> None:
        """Stop all joints and the root, and remove applied efforts."""
        self.stop(as_env_ids(env_ids, self.num_instances))
