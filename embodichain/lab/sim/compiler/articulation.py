"""`parse_articulation`: makes a checked `ParsedArticulation` from a robot file and its config."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from embodichain.lab.sim.cfg import ArticulationCfg, RobotCfg, URDFCfg
from embodichain.lab.sim.compiler.collision_shapes import replace_shapes, resolve_shapes
from embodichain.lab.sim.compiler.contact_patterns import apply_contacts, check_contacts
from embodichain.lab.sim.compiler.couplings import (
    Rigidity,
    couple,
    moving_mimics,
    rigid_armature,
    shown_mimics,
)
from embodichain.lab.sim.compiler.drives import (
    DriveChange,
    DriveGains,
    PhysicsStep,
    apply_drives,
    drawn_joints,
    quiet_armature,
    resolve_drives,
)
from embodichain.lab.sim.compiler.index import F64, Mask
from embodichain.lab.sim.compiler.kept_inertias import HullLimit
from embodichain.lab.sim.compiler.model_size import reported
from embodichain.lab.sim.compiler.names import exact_pattern, match, names_in_spec
from embodichain.lab.sim.compiler.postures import start_posture
from embodichain.lab.sim.compiler.rigid_objects import check_pose, initial_pose
from embodichain.lab.sim.compiler.robot_assembly import assemble, attach_files
from embodichain.lab.sim.compiler.robot_files import (
    MUJOCO_ERRORS,
    ModelFile,
    as_line,
    compile_quietly,
    locate,
    read_model,
)
from embodichain.lab.sim.compiler.robot_joints import (
    FileJoints,
    Keyframe,
    Mimics,
    Servos,
    control_names,
    initial_controls,
    movable_joints,
    read_servos,
    resolve_qpos,
)
from embodichain.lab.sim.compiler.robot_links import (
    AttachedOptions,
    RobotModel,
    Tool,
    add_attachments,
    add_tools,
    check_attachments,
    lock_joints,
    prepare_file,
    resolve_tools,
)
from embodichain.lab.sim.compiler.robot_root import Placement, Root, place, set_root
from embodichain.lab.sim.compiler.self_collision import (
    LinkOrigins,
    SelfCollision,
    set_self_collision,
)
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.math import quat_conjugate, quat_rotate
from embodichain.utils.suggest import listing

__all__ = ["ParsedArticulation", "parse_articulation", "parse_with_problems"]

_RAISED = "is raised"


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
        init_qpos: Initial positions.
        init_qvel: Initial velocities: the keyframe's, else 0.
        stiffness: Gains of drives and of the file's servos; 0 without either.
        damping: As `stiffness`; the passive damping of a joint without either.
        joint_damping: Passive damping of the joints themselves, from the file; of a mimic joint,
            with what it carries of its leader's drive.
        carried_damping: What mimic joints carry of a drive's damping, see `couplings`; the damper
            of its actuator is smaller by as much.
        max_effort: Effort limits of drives; inf is no limit.
        max_velocity: Limits of position targets and velocity actions; 1e10 is no limit.
        friction: Dry friction.
        armature: Reflected inertia, `added_armature` included.
        added_armature: Armature added so that limited drives do not chatter.
        mimic_ids: Joints that follow another, ``q = multiplier * q[parent] + offset``: mimics of a
            URDF, and joints without drive and servo that an equality of an MJCF couples.
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
    control_parts: dict[str, tuple[int, ...]]
    tools: dict[str, str]
    own_actuators: bool
    driven: Mask
    drives: tuple[str, ...]
    servos: Servos
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
        given = drives.armature if isinstance(drives.armature, Mapping) else {}
        names = {exact_pattern(name): value for name, value in armature.items()}
        return replace(
            self,
            cfg=replace(self.cfg, drive_pros=replace(drives, armature={**given, **names})),
            added_armature=np.zeros(len(self.joint_names)),
            notes=tuple(n for n in self.notes if f"drive_pros.armature {_RAISED}" not in n),
        )

    def without_model(self) -> ParsedArticulation:
        """Return it with an empty `spec` and `model`, which are large."""
        empty = mujoco.MjSpec()
        return replace(self, spec=empty, model=empty.compile())


def parse_articulation(
    uid: str,
    cfg: ArticulationCfg,
    step: PhysicsStep | None = None,
    changes: Sequence[DriveChange] = (),
) -> ParsedArticulation:
    """Read an articulation's file and apply its config; every call reads the file again.

    Args:
        uid: Its name in the scene.
        cfg: Its config.
        step: Time step and integrator of the scene, for the armature that limited drives need; None
            adds no armature.
        changes: Values that events may draw for its drives and links.

    Raises:
        ConfigError: If the file is missing or malformed, or the config does not fit it; every
            mistake, with paths below `uid`.
    """
    parsed, problems = parse_with_problems(uid, cfg, step, changes)
    if parsed is None or problems:
        raise ConfigError(p.below(uid) for p in problems)
    return parsed


def parse_with_problems(
    uid: str,
    cfg: ArticulationCfg,
    step: PhysicsStep | None = None,
    changes: Sequence[DriveChange] = (),
) -> tuple[ParsedArticulation | None, list[Problem]]:
    """As `parse_articulation`, but return the mistakes, with paths relative to the config.

    With mistakes in the config the articulation is returned, for its names; with one in the file,
    None.
    """
    with reported(f"{uid}: reading {cfg.fpath or 'the files of urdf_cfg'}"):
        return _parse(uid, cfg, step, changes)


def _parse(
    uid: str,
    cfg: ArticulationCfg,
    step: PhysicsStep | None,
    changes: Sequence[DriveChange],
) -> tuple[ParsedArticulation | None, list[Problem]]:
    try:
        file = read_robot(cfg)
    except ConfigError as error:
        return None, [
            p if p.path.startswith("urdf_cfg") else Problem("fpath", str(p), "")
            for p in error.problems
        ]
    misplaced = check_pose(cfg)
    placed = ArticulationCfg(fix_base=cfg.fix_base) if misplaced else cfg
    problems = [*_unsupported(cfg), *misplaced]
    try:
        wrong = lock_joints(file, cfg.locked_joints)
    except MUJOCO_ERRORS as error:
        return None, [*problems, Problem("locked_joints", as_line(error)[0])]
    if wrong:  # which joints the robot has is unknown
        return None, [*problems, *wrong]
    attached, init_qpos = getattr(cfg, "attach", {}), cfg.init_qpos
    try:
        robot = prepare_file(file, cfg.attrs)
        if attached:
            init_qpos = _of_own_joints(init_qpos, robot.joints.names)
            robot, wrong = attach_files(robot, attached)
            if wrong:  # which names the robot has is unknown
                return None, [*problems, *wrong]
    except ConfigError as error:
        return None, [*problems, *error.problems]
    except MUJOCO_ERRORS as error:
        return None, [*problems, Problem("fpath", f"{file.path}: {as_line(error)[0]}")]
    joints, mimics, keyframe = robot.joints, robot.mimics, robot.keyframe
    count = len(joints.names)
    parts, wrong = _control_parts(getattr(cfg, "control_parts", None), joints.names)
    problems += wrong
    gains, wrong = resolve_drives(cfg.drive_pros, joints, parts, mimics.ids)
    problems += [p.below("drive_pros") for p in wrong]
    qpos, wrong = resolve_qpos(init_qpos, joints, mimics, keyframe, robot.equalities)
    problems += wrong
    links = [body.name for body in file.spec.bodies[1:]]  # the first is the world
    problems += check_attachments(file.spec, cfg.attachments)
    shapes, wrong = resolve_shapes(links, cfg)
    problems += wrong
    sites = names_in_spec(file.spec, "site")
    tools, wrong = resolve_tools(cfg, parts, [*links, *cfg.attachments], sites)
    problems += wrong
    try:
        drives, replaced = apply_drives(file.spec, gains, joints)
        driven = gains.driven.any() or joints.servos.count or joints.from_urdf.any()
        if joints.names and not driven and isinstance(cfg, RobotCfg):  # a door needs no drive
            what = "it has no actuators, drive_pros names no joint: its actions are empty"
            replaced.append(f"no joint is driven: {what}")
        notes = [*robot.notes, *(f"{file.path}: {line}" for line in replaced)]
        notes += _without_effort(cfg, joints, mimics)
        notes += _driven_mimics(cfg, file, joints.names, mimics, parts)
        if not problems:
            replace_shapes(file.spec, shapes, cfg.attrs)
            add_attachments(file.spec, cfg.attachments)
        problems += check_contacts(file.spec, cfg.contact, list(cfg.attachments))
        if not problems:
            apply_contacts(file.spec, cfg.contact)
            add_tools(file.spec, tools)
        for body in file.spec.bodies[1:]:
            if cfg.gravcomp is not None:
                body.gravcomp = float(cfg.gravcomp)
        _unsimplify(file.spec, changes)
        notes += _fixed(cfg, file)
        start = None if keyframe is None else keyframe.root
        root = set_root(file.spec, cfg.fix_base, robot.planes, start)
        spec = root.spec
        notes += [f"{file.path}: {line}" for line in root.notes]
        model = compile_quietly(spec)
        added = np.zeros(count)
        rigidity = Rigidity(np.zeros(count), np.zeros(count))
        collision = SelfCollision()
        if not problems:
            origins = _origins(cfg, robot, root.name, tools)
            posture = start_posture(model, qpos, keyframe)
            collision, problems, changed = set_self_collision(spec, model, cfg, origins, posture)
            model = compile_quietly(spec) if changed else model
        if step is not None and not problems:
            added, said = _quieten(
                spec, model, joints.names, gains, mimics, qpos, parts, step, changes
            )
            notes += [f"{file.path}: {note}" for note in said]
            rigidity = couple(
                spec, model, joints.names, gains, mimics, qpos, joints.qvel_limits, step
            )
        if not problems and cfg.fix_base:
            notes += _overloaded(cfg, model, gains, qpos)
    except (ConfigError, *MUJOCO_ERRORS) as error:
        text = str(error) if isinstance(error, ConfigError) else as_line(error)[0]
        if "mjMINVAL" in text and not cfg.fix_base:
            text += ": a base without mass cannot float; fix_base: true fixes it"
        return None, [*problems, Problem("fpath", f"{file.path}: {text}")]
    servos = read_servos(model, movable_joints(model))
    # Convert damping ratios to gains here: inertias may have changed.
    kept = ~gains.driven & (servos.drive >= 0)
    shown = shown_mimics(mimics, robot.equalities, gains.driven | (servos.drive >= 0))
    init_ctrl, init_act = initial_controls(model, servos, gains.driven, qpos, keyframe)
    return (
        ParsedArticulation(
            uid=uid,
            cfg=cfg,
            path=file.path,
            spec=spec,
            model=model,
            joint_names=tuple(model.joint(i).name for i in movable_joints(model)),
            link_names=tuple(model.body(i).name for i in range(1, model.nbody)),
            root_link_name=root.name,
            placement=place(placed, _root_pose(model, root, keyframe)),
            fixed_base=cfg.fix_base,
            qpos_limits=joints.qpos_limits,
            qvel_limits=joints.qvel_limits,
            qf_limits=joints.qf_limits,
            init_qpos=qpos,
            init_qvel=np.zeros(len(qpos)) if keyframe is None else keyframe.qvel,
            stiffness=np.where(kept, servos.stiffness, gains.stiffness),
            damping=np.where(kept, servos.damping, gains.damping + rigidity.damping),
            joint_damping=joints.damping + rigidity.damping,
            carried_damping=rigidity.carried,
            max_effort=np.where(kept, servos.max_effort, gains.max_effort),
            max_velocity=gains.max_velocity,
            friction=gains.friction,
            armature=np.where(added > 0, _rounded(gains.armature + added), gains.armature),
            added_armature=added,
            mimic_ids=shown.ids,
            mimic_parents=shown.parents,
            mimic_multipliers=shown.multipliers,
            mimic_offsets=shown.offsets,
            control_parts=parts,
            tools={part: tool.link for part, tool in tools.items()},
            own_actuators=model.nactuator > int(gains.driven.sum()),
            driven=gains.driven,
            drives=tuple(
                own or (model.actuator(int(servo)).name if servo >= 0 else "")
                for own, servo in zip(drives, servos.drive, strict=True)
            ),
            servos=servos,
            control_names=control_names(model),
            ctrl_limits=_ctrl_limits(model, drives, joints.qpos_limits),
            init_ctrl=init_ctrl,
            init_act=init_act,
            keyframe=keyframe,
            options=file.options,
            attached_options=robot.attached_options,
            self_collision=collision,
            notes=tuple(notes),
            floors=robot.floors,
            attached_floors=robot.attached_floors,
            hulls=robot.hulls,
        ),
        problems,
    )


def _fixed(cfg: ArticulationCfg, file: ModelFile) -> list[str]:
    """Return a message about free joints of the file that `fix_base` leaves out."""
    free = [
        f"{joint.name!r} of {body.name!r}"
        for body in file.spec.worldbody.bodies
        for joint in body.joints
        if joint.type == mujoco.mjtJoint.mjJNT_FREE
    ]
    if not cfg.fix_base or not free:
        return []
    why = "the base is fixed (fix_base: true, the default); fix_base: false lets it float"
    return [f"{file.path}: free joint {', '.join(free)} left out: {why}"]


def _without_effort(cfg: ArticulationCfg, joints: FileJoints, mimics: Mimics) -> list[str]:
    """Return a message about joints of URDF files whose effort limit, which is taken, is 0."""
    zero = joints.limits.zero_effort
    driven = [n for i, n in enumerate(joints.names) if i not in mimics.ids and n in zero]
    if cfg.drive_pros.max_effort != "file" or not driven:
        return []
    places = ", ".join(f"{name!r} ({zero[name]})" for name in driven)
    entries = ", ".join(f"{exact_pattern(name)}: N" for name in driven)
    return [
        f'effort="0" is taken as no limit for joints {places}: write their limits into the file, '
        f"or drive_pros.max_effort: {{{entries}}}, in N m or N; a joint that shall not push needs "
        "stiffness 0 and damping 0"
    ]


def _driven_mimics(
    cfg: ArticulationCfg,
    file: ModelFile,
    names: Sequence[str],
    mimics: Mimics,
    parts: Mapping[str, Sequence[int]],
) -> list[str]:
    """Return a message about entries of `drive_pros` that pick mimic joints only."""
    leaders = dict(zip(mimics.ids, mimics.parents, strict=True))
    idle: list[str] = []
    for field in ("stiffness", "damping", "max_effort"):
        given = getattr(cfg.drive_pros, field)
        for pattern in given if isinstance(given, Mapping) else ():
            picked = parts.get(pattern) or match(pattern, names, "joint", field)[0]
            if picked and all(i in leaders for i in picked):
                which = ", ".join(f"{names[i]!r} mimics {names[leaders[i]]!r}" for i in picked)
                idle.append(f"{field}.{pattern} ({which})")
    if not idle:
        return []
    return [f"{file.path}: drive_pros has no effect on joints that follow: {'; '.join(idle)}"]


def _origins(
    cfg: ArticulationCfg, robot: RobotModel, root: str, tools: Mapping[str, Tool]
) -> LinkOrigins:
    """Return which file each link is from; the world of a file is the root, if one was added."""
    model = robot.model
    links = [model.body(i).name for i in range(model.nbody)]
    static: set[str] = set()
    if cfg.fix_base:
        static = {links[i] for i in np.flatnonzero(model.body_weldid == 0).tolist()}
        static |= set() if root in links else {root}
    added = {*cfg.attachments, *(tool.link for tool in tools.values() if tool.pose is not None)}
    return LinkOrigins(robot.is_urdf, added, static)


def _overloaded(
    cfg: ArticulationCfg, model: mujoco.MjModel, gains: DriveGains, qpos: F64
) -> list[str]:
    """Return a message if drives cannot bear the weight at the initial position."""
    data = mujoco.MjData(model)
    joints = movable_joints(model)
    data.qpos[model.jnt_qposadr[joints]] = qpos
    kept = model.opt.gravity.copy()
    down = np.array([0.0, 0.0, -9.81])
    model.opt.gravity = quat_rotate(quat_conjugate(initial_pose(cfg)[1]), down)
    mujoco.mj_forward(model, data)
    model.opt.gravity = kept
    needed = np.abs(data.qfrc_bias - data.qfrc_passive)[model.jnt_dofadr[joints]]
    weak = np.flatnonzero(gains.driven & (needed > gains.max_effort))
    if not len(weak):
        return []
    names = ", ".join(
        f"{model.joint(joints[i]).name} {needed[i]:.4g} of {gains.max_effort[i]:.4g}" for i in weak
    )
    advice = "the robot sinks; give it a lighter tool, a larger max_effort, or gravcomp"
    return [f"its weight at the initial position is more than drives bear ({names}): {advice}"]


def _quieten(
    spec: mujoco.MjSpec,
    model: mujoco.MjModel,
    names: Sequence[str],
    gains: DriveGains,
    mimics: Mimics,
    home: F64,
    parts: Mapping[str, Sequence[int]],
    step: PhysicsStep,
    changes: Sequence[DriveChange],
) -> tuple[F64, list[str]]:
    """Raise armature that the config does not give, in a spec and its model.

    Returns:
        (D,) added armature, and messages for the user.
    """
    quiet = quiet_armature(model, names, gains, home, parts, step, changes)
    lacking = quiet
    if mimics.ids:
        rigid = moving_mimics(model, names, mimics)
        lacking = quiet_armature(model, names, gains, home, parts, step, changes, rigid)
        lacking = rigid_armature(model, names, gains, mimics, home, step, lacking)
    given = gains.armature_given | drawn_joints("armature", names, parts, changes)
    added = np.where(given, 0.0, lacking)
    for i in np.flatnonzero(added > 0).tolist():
        total = float(_rounded(gains.armature + added)[i])
        spec.joint(names[i]).armature = total
        model.dof_armature[model.joint(names[i]).dofadr[0]] = total
    if added.any():
        mujoco.mj_setConst(model, mujoco.MjData(model))
    enough = gains.armature + lacking
    why = "limited drives would chatter"
    if not (quiet > 0).any():
        why = "joints that mimic others would not follow them"
    elif (lacking > quiet).any():
        why += ", and joints that mimic others would not follow them,"
    notes = (
        _armature_note(_RAISED, names, enough, added > 0, why, step),
        _armature_note("is too small", names, enough, given & (lacking > 0), why, step),
    )
    return added, [note for note in notes if note]


def _rounded(values: F64) -> F64:
    """Round to 12 decimals, as a config that gives the armature has."""
    return np.array([round(float(value), 12) for value in values])


def _armature_note(
    what: str, names: Sequence[str], enough: F64, joints: Mask, why: str, step: PhysicsStep
) -> str:
    listed = ", ".join(f"{names[i]}: {enough[i]:.4g}" for i in np.flatnonzero(joints).tolist())
    because = f"{why} at a time step of {step.dt:g} s"
    return f"drive_pros.armature {what}: {because}; enough is {{{listed}}}" if listed else ""


def read_robot(cfg: ArticulationCfg) -> ModelFile:
    """Read the file of an articulation, or the files of a robot with a `urdf_cfg`.

    Raises:
        ConfigError: If a file is missing or malformed, or a component is wrong; problems of
            components have paths that begin with ``urdf_cfg``.
    """
    urdf: URDFCfg | None = getattr(cfg, "urdf_cfg", None)
    convex_parts = cfg.collision == "decompose"
    if urdf is not None and not cfg.fpath:
        return assemble(urdf, convex_parts)
    file = read_model(locate(cfg.fpath), convex_parts)
    if urdf is not None:
        file.notes.append("urdf_cfg has no effect: fpath names the robot's file")
    return file


def _unsupported(cfg: ArticulationCfg) -> list[Problem]:
    problems = []
    scale = tuple(float(s) for s in cfg.body_scale)
    if scale != (1.0, 1.0, 1.0):
        message = f"articulations cannot be scaled yet, got {list(scale)}"
        problems.append(Problem("body_scale", message))
    return problems


def _control_parts(
    parts: Mapping[str, Sequence[str] | str] | None, names: Sequence[str]
) -> tuple[dict[str, tuple[int, ...]], list[Problem]]:
    """Return each part's joints, in the order of its patterns, each joint once."""
    found: dict[str, tuple[int, ...]] = {}
    problems: list[Problem] = []
    for part, patterns in (parts or {}).items():
        ids: list[int] = []
        for pattern in [patterns] if isinstance(patterns, str) else patterns:
            matched, wrong = match(pattern, names, "joint", f"control_parts.{part}")
            problems += wrong
            ids += matched
        if not patterns:
            message = f"names no joint; there are: {listing(names)}"
            problems.append(Problem(f"control_parts.{part}", message))
        found[part] = tuple(dict.fromkeys(ids))
    return found, problems


def _of_own_joints(init_qpos: Any, names: Sequence[str]) -> Any:
    """Return a list with a value for each joint of a robot's own file as a map."""
    own = isinstance(init_qpos, Sequence | np.ndarray) and len(init_qpos) == len(names)
    return dict(zip(map(exact_pattern, names), init_qpos, strict=True)) if own else init_qpos


def _root_pose(model: mujoco.MjModel, root: Root, keyframe: Keyframe | None) -> F64:
    """Return (7,) the root's pose in the file's world at the start."""
    if keyframe is not None and keyframe.root is not None and not root.wrapped:
        return keyframe.root
    body = model.body(root.name)
    if body.jntnum[0]:
        at = int(model.jnt_qposadr[body.jntadr[0]])
        start: F64 = model.qpos0[at : at + 7].copy()
        return start
    return np.concatenate([body.pos, body.quat])


def _unsimplify(spec: mujoco.MjSpec, changes: Sequence[DriveChange]) -> None:
    """Let MuJoCo treat no body as "simple" whose centre of mass events move.

    The mass matrix of a simple body is stored as its diagonal, which a centre of mass beside the
    joint would not be.
    """
    bodies = spec.bodies[1:]  # the first is the world
    names = [body.name for body in bodies]
    for change in changes:
        for index in change.bounds("com", names, {}):
            bodies[index].simple = 0


def _ctrl_limits(model: mujoco.MjModel, drives: Sequence[str], qpos_limits: F64) -> F64:
    """Return (nu, 2) limits of controls."""
    limited = model.actuator_ctrllimited.astype(np.bool_)[:, None]
    limits: F64 = np.where(limited, model.actuator_ctrlrange, [-np.inf, np.inf])
    for name, low_high in zip(drives, qpos_limits, strict=True):
        if name:
            limits[model.actuator_ctrladr[model.actuator(name).id]] = low_high
    return limits
