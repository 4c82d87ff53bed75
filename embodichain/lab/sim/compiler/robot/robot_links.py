"""A robot file made ready: its root, locked joints, visual and collision shapes, and added links.

A config adds shapes fixed on links (`attachments`) and tool points of control parts (`solver_cfg`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import mujoco
import numpy as np

from embodichain.lab.sim.cfg import (
    ArticulationCfg,
    AttachmentCfg,
    ObjectBaseCfg,
    RigidBodyAttributesCfg,
    SolverCfg,
)
from embodichain.lab.sim.compiler.geoms.contact_parameters import (
    ContactParameters,
    set_contact_parameters,
)
from embodichain.lab.sim.compiler.geoms.poses import check_pose, initial_pose
from embodichain.lab.sim.compiler.geoms.shape_geoms import (
    COLLISION_GROUP,
    HULL_VERTICES,
    VISUAL_GROUP,
    add_shape,
    check_geometry,
    keep_hull_inertia,
    set_collision,
)
from embodichain.lab.sim.compiler.index import F64
from embodichain.lab.sim.compiler.names import FrameKind, match, names_in_spec, no_such
from embodichain.lab.sim.compiler.robot.files.initial_state import Keyframe, read_keyframe
from embodichain.lab.sim.compiler.robot.files.joint_couplings import JointCoupling, read_couplings
from embodichain.lab.sim.compiler.robot.files.robot_files import ModelFile, compile_unlimited
from embodichain.lab.sim.compiler.robot.files.robot_joints import (
    FileJoints,
    hint_at_degrees,
    movable_joints,
    read_joints,
)
from embodichain.lab.sim.compiler.robot.files.spec_frames import on_frame
from embodichain.lab.sim.compiler.robot.floors import Plane, floors_of, planes_of
from embodichain.lab.sim.compiler.robot.kept_inertias import HullLimit, keep_inertias, limit_hulls
from embodichain.lab.sim.compiler.robot.robot_root import leave_out_lights, leave_out_sizes
from embodichain.lab.sim.shapes import PlaneCfg
from embodichain.utils.errors import Problem
from embodichain.utils.fields.defaults import is_given
from embodichain.utils.math import quat_multiply, quat_rotate, rotvec_to_quat

__all__ = [
    "WHOLE",
    "AttachedOptions",
    "RobotModel",
    "Tool",
    "add_attachments",
    "add_tools",
    "check_attachments",
    "lock_joints",
    "prepare_file",
    "resolve_tools",
    "tool_links",
]

AttachedOptions = tuple[str, mujoco.MjSpec, frozenset[str]]


@dataclass(frozen=True, eq=False)
class RobotModel:
    """A robot's file, with those attached to it, before drives and links of its config are added.

    Attributes:
        spec: The edited file; names of an attached file begin with ``NAME/``.
        model: The file's model, before it was edited.
        joints: Data of its joints.
        mimics: Joints that follow others, in URDF files.
        equalities: Joints that are coupled to others, in MJCF files.
        keyframe: Initial values that the file gives, or None.
        notes: Messages for the user, one line each.
        attached_options: Path of each attached file, an empty model with its physics options, which
            have no effect, and the names of those it gives.
        planes: Planes of the world of the robot's own file.
        floors: Its horizontal planes, in whose place the scene's ground is.
        attached_floors: Those of the attached files.
        hulls: Meshes whose convex hull is limited.
        is_urdf: Prefix of names of an attached file ("" is the robot's own) -> whether it is a
            URDF; else it is an MJCF.
    """

    spec: mujoco.MjSpec
    model: mujoco.MjModel
    joints: FileJoints
    mimics: tuple[JointCoupling, ...]
    equalities: tuple[JointCoupling, ...]
    keyframe: Keyframe | None
    notes: tuple[str, ...]
    attached_options: tuple[AttachedOptions, ...] = ()
    planes: Mapping[str, Plane] = field(default_factory=dict)
    floors: tuple[str, ...] = ()
    attached_floors: tuple[str, ...] = ()
    hulls: tuple[HullLimit, ...] = ()
    is_urdf: Mapping[str, bool] = field(default_factory=dict)


def prepare_file(file: ModelFile, attrs: RigidBodyAttributesCfg) -> RobotModel:
    """Read joints and keyframe of a file, and prepare its spec, which changes.

    Lights and keyframes are removed, hulls of meshes limited, and shapes are given groups and
    attributes. Masses and inertias stay those of the file.
    """
    spec = file.spec
    model = file.model
    urdf_joints = [joint.name for joint in spec.joints] if file.is_urdf else []
    joints = read_joints(model, file.limits, urdf_joints)
    mimics, equalities = read_couplings(model, joints.names, urdf_joints)
    keyframe = read_keyframe(spec, model)
    planes = planes_of(spec, model)

    lines = [*leave_out_lights(spec), *_unused_keyframes(spec, keyframe), *leave_out_sizes(spec)]
    for key in list(spec.keys):
        spec.delete(key)
    prepare_shapes(spec, attrs, file.is_urdf, planes)
    hulls = limit_hulls(spec, model)
    keep_inertias(spec, model, hulls)
    lines += _limited_hulls(hulls, file.is_urdf)
    return RobotModel(
        spec=spec,
        model=model,
        joints=joints,
        mimics=mimics,
        equalities=equalities,
        keyframe=keyframe,
        notes=(*file.notes, *(f"{file.path}: {line}" for line in lines)),
        planes=planes,
        floors=floors_of(planes),
        hulls=tuple(hulls),
        is_urdf={"": file.is_urdf},
    )


def _unused_keyframes(spec: mujoco.MjSpec, keyframe: Keyframe | None) -> list[str]:
    """Return a message about keyframes that are not used."""
    others = [repr(key.name) for key in spec.keys if keyframe is None or key.name != keyframe.name]
    if not others:
        return []
    used = keyframe.name if keyframe is not None else ""
    return [f"it starts at its keyframe {used!r}; left out: {', '.join(others)}"]


def _limited_hulls(hulls: Sequence[HullLimit], is_urdf: bool) -> list[str]:
    """Return a message about meshes whose hull is limited; `show` lists each."""
    if not hulls:
        return []
    largest = max(hulls, key=lambda hull: hull.vertices)
    message = (
        f"{len(hulls)} of its meshes collide as hulls of at most {HULL_VERTICES} vertices (the "
        f"largest, {largest.mesh!r}, has {largest.vertices})"
    )
    return [message if is_urdf else f"{message}; <mesh maxhullvert> sets another limit"]


def prepare_shapes(
    spec: mujoco.MjSpec,
    attrs: RigidBodyAttributesCfg,
    is_urdf: bool,
    planes: Collection[str] = (),
) -> None:
    """Set groups of visual and collision shapes, and apply a config's attributes.

    Planes of its world are not of the robot: attributes do not concern them.

    A URDF has no friction: `attrs.dynamic_friction` is used. An MJCF keeps its own unless that is
    given.
    """
    friction = attrs.dynamic_friction
    for geom in spec.geoms:
        if geom.name in planes:
            continue
        if is_urdf or is_given(friction):
            geom.friction[0] = float(friction)
        if not attrs.enable_collision:
            geom.contype = geom.conaffinity = 0
    for body in spec.bodies if is_urdf else ():
        # MuJoCo's URDF reader gives visual shapes no contact bits and group 1; collision shapes
        # that the config has switched off are recognized by group 0.
        geoms = list(body.geoms)
        has_visual_shapes = any(geom.group == 1 for geom in geoms)
        for geom in geoms:
            if geom.group == 1:
                geom.group = VISUAL_GROUP
            elif has_visual_shapes:  # else its collision shapes are what is drawn
                geom.group = COLLISION_GROUP


# ------------------------------------------------------------------------------------ locked joints


def lock_joints(file: ModelFile, locked: Mapping[str, float]) -> list[Problem]:
    """Remove joints of a URDF, whose links get the poses that they have at given positions.

    `file.spec` and `file.model` change; with a mistake they do not.

    Args:
        file: The robot's file.
        locked: Joint regex -> position, rad or m.

    Returns:
        Every mistake, with paths that begin with ``locked_joints``.
    """
    if not locked:
        return []
    if not file.is_urdf:
        message = "joints of an MJCF cannot be locked: remove them from the file"
        return [Problem("locked_joints", message)]
    model = file.model
    names = [model.joint(i).name for i in movable_joints(model)]
    coupled_joints: set[str] = set()
    for equality in file.spec.equalities:
        coupled_joints |= {equality.name1, equality.name2}
    positions: dict[str, float] = {}
    problems: list[Problem] = []
    for pattern, position in locked.items():
        path = f"locked_joints.{pattern}"
        matching_joints, mistakes = match(pattern, names, "joint", path)
        problems += mistakes
        for i in matching_joints:
            name = names[i]
            if name in positions:
                problems.append(Problem(path, f"another entry matches joint {name!r} too"))
            if name in coupled_joints:
                problems.append(Problem(path, f"joint {name!r} follows or leads another (mimic)"))
            positions[name] = position
            joint = model.joint(name)
            low, high = joint.range
            if joint.limited[0] and not low <= position <= high:
                message = f"{position:g} is outside the limits of joint {name!r}"
                is_hinge = joint.type[0] == mujoco.mjtJoint.mjJNT_HINGE
                hint = hint_at_degrees(position, low, high) if is_hinge else ""
                problems.append(Problem(path, f"{message}, [{low:g}, {high:g}]", hint))
    if problems:
        return problems
    for name, position in positions.items():
        _lock(file, name, position)
    file.model = compile_unlimited(file.spec)
    return []


def _lock(file: ModelFile, name: str, position: float) -> None:
    """Remove a joint; a URDF's has its origin in that of its link."""
    joint = file.model.joint(name)
    link = file.model.body(int(joint.bodyid[0]))
    pos = link.pos.copy()
    quat = link.quat.copy()
    if joint.type[0] == mujoco.mjtJoint.mjJNT_SLIDE:
        pos += quat_rotate(quat, joint.axis * position)
    else:
        quat = quat_multiply(quat, rotvec_to_quat(joint.axis * position))
    body = file.spec.body(link.name)
    body.pos = pos
    body.quat = quat
    file.spec.delete(file.spec.joint(name))


# ---------------------------------------------------------------------------------------- additions

WHOLE = "default"
"""EmbodiChain's name for the whole robot as a part."""
_UNSCALED = np.ones(3)


def check_attachments(
    spec: mujoco.MjSpec, attachments: Mapping[str, AttachmentCfg]
) -> list[Problem]:
    """Return every mistake, with paths in the articulation's config; `spec` is the file's."""
    problems: list[Problem] = []
    links = names_in_spec(spec, "link")
    for name, cfg in attachments.items():
        path = f"attachments.{name}"
        if name in links:
            problems.append(Problem(path, "the file has a link of that name already"))
        mistakes = _check_carrier(spec, cfg)
        if isinstance(cfg.shape, PlaneCfg):
            mistakes.append(Problem("shape", "a Plane cannot move"))
        mistakes += check_geometry(cfg.shape, _UNSCALED)
        mistakes += check_pose(cfg)
        has_friction = cfg.contact is not None and cfg.contact.friction is not None
        if has_friction and is_given(cfg.dynamic_friction):
            message = "dynamic_friction is given as well: leave one of them out"
            mistakes.append(Problem("contact.friction", message))
        problems += [problem.below(path) for problem in mistakes]
    return problems


def _carrier(cfg: AttachmentCfg) -> dict[FrameKind, str]:
    """Return what an attachment says it is fixed on, by kind; a checked one has one entry."""
    carriers: dict[FrameKind, str | None] = {"link": cfg.link, "site": cfg.site, "geom": cfg.geom}
    return {kind: name for kind, name in carriers.items() if name}


def _check_carrier(spec: mujoco.MjSpec, cfg: AttachmentCfg) -> list[Problem]:
    carriers = _carrier(cfg)
    if len(carriers) > 1:
        first, second = list(carriers)[:2]
        return [Problem(second, f"{first} is given as well: leave one of them out")]
    kind: FrameKind = next(iter(carriers), "link")
    name = carriers.get(kind, "")
    names = names_in_spec(spec, kind)
    if name in names:
        return []
    return [no_such(kind, name, names or ("none",), kind)]


def add_attachments(spec: mujoco.MjSpec, attachments: Mapping[str, AttachmentCfg]) -> None:
    """Add a body with one geom per checked attachment, as a child of its link."""
    for number, (name, cfg) in enumerate(attachments.items()):
        kind, carrier = next(iter(_carrier(cfg).items()))
        link, pos, quat = on_frame(spec, kind, carrier, *initial_pose(cfg))
        body = spec.body(link).add_body(name=name, pos=pos, quat=quat)
        geom = add_shape(spec, body, name, cfg.shape, _UNSCALED, number)
        geom.mass = float(cfg.mass)
        defaults = ContactParameters(friction=(float(cfg.dynamic_friction),))
        contact = ContactParameters.of_config(cfg.contact).over(defaults)
        set_contact_parameters(body.geoms, contact)
        set_collision(body.geoms, cfg.enable_collision)
        keep_hull_inertia(spec, body)


@dataclass(frozen=True)
class Tool:
    """The tool point of a part.

    Attributes:
        kind: Whether it is fixed on a link or on a site.
        end: That link or site.
        link: The link that is the tool point.
        pose: Its position (3,) in metres and wxyz orientation in the frame of `end`; None is that
            link's own frame.
    """

    kind: FrameKind
    end: str
    link: str
    pose: tuple[F64, F64] | None


def resolve_tools(
    cfg: ArticulationCfg, parts: Collection[str], links: Sequence[str], sites: Sequence[str]
) -> tuple[dict[str, Tool], list[Problem]]:
    """Return the tool point of each part that `solver_cfg` gives one, and every mistake.

    Args:
        cfg: The articulation's config.
        parts: Its control parts.
        links: The links of its file.
        sites: The sites of its file.
    """
    solvers = _solvers(cfg)
    tools: dict[str, Tool] = {}
    problems: list[Problem] = []
    for part, solver in solvers.items():
        path = f"solver_cfg.{part}"
        if part not in parts and part != WHOLE:
            problems.append(no_such("control part", part, [*parts, WHOLE], path))
        tool, mistakes = _resolve_tool(part, solver, links, sites)
        problems += [problem.below(path) for problem in mistakes]
        if tool is not None:
            tools[part] = tool
    return tools, problems


def tool_links(cfg: ArticulationCfg) -> list[str]:
    """Return the names of the links that tool points of a config add, where nothing is wrong."""
    return [_tool_link(part) for part in _solvers(cfg)]


def _solvers(cfg: ArticulationCfg) -> Mapping[str, SolverCfg]:
    """Return control part -> its solver; `WHOLE` for that of the whole robot."""
    solver_cfg = getattr(cfg, "solver_cfg", None) or {}
    return {WHOLE: solver_cfg} if isinstance(solver_cfg, SolverCfg) else solver_cfg


def _tool_link(part: str) -> str:
    return "tcp" if part == WHOLE else f"{part}_tcp"


def _resolve_tool(
    part: str, solver: SolverCfg, links: Sequence[str], sites: Sequence[str]
) -> tuple[Tool | None, list[Problem]]:
    """Return the tool point of one part; None if its solver names none."""
    problems = list(_check_ends(solver, links, sites))
    pose: tuple[F64, F64] | None = None
    if solver.tcp is not None and not np.array_equal(np.asarray(solver.tcp), np.eye(4)):
        tcp = ObjectBaseCfg(init_local_pose=solver.tcp)
        mistakes = check_pose(tcp)
        problems += [Problem("tcp", problem.message) for problem in mistakes]
        if not mistakes:
            pose = initial_pose(tcp)

    name = _tool_link(part)
    if solver.end_site_name is not None:
        # A site is not a link: a link is added at it even without a pose.
        if pose is None:
            pose = np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
        tool = Tool("site", solver.end_site_name, name, pose)
        key = "end_site_name"
    elif solver.end_link_name is not None:
        link = solver.end_link_name if pose is None else name
        tool = Tool("link", solver.end_link_name, link, pose)
        key = "tcp"
    else:
        if pose is not None:
            message = "missing value: tcp is a pose in the frame of this link"
            problems.append(Problem("end_link_name", message))
        return None, problems
    if tool.pose is not None and name in links:
        problems.append(Problem(key, f"the file has a link called {name!r} already"))
    return tool, problems


def _check_ends(solver: SolverCfg, links: Sequence[str], sites: Sequence[str]) -> Iterator[Problem]:
    """Yield what is wrong with the links and the site that a solver names."""
    for key in ("root_link_name", "end_link_name"):
        name = getattr(solver, key)
        if name is None or name in links:
            continue
        problem = no_such("link", name, links, key)
        if key == "end_link_name" and name in sites:
            hint = f"A site is called so: write end_site_name: {name}."
            problem = dataclasses.replace(problem, hint=hint)
        yield problem
    if solver.end_site_name is None:
        return
    if solver.end_link_name is not None:
        yield Problem("end_site_name", "end_link_name is given as well: leave one of them out")
    if solver.end_site_name not in sites:
        yield no_such("site", solver.end_site_name, sites or ("none",), "end_site_name")


def add_tools(spec: mujoco.MjSpec, tools: Mapping[str, Tool]) -> None:
    """Add a massless body for each tool point that differs from a link's frame."""
    for tool in tools.values():
        if tool.pose is not None:
            link, pos, quat = on_frame(spec, tool.kind, tool.end, *tool.pose)
            spec.body(link).add_body(name=tool.link, pos=pos, quat=quat)
