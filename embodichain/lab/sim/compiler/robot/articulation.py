"""`parse_articulation`: makes a checked `ParsedArticulation` from a robot file and its config."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np

from embodichain.lab.sim.cfg import ArticulationCfg, CollisionShapeCfg, RobotCfg, URDFCfg
from embodichain.lab.sim.compiler.geoms.poses import check_pose
from embodichain.lab.sim.compiler.index import F64
from embodichain.lab.sim.compiler.model_size import reported
from embodichain.lab.sim.compiler.names import exact_pattern, match_every, names_in_spec
from embodichain.lab.sim.compiler.robot.contacts.collision_shapes import (
    replace_shapes,
    resolve_shapes,
)
from embodichain.lab.sim.compiler.robot.contacts.contact_patterns import (
    apply_contacts,
    check_contacts,
)
from embodichain.lab.sim.compiler.robot.contacts.postures import start_posture
from embodichain.lab.sim.compiler.robot.contacts.self_collision import (
    LinkOrigins,
    SelfCollision,
    set_self_collision,
)
from embodichain.lab.sim.compiler.robot.drives.added_armature import add_armature, rounded
from embodichain.lab.sim.compiler.robot.drives.chatter import PhysicsStep
from embodichain.lab.sim.compiler.robot.drives.drive_changes import DriveChange
from embodichain.lab.sim.compiler.robot.drives.pd_drives import (
    DriveGains,
    JointDrive,
    apply_drives,
    resolve_drives,
)
from embodichain.lab.sim.compiler.robot.drives.rigid_couplings import (
    Rigidity,
    make_couplings_rigid,
)
from embodichain.lab.sim.compiler.robot.files.initial_state import (
    Keyframe,
    initial_controls,
    resolve_qpos,
)
from embodichain.lab.sim.compiler.robot.files.joint_couplings import shown_mimics
from embodichain.lab.sim.compiler.robot.files.robot_files import (
    MUJOCO_ERRORS,
    ModelFile,
    as_line,
    compile_quietly,
    locate,
    read_model,
)
from embodichain.lab.sim.compiler.robot.files.robot_joints import (
    ServoColumns,
    control_names,
    movable_joints,
    read_servos,
)
from embodichain.lab.sim.compiler.robot.frame_aliases import (
    check_grippers,
    frames_by_kind,
    resolve_aliases,
    with_file_names,
    with_file_names_in,
)
from embodichain.lab.sim.compiler.robot.parsed_articulation import ParsedArticulation
from embodichain.lab.sim.compiler.robot.robot_assembly import assemble, attach_files
from embodichain.lab.sim.compiler.robot.robot_links import (
    RobotModel,
    Tool,
    add_attachments,
    add_tools,
    check_attachments,
    lock_joints,
    prepare_file,
    resolve_tools,
    tool_links,
)
from embodichain.lab.sim.compiler.robot.robot_notes import (
    driven_mimics,
    fixed_free_joints,
    implausible_size,
    overloaded_drives,
    starts_beyond_limits,
    without_effort,
    without_velocity,
)
from embodichain.lab.sim.compiler.robot.robot_root import Root, place, set_root
from embodichain.lab.sim.compiler.robot.tool_home import check_home, move_to_home
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import listing

__all__ = ["parse_articulation", "parse_with_problems"]


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


@dataclass(frozen=True, eq=False)
class _Settings:
    """What the config says of a robot whose file is read.

    Attributes:
        parts: Control part -> joint indices.
        drives: How each of the D joints is driven.
        qpos: (D,) initial positions, rad or m.
        shapes: Link -> the shape that replaces its collision shapes; None removes them.
        tools: Control part -> its tool point.
    """

    parts: dict[str, tuple[int, ...]]
    drives: list[JointDrive]
    qpos: F64
    shapes: dict[str, CollisionShapeCfg | None]
    tools: dict[str, Tool]


def _parse(
    uid: str,
    cfg: ArticulationCfg,
    step: PhysicsStep | None,
    changes: Sequence[DriveChange],
) -> tuple[ParsedArticulation | None, list[Problem]]:
    """Read the file, apply the config to it, compile it; see `parse_with_problems`."""
    written = cfg
    cfg = with_file_names(cfg)
    changes = with_file_names_in(changes, written)
    try:
        file = read_robot(cfg)
    except ConfigError as error:
        return None, [
            p if p.path.startswith("urdf_cfg") else Problem("fpath", str(p), "")
            for p in error.problems
        ]
    problems = _check_scale(cfg)
    pose_mistakes = check_pose(cfg)
    problems += pose_mistakes
    try:
        robot, init_qpos = _prepare(file, cfg)
    except ConfigError as error:
        return None, [*problems, *error.problems]
    settings, mistakes = _resolve_settings(cfg, robot, init_qpos)
    problems += mistakes
    # With a wrong pose the robot stands at the origin, so that its names are known.
    placed = ArticulationCfg(fix_base=cfg.fix_base) if pose_mistakes else cfg
    try:
        parsed = _compile(uid, cfg, placed, file, robot, settings, step, changes, problems)
    except (ConfigError, *MUJOCO_ERRORS) as error:
        text = str(error) if isinstance(error, ConfigError) else as_line(error)[0]
        if "mjMINVAL" in text and not cfg.fix_base:
            text += ": a base without mass cannot float; fix_base: true fixes it"
        return None, [*problems, Problem("fpath", f"{file.path}: {text}")]
    return replace(parsed, cfg=written), problems


def _prepare(file: ModelFile, cfg: ArticulationCfg) -> tuple[RobotModel, Any]:
    """Lock joints, prepare the file, attach others; `file.spec` changes.

    Returns:
        The robot, and `init_qpos` in terms of its joints.

    Raises:
        ConfigError: If the robot's joints or links stay unknown, so that nothing else can be said.
    """
    try:
        mistakes = lock_joints(file, cfg.locked_joints)
    except MUJOCO_ERRORS as error:
        raise ConfigError([Problem("locked_joints", as_line(error)[0])]) from error
    if mistakes:
        raise ConfigError(mistakes)
    init_qpos = cfg.init_qpos
    try:
        robot = prepare_file(file, cfg.attrs)
        attached_files = getattr(cfg, "attach", {})
        if attached_files:
            init_qpos = _by_joint(init_qpos, robot.joints.names)
            robot, mistakes = attach_files(robot, attached_files)
    except MUJOCO_ERRORS as error:
        raise ConfigError([Problem("fpath", f"{file.path}: {as_line(error)[0]}")]) from error
    if mistakes:
        raise ConfigError(mistakes)
    return robot, init_qpos


def _resolve_settings(
    cfg: ArticulationCfg, robot: RobotModel, init_qpos: Any
) -> tuple[_Settings, list[Problem]]:
    """Find the joints, links and sites that a config names; return every mistake too."""
    joints = robot.joints
    spec = robot.spec
    parts, problems = _control_parts(getattr(cfg, "control_parts", None), joints.names)
    drives, mistakes = resolve_drives(cfg.drive_pros, joints, parts, robot.mimics)
    problems += [problem.below("drive_pros") for problem in mistakes]
    qpos, mistakes = resolve_qpos(init_qpos, joints, robot.mimics, robot.keyframe, robot.equalities)
    problems += mistakes
    links = [body.name for body in spec.bodies[1:]]  # the first is the world
    problems += check_attachments(spec, cfg.attachments)
    shapes, mistakes = resolve_shapes(links, cfg)
    problems += mistakes
    sites = names_in_spec(spec, "site")
    tools, mistakes = resolve_tools(cfg, parts, [*links, *cfg.attachments], sites)
    problems += mistakes
    return _Settings(parts, drives, qpos, shapes, tools), problems


def _compile(
    uid: str,
    cfg: ArticulationCfg,
    placed: ArticulationCfg,
    file: ModelFile,
    robot: RobotModel,
    settings: _Settings,
    step: PhysicsStep | None,
    changes: Sequence[DriveChange],
    problems: list[Problem],
) -> ParsedArticulation:
    """Apply the settings to a robot's spec, and compile it.

    Args:
        uid: The robot's name in the scene.
        cfg: Its config.
        placed: A config with its initial pose.
        file: Its own file.
        robot: The same, prepared, with attached files.
        settings: What the config says of it.
        step: Time step and integrator of the scene, or None.
        changes: Values that events may draw for its drives and links.
        problems: Mistakes so far; more are appended. With one, only names matter.

    Raises:
        ConfigError: If the file cannot have such a base.
    """
    joints = robot.joints
    mimics = robot.mimics
    keyframe = robot.keyframe
    names = joints.names
    qpos = settings.qpos
    gains = DriveGains.from_drives(settings.drives)

    drive_names, lines = apply_drives(file.spec, settings.drives)
    has_drive = gains.driven.any() or joints.actuators or any(j.is_urdf for j in joints.rows)
    if names and not has_drive and isinstance(cfg, RobotCfg):  # a door needs no drive
        reason = "it has no actuators, drive_pros names no joint: its actions are empty"
        lines.append(f"no joint is driven: {reason}")
    notes = [*robot.notes, *(f"{file.path}: {line}" for line in lines)]
    notes += without_effort(cfg, joints, mimics)
    notes += without_velocity(cfg, joints, mimics)
    notes += driven_mimics(cfg, file, names, mimics, settings.parts)

    if not problems:
        replace_shapes(file.spec, settings.shapes, cfg.attrs)
        add_attachments(file.spec, cfg.attachments)
    problems += check_contacts(file.spec, cfg.contact, list(cfg.attachments))
    if not problems:
        apply_contacts(file.spec, cfg.contact)
        add_tools(file.spec, settings.tools)
    if cfg.gravcomp is not None:
        for body in file.spec.bodies[1:]:  # the first is the world
            body.gravcomp = float(cfg.gravcomp)
    _unsimplify(file.spec, changes)
    notes += fixed_free_joints(cfg, file)

    root_start = None if keyframe is None else keyframe.root
    root = set_root(file.spec, cfg.fix_base, robot.planes, root_start)
    spec = root.spec
    notes += [f"{file.path}: {line}" for line in root.notes]
    model = compile_quietly(spec)
    placement = place(placed, _root_pose(model, root, keyframe))
    left_out = [*cfg.attachments, *tool_links(cfg)] if problems else []
    aliases, mistakes = resolve_aliases(cfg, frames_by_kind(model), left_out)
    problems += mistakes
    home = getattr(cfg, "home", None)
    if home is not None:
        mistakes = check_home(home)
        if not mistakes:
            qpos, mistakes = move_to_home(
                home,
                model,
                start_posture(model, qpos, keyframe),
                joints=[int(joint) for joint in movable_joints(model)],
                followers=[mimic.joint for mimic in mimics],
                aliases=aliases,
                root=root.name,
                placement=placement,
            )
        problems += [problem.below("home") for problem in mistakes]
    grippers = getattr(cfg, "grippers", {})
    problems += check_grippers(grippers, settings.parts, control_names(model))
    notes += starts_beyond_limits(file, joints, qpos)
    if isinstance(cfg, RobotCfg):  # an articulation may be a building
        notes += implausible_size(file.path, model, qpos)

    added_armature = np.zeros(len(names))
    rigidity = Rigidity.none(len(names))
    collision = SelfCollision()
    if not problems:
        origins = _origins(cfg, robot, root.name, settings.tools)
        posture = start_posture(model, qpos, keyframe)
        collision, mistakes, is_changed = set_self_collision(spec, model, cfg, origins, posture)
        problems += mistakes
        if is_changed:
            model = compile_quietly(spec)
    if step is not None and not problems:
        added_armature, lines = add_armature(
            spec, model, names, gains, mimics, qpos, settings.parts, step, changes
        )
        notes += [f"{file.path}: {line}" for line in lines]
        rigidity = make_couplings_rigid(
            spec, model, names, gains, mimics, qpos, joints.qvel_limits, step
        )
    if not problems and cfg.fix_base:
        notes += overloaded_drives(cfg, model, gains, qpos)

    # Damping ratios of servos become gains here: inertias may have changed.
    servos = ServoColumns.from_rows(read_servos(model, movable_joints(model)))
    has_servo = servos.drive >= 0
    uses_servo = has_servo & ~gains.driven
    armature = np.where(
        added_armature > 0, rounded(gains.armature + added_armature), gains.armature
    )
    shown = shown_mimics(mimics, robot.equalities, gains.driven | has_servo)
    init_ctrl, init_act = initial_controls(model, gains.driven, qpos, keyframe)
    passive_damping = np.array([joint.damping for joint in joints.rows], np.float64)
    return ParsedArticulation(
        uid=uid,
        cfg=cfg,
        path=file.path,
        spec=spec,
        model=model,
        joint_names=tuple(model.joint(i).name for i in movable_joints(model)),
        link_names=tuple(model.body(i).name for i in range(1, model.nbody)),
        root_link_name=root.name,
        placement=placement,
        fixed_base=cfg.fix_base,
        qpos_limits=joints.qpos_limits,
        qvel_limits=joints.qvel_limits,
        qf_limits=joints.qf_limits,
        zero_velocity=tuple(name for name in names if name in joints.limits.zero_velocity),
        init_qpos=qpos,
        init_qvel=np.zeros(len(qpos)) if keyframe is None else keyframe.qvel,
        stiffness=np.where(uses_servo, servos.stiffness, gains.stiffness),
        damping=np.where(uses_servo, servos.damping, gains.damping + rigidity.damping),
        joint_damping=passive_damping + rigidity.damping,
        carried_damping=rigidity.carried,
        max_effort=np.where(uses_servo, servos.max_effort, gains.max_effort),
        max_velocity=gains.max_velocity,
        friction=gains.friction,
        armature=armature,
        added_armature=added_armature,
        mimic_ids=tuple(mimic.joint for mimic in shown),
        mimic_parents=tuple(mimic.leader for mimic in shown),
        mimic_multipliers=tuple(mimic.slope for mimic in shown),
        mimic_offsets=tuple(mimic.offset for mimic in shown),
        aliases=aliases,
        control_parts=settings.parts,
        tools={part: tool.link for part, tool in settings.tools.items()},
        own_actuators=model.nactuator > int(gains.driven.sum()),
        driven=gains.driven,
        drives=_drive_names(model, drive_names, servos),
        servos=servos,
        control_names=control_names(model),
        ctrl_limits=_ctrl_limits(model, drive_names, joints.qpos_limits),
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
    )


def _drive_names(
    model: mujoco.MjModel, added: Sequence[str], servos: ServoColumns
) -> tuple[str, ...]:
    """Return the actuator that takes each joint's targets: the added drive, else the servo."""
    names: list[str] = []
    for name, servo in zip(added, servos.drive.tolist(), strict=True):
        if not name and servo >= 0:
            name = model.actuator(servo).name
        names.append(name)
    return tuple(names)


def _origins(
    cfg: ArticulationCfg, robot: RobotModel, root: str, tools: Mapping[str, Tool]
) -> LinkOrigins:
    """Return which file each link is from; the world of a file is the root, if one was added."""
    model = robot.model
    links = [model.body(i).name for i in range(model.nbody)]
    static: set[str] = set()
    if cfg.fix_base:
        static = {links[i] for i in np.flatnonzero(model.body_weldid == 0).tolist()}
        if root not in links:  # it was added
            static.add(root)
    tool_links = {tool.link for tool in tools.values() if tool.pose is not None}
    return LinkOrigins(robot.is_urdf, {*cfg.attachments, *tool_links}, static)


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


def _check_scale(cfg: ArticulationCfg) -> list[Problem]:
    scale = [float(factor) for factor in cfg.body_scale]
    if scale == [1.0, 1.0, 1.0]:
        return []
    return [Problem("body_scale", f"articulations cannot be scaled yet, got {scale}")]


def _control_parts(
    parts: Mapping[str, Sequence[str] | str] | None, names: Sequence[str]
) -> tuple[dict[str, tuple[int, ...]], list[Problem]]:
    """Return each part's joints, in the order of its patterns, each joint once."""
    joints_of: dict[str, tuple[int, ...]] = {}
    problems: list[Problem] = []
    for part, patterns in (parts or {}).items():
        path = f"control_parts.{part}"
        if isinstance(patterns, str):
            patterns = [patterns]
        if not patterns:
            message = f"names no joint; there are: {listing(names)}"
            problems.append(Problem(path, message))
        joints: list[int] = []
        for pattern in patterns:
            matching_joints, mistakes = match_every(pattern, names, "joint", path)
            problems += mistakes
            joints += matching_joints
        joints_of[part] = tuple(dict.fromkeys(joints))
    return joints_of, problems


def _by_joint(init_qpos: Any, names: Sequence[str]) -> Any:
    """Return a list with a value for each joint of the robot's own file as a map by joint.

    Attached files add joints: a list would be too short then.
    """
    is_list = isinstance(init_qpos, Sequence | np.ndarray)
    if not is_list or len(init_qpos) != len(names):
        return init_qpos
    return {exact_pattern(name): position for name, position in zip(names, init_qpos, strict=True)}


def _root_pose(model: mujoco.MjModel, root: Root, keyframe: Keyframe | None) -> F64:
    """Return (7,) the root's pose in the file's world at the start."""
    if keyframe is not None and keyframe.root is not None and not root.wrapped:
        return keyframe.root
    body = model.body(root.name)
    if body.jntnum[0]:
        column = int(model.jnt_qposadr[body.jntadr[0]])
        return np.array(model.qpos0[column : column + 7])
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
    is_limited = model.actuator_ctrllimited.astype(np.bool_)[:, None]
    limits: F64 = np.where(is_limited, model.actuator_ctrlrange, [-np.inf, np.inf])
    for name, joint_limits in zip(drives, qpos_limits, strict=True):
        if name:
            control = model.actuator_ctrladr[model.actuator(name).id]
            limits[control] = joint_limits
    return limits
