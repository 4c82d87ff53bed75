"""`ParsedArticulation`: a robot file with its config applied, ready to be compiled into a scene."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np

from embodichain.lab.sim.cfg import ArticulationCfg
from embodichain.lab.sim.compiler.index import F64, Mask
from embodichain.lab.sim.compiler.names import FrameAlias, exact_pattern
from embodichain.lab.sim.compiler.robot.contacts.self_collision import SelfCollision
from embodichain.lab.sim.compiler.robot.drives.added_armature import RAISED
from embodichain.lab.sim.compiler.robot.files.initial_state import Keyframe
from embodichain.lab.sim.compiler.robot.files.robot_joints import ServoColumns
from embodichain.lab.sim.compiler.robot.kept_inertias import HullLimit
from embodichain.lab.sim.compiler.robot.robot_links import AttachedOptions
from embodichain.lab.sim.compiler.robot.robot_root import Placement

__all__ = ["ParsedArticulation"]


@dataclass(frozen=True, eq=False)
class ParsedArticulation:
    """One articulation, ready to be compiled into a scene. Joint arrays are (D,), in qpos order.

    Attributes:
        uid: Its name.
        cfg: Its config.
        path: The file.
        spec: The edited model, names without prefix. Copied when a scene is compiled.
        model: `spec` compiled alone.
        joint_names: Hinges and slides. Ball joints and the free joint of a floating base are not
            included: they are simulated, but have no columns in joint arrays.
        link_names: Bodies, parents before children.
        root_link_name: The body with the articulation's pose.
        placement: Where its root and its file's world are in the scene.
        fixed_base: Whether the root is fixed (a mocap body) or floats on a free joint.
        qpos_limits: (D, 2) rad or m; infinite where there is none.
        qvel_limits, qf_limits: From the file; inf where it has none.
        zero_velocity: Joints whose velocity limit in a URDF is 0, which is taken as none.
        init_qpos: Initial positions.
        init_qvel: Initial velocities: the keyframe's, else 0.
        stiffness: Gains of drives and of the file's servos; 0 without either.
        damping: As `stiffness`; the passive damping of a joint without either.
        joint_damping: Passive damping of the joints themselves, from the file; of a mimic joint,
            with what it carries of its leader's drive.
        carried_damping: What mimic joints carry of a drive's damping, see `couplings`; the damper
            of its actuator is smaller by as much.
        max_effort: Effort limits of drives; inf means no limit.
        max_velocity: Limits of position targets and velocity actions; 1e10 means no limit.
        friction: Dry friction.
        armature: Reflected inertia, `added_armature` included.
        added_armature: Armature added so that limited drives do not chatter.
        mimic_ids: Joints that follow another, ``q = multiplier * q[parent] + offset``: mimics of a
            URDF, and joints without drive and servo that an equality of an MJCF couples.
        aliases: Further names of links, sites and geoms: `names` of the config.
        control_parts: Part -> joint indices.
        tools: Part (``default`` is the whole robot) -> the link that is its tool point.
        own_actuators: Whether actuators of the file are kept.
        driven: (D,) joints with a drive of `drive_pros`, not a servo of the file.
        drives: (D,) names of the actuators that take the joints' targets (drives and the file's
            servos); an empty string where there is none.
        servos: Parameters of these actuators.
        control_names: (M,) names of controls: the file's actuators in their order, then the drives.
        ctrl_limits: (M, 2) limits of controls: the file's ranges, joint limits for drives; infinite
            where there is none.
        init_ctrl: (M,) initial controls.
        init_act: (K,) initial activations, in the order of its actuators.
        keyframe: The file's keyframe, for the root and ball joints, or None.
        options: The physics options that its own file gives, see `given_options`.
        attached_options: Path of each attached file, an empty model with its physics options, and
            the names of those it gives.
        self_collision: Which of its links collide with each other.
        notes: Messages for the user about the file, one line each.
        floors: Floors of its file, still in `spec`: see `compiler.floors`.
        attached_floors: Floors of attached files.
        hulls: Meshes whose convex hull is limited.
    """

    uid: str
    cfg: ArticulationCfg
    path: Path
    spec: mujoco.MjSpec
    model: mujoco.MjModel
    joint_names: tuple[str, ...]
    link_names: tuple[str, ...]
    root_link_name: str
    placement: Placement
    fixed_base: bool
    qpos_limits: F64
    qvel_limits: F64
    qf_limits: F64
    zero_velocity: tuple[str, ...]
    init_qpos: F64
    init_qvel: F64
    stiffness: F64
    damping: F64
    joint_damping: F64
    carried_damping: F64
    max_effort: F64
    max_velocity: F64
    friction: F64
    armature: F64
    added_armature: F64
    mimic_ids: tuple[int, ...]
    mimic_parents: tuple[int, ...]
    mimic_multipliers: tuple[float, ...]
    mimic_offsets: tuple[float, ...]
    aliases: dict[str, FrameAlias]
    control_parts: dict[str, tuple[int, ...]]
    tools: dict[str, str]
    own_actuators: bool
    driven: Mask
    drives: tuple[str, ...]
    servos: ServoColumns
    control_names: tuple[str, ...]
    ctrl_limits: F64
    init_ctrl: F64
    init_act: F64
    keyframe: Keyframe | None
    options: frozenset[str]
    attached_options: tuple[AttachedOptions, ...]
    self_collision: SelfCollision
    notes: tuple[str, ...]
    floors: tuple[str, ...]
    attached_floors: tuple[str, ...]
    hulls: tuple[HullLimit, ...]

    @property
    def site_names(self) -> tuple[str, ...]:
        """Its sites that have a name."""
        return tuple(site.name for site in self.spec.sites if site.name)

    @property
    def geom_names(self) -> tuple[str, ...]:
        """Its geoms that have a name."""
        return tuple(geom.name for geom in self.spec.geoms if geom.name)

    @property
    def all_notes(self) -> tuple[str, ...]:
        """Messages about the file, and about links that do not collide with each other."""
        left_out = self.self_collision.note()
        return (*self.notes, f"{self.path}: {left_out}") if left_out else self.notes

    def with_given_armature(self, armature: Mapping[str, float]) -> ParsedArticulation:
        """Return it as if the config gave the added armature: joint -> kg m^2 or kg."""
        drives = self.cfg.drive_pros
        by_pattern: dict[str, float] = {}
        if isinstance(drives.armature, Mapping):
            by_pattern |= drives.armature
        for name, value in armature.items():
            by_pattern[exact_pattern(name)] = value
        message = f"drive_pros.armature {RAISED}"
        return replace(
            self,
            cfg=replace(self.cfg, drive_pros=replace(drives, armature=by_pattern)),
            added_armature=np.zeros(len(self.joint_names)),
            notes=tuple(note for note in self.notes if message not in note),
        )

    def without_model(self) -> ParsedArticulation:
        """Return it with an empty `spec` and `model`, which are large."""
        empty = mujoco.MjSpec()
        return replace(self, spec=empty, model=empty.compile())
