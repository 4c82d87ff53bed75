"""`parse_articulation`: makes a checked `ParsedArticulation` from a robot file and its config."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np

from embodichain.lab.sim.cfg import ArticulationCfg, RobotCfg, URDFCfg
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
from embodichain.lab.sim.compiler.robot.drives.couplings import (
    Rigidity,
    couple,
    shown_mimics,
)
from embodichain.lab.sim.compiler.robot.drives.pd_drives import (
    DriveChange,
    PhysicsStep,
    apply_drives,
    resolve_drives,
)
from embodichain.lab.sim.compiler.robot.files.robot_files import (
    MUJOCO_ERRORS,
    ModelFile,
    as_line,
    compile_quietly,
    locate,
    read_model,
)
from embodichain.lab.sim.compiler.robot.files.robot_joints import (
    Keyframe,
    control_names,
    initial_controls,
    movable_joints,
    read_servos,
    resolve_qpos,
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
)
from embodichain.lab.sim.compiler.robot.robot_notes import (
    driven_mimics,
    fixed_free_joints,
    overloaded_drives,
    starts_beyond_limits,
    without_effort,
)
from embodichain.lab.sim.compiler.robot.robot_root import Root, place, set_root
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
        notes += without_effort(cfg, joints, mimics)
        notes += driven_mimics(cfg, file, joints.names, mimics, parts)
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
        notes += fixed_free_joints(cfg, file)
        notes += starts_beyond_limits(file, joints, qpos)
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
            added, said = add_armature(
                spec, model, joints.names, gains, mimics, qpos, parts, step, changes
            )
            notes += [f"{file.path}: {note}" for note in said]
            rigidity = couple(
                spec, model, joints.names, gains, mimics, qpos, joints.qvel_limits, step
            )
        if not problems and cfg.fix_base:
            notes += overloaded_drives(cfg, model, gains, qpos)
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
            armature=np.where(added > 0, rounded(gains.armature + added), gains.armature),
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
            matched, wrong = match_every(pattern, names, "joint", f"control_parts.{part}")
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
        return model.qpos0[at : at + 7].copy()
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
