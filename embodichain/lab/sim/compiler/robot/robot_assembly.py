"""Several files as one robot: `assemble` by EmbodiChain's rules, `attach_files` by name."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace

import mujoco
import numpy as np

from embodichain.lab.sim.cfg import AttachedFileCfg, ObjectBaseCfg
from embodichain.lab.sim.compiler.geoms.poses import check_pose, initial_pose
from embodichain.lab.sim.compiler.index import F64
from embodichain.lab.sim.compiler.names import find_in_spec
from embodichain.lab.sim.compiler.robot.contacts.contact_patterns import (
    apply_contacts,
    check_contacts,
)
from embodichain.lab.sim.compiler.robot.files.initial_state import Keyframe, resolve_qpos
from embodichain.lab.sim.compiler.robot.files.joint_couplings import read_couplings
from embodichain.lab.sim.compiler.robot.files.robot_files import (
    MUJOCO_ERRORS,
    ModelFile,
    as_line,
    compile_quietly,
    compile_unlimited,
    locate,
    read_model,
)
from embodichain.lab.sim.compiler.robot.files.robot_joints import read_joints
from embodichain.lab.sim.compiler.robot.files.spec_frames import on_frame
from embodichain.lab.sim.compiler.robot.files.urdf_reading import UrdfLimits
from embodichain.lab.sim.compiler.robot.floors import move_to_world, without_references
from embodichain.lab.sim.compiler.robot.robot_links import (
    AttachedOptions,
    RobotModel,
    prepare_file,
)
from embodichain.lab.sim.compiler.robot.robot_root import (
    bind_to_body,
    remove_free_joint,
    take_sizes,
)
from embodichain.lab.sim.configs.urdf_cfg import COMPONENTS, URDFCfg
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean

__all__ = ["assemble", "attach", "attach_files"]

_ON_FIRST = ("chassis", "head", "left_hand", "right_hand", "hand")
"""Components with children on their first link; the others have them on the file's last link."""
_CARRIERS = {
    "legs": ("chassis",),
    "torso": ("legs", "chassis"),
    "head": ("torso", "chassis"),
    "left_arm": ("torso", "chassis"),
    "right_arm": ("torso", "chassis"),
    "arm": ("torso", "chassis"),
    "left_hand": ("left_arm",),
    "right_hand": ("right_arm",),
    "hand": ("arm",),
}
"""Component -> its parent: the first of these that exists, else the base."""
_SEPARATOR = ":"  # between a component and its names while it is attached


def attach(
    parent: mujoco.MjSpec, child: mujoco.MjSpec, link: str, pos: F64, quat: F64, prefix: str
) -> None:
    """Fix a model's world on a link.

    Args:
        parent: Receives the child's bodies, joints, shapes, assets, equalities and actuators.
        child: Is copied; it does not change.
        link: A body of the parent.
        pos: (3,) metres, the child's world in the link's frame.
        quat: (4,) wxyz, in the link's frame.
        prefix: Prefix of the child's names; no name of the parent may begin with it.

    Raises:
        ValueError: If the parent has no such link.
    """
    body = parent.body(link)
    if body is None:
        raise ValueError(f"no link is called {link!r}")
    parent.attach(child.copy(), frame=body.add_frame(pos=pos, quat=quat), prefix=prefix)


def assemble(cfg: URDFCfg, convex_parts: bool) -> ModelFile:
    """Read the files of a robot and assemble them.

    Raises:
        ConfigError: If a file is missing or malformed, or a component is wrong; paths begin with
            ``urdf_cfg``.
    """
    files, transforms = _read(cfg, convex_parts)
    if len(files) == 1:
        (file,) = files.values()
        if cfg.parts()[0].transform is not None:
            file.notes.append("transform of the only component has no effect: use init_pos")
        return file
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.compiler.fusestatic = False  # links of fixed joints keep their bodies
    spec.worldbody.add_body(name=cfg.base_link_name)
    # Names while the files are attached -> final names.
    links: dict[str, str] = {cfg.base_link_name: cfg.base_link_name}
    joints: dict[str, str] = {}
    carrying_link: dict[str, str] = {}  # component -> the link on which its children are
    limits = UrdfLimits()
    for kind, prefix in cfg.prefixes().items():
        if kind not in files:
            continue
        file = files[kind]
        own_links = [body.name for body in file.spec.bodies[1:]]  # the first is the world
        own_joints = [joint.name for joint in file.spec.joints]
        carrier = next((c for c in _CARRIERS.get(kind, ()) if c in files), None)
        parent_link = cfg.base_link_name if carrier is None else carrying_link[carrier]
        pos, quat = transforms[kind]
        attach(spec, file.spec, parent_link, pos, quat, prefix=f"{kind}{_SEPARATOR}")
        case = cfg.name_case
        new_links = _renamed(own_links, prefix, kind, case.get("link"), set(links.values()))
        new_joints = _renamed(own_joints, prefix, "", case.get("joint"), set(joints.values()))
        links |= {f"{kind}{_SEPARATOR}{old}": new for old, new in new_links.items()}
        joints |= {f"{kind}{_SEPARATOR}{old}": new for old, new in new_joints.items()}
        limits = limits.joined(file.limits.renamed(new_joints))
        carrier_link = own_links[0] if kind in _ON_FIRST else file.last_link
        carrying_link[kind] = f"{kind}{_SEPARATOR}{carrier_link}"
    # The only references in a URDF are mimics, which are equalities.
    for body in spec.bodies[1:]:
        body.name = links[body.name]
    for joint in spec.joints:
        joint.name = joints[joint.name]
    for equality in spec.equalities:
        equality.name1 = joints[equality.name1]
        equality.name2 = joints[equality.name2]
    path = next(iter(files.values())).path
    notes = [note for file in files.values() for note in file.notes]
    return ModelFile(path, True, spec, compile_unlimited(spec), limits, notes=notes)


def _read(
    cfg: URDFCfg, convex_parts: bool
) -> tuple[dict[str, ModelFile], dict[str, tuple[F64, F64]]]:
    """Files by component, and position and wxyz quaternion of each in its parent's frame."""
    files: dict[str, ModelFile] = {}
    transforms: dict[str, tuple[F64, F64]] = {}
    problems: list[Problem] = []
    parts = cfg.parts()
    if not parts:
        problems.append(Problem("urdf_cfg.components", "a robot has at least one component"))
    if cfg.sensors:
        problems.append(Problem("urdf_cfg.sensors", "not available: declare sensors of their own"))
    for number, part in enumerate(parts):
        kind, path = part.component_type, f"urdf_cfg.components.{number}"
        if kind not in COMPONENTS and len(parts) > 1:
            message = f"unknown component {kind!r}; allowed: {', '.join(COMPONENTS)}"
            hint = did_you_mean(kind, COMPONENTS).strip()
            problems.append(Problem(f"{path}.component_type", message, hint))
        elif kind in files:
            problems.append(Problem(f"{path}.component_type", f"another component is {kind!r}"))
        pose = ObjectBaseCfg(init_local_pose=part.transform)
        if check_pose(pose):
            message = f"expected a 4x4 pose (rotation, position), got {part.transform!r}"
            problems.append(Problem(f"{path}.transform", message))
        else:
            transforms[kind] = initial_pose(pose)
        try:
            file = read_model(locate(part.urdf_path), convex_parts)
        except ConfigError as error:
            problems += [Problem(f"{path}.urdf_path", str(p)) for p in error.problems]
            continue
        if not file.is_urdf and len(parts) > 1:
            message = f"{file.path} is not a URDF: see attach"
            problems.append(Problem(f"{path}.urdf_path", message))
        files.setdefault(kind, file)
    if problems:
        raise ConfigError(problems)
    return files, transforms


def _renamed(
    names: Iterable[str], prefix: str, kind: str, case: str | None, used_names: set[str]
) -> dict[str, str]:
    """Map old to new names. A used name gets the prefix `kind`, if there is one, else a number.

    Names that are chosen are added to `used_names`.
    """

    def in_case(name: str) -> str:
        if case == "upper":
            return name.upper()
        if case == "lower":
            return name.lower()
        return name

    new_names: dict[str, str] = {}
    for name in names:
        has_prefix = name.lower().startswith(prefix.lower())
        new_name = in_case(name if has_prefix else f"{prefix}{name}")
        if new_name in used_names and kind and not prefix:
            new_name = in_case(f"{kind}_{name}")
        base = new_name
        number = 0
        while new_name in used_names:
            number += 1
            new_name = f"{base}_{number}"
        new_names[name] = new_name
        used_names.add(new_name)
    return new_names


# ----------------------------------------------------------------------------------- attached files


def attach_files(
    robot: RobotModel, attached: Mapping[str, AttachedFileCfg]
) -> tuple[RobotModel, list[Problem]]:
    """Fix files on links of a robot.

    Everything in a file is kept, except for its lights and planes, a free joint, physics options
    and keyframes (one gives initial values).

    Args:
        robot: The robot's own file; its spec changes.
        attached: Name -> file, in order; a later one may be fixed on a link of an earlier one.

    Returns:
        The robot without the files that are wrong, and every mistake, with paths that begin with
        ``attach``.

    Raises:
        ConfigError: If MuJoCo refuses the whole.
    """
    spec = robot.spec
    problems: list[Problem] = []
    parts = {"": robot}  # prefix of names -> the file; the robot's own has none
    urdf_joints = {joint.name for joint in robot.joints.rows if joint.is_urdf}
    attached_options: list[AttachedOptions] = []
    limits = robot.joints.limits
    notes = [*robot.notes]
    for name, cfg in attached.items():
        mistakes, file = _check(name, cfg, spec)
        if file is None or mistakes:
            problems += mistakes
            continue
        prefix = f"{name}/"
        part = prepare_file(file, cfg.attrs)
        parts[prefix] = part
        contact_mistakes = check_contacts(file.spec, cfg.contact)
        problems += [problem.below(f"attach.{name}") for problem in contact_mistakes]
        if not contact_mistakes:
            apply_contacts(file.spec, cfg.contact)
        notes += part.notes
        notes += _loosen(file)
        notes += _without_walls(file, part)
        urdf_joints |= {f"{prefix}{joint.name}" for joint in part.joints.rows if joint.is_urdf}
        new_names = {joint: f"{prefix}{joint}" for joint in part.joints.names}
        limits = limits.joined(file.limits.renamed(new_names))
        options = mujoco.MjSpec()
        options.option = file.spec.option
        attached_options.append((f"{file.path} (attach.{name})", options, file.options))
        # The scene's options apply: MuJoCo would warn about each that differs.
        file.spec.option = spec.option
        _attach_part(spec, file, part, cfg, prefix)
    try:
        model = compile_quietly(spec)
    except MUJOCO_ERRORS as error:
        raise ConfigError([Problem("attach", as_line(error)[0])]) from error
    return _joined_model(
        robot, model, parts, urdf_joints, limits, notes, attached_options
    ), problems


def _attach_part(
    spec: mujoco.MjSpec, file: ModelFile, part: RobotModel, cfg: AttachedFileCfg, prefix: str
) -> None:
    """Fix a file on its link, with its equalities and floors."""
    frame, _ = find_in_spec(spec, cfg.to, "")
    if frame is None:
        raise RuntimeError(f"{cfg.to!r} was found before")
    link, pos, quat = on_frame(spec, *frame, *initial_pose(_pose(cfg)))
    take_sizes(spec, file.spec)
    equality_count = len(spec.equalities)
    attach(spec, file.spec, link, pos, quat, prefix)
    bind_to_body(list(spec.equalities)[equality_count:], link, pos, quat)
    for plane in part.floors:  # planes cannot move; the scene's ground takes their place
        move_to_world(spec, f"{prefix}{plane}", *part.planes[plane])


def _joined_model(
    robot: RobotModel,
    model: mujoco.MjModel,
    parts: Mapping[str, RobotModel],
    urdf_joints: Collection[str],
    limits: UrdfLimits,
    notes: Sequence[str],
    attached_options: Sequence[AttachedOptions],
) -> RobotModel:
    """Return a robot with its attached files as one."""
    prefixes = tuple(prefix for prefix in parts if prefix)
    joints = read_joints(model, limits, urdf_joints, prefixes)
    mimics, equalities = read_couplings(model, joints.names, urdf_joints)
    attached_floors: list[str] = []
    hulls = [*robot.hulls]
    for prefix in prefixes:
        part = parts[prefix]
        attached_floors += [f"{prefix}{plane}" for plane in part.floors]
        hulls += [replace(hull, mesh=f"{prefix}{hull.mesh}") for hull in part.hulls]
    return RobotModel(
        spec=robot.spec,
        model=model,
        joints=joints,
        mimics=mimics,
        equalities=equalities,
        keyframe=_joined_keyframe(parts, joints.names),
        notes=tuple(dict.fromkeys(notes)),  # two grippers of one file say the same
        attached_options=tuple(attached_options),
        planes=robot.planes,
        floors=robot.floors,
        attached_floors=tuple(attached_floors),
        hulls=tuple(hulls),
        is_urdf={prefix: part.is_urdf[""] for prefix, part in parts.items()},
    )


def _check(
    name: str, cfg: AttachedFileCfg, robot: mujoco.MjSpec
) -> tuple[list[Problem], ModelFile | None]:
    """Return what is wrong with an entry, and the file if it can be read."""
    path, problems = f"attach.{name}", list[Problem]()
    links = [body.name for body in robot.bodies[1:]]  # the first is the world
    if not name.strip() or "/" in name:
        problems.append(Problem(path, f"the name {name!r} must be a word without '/'"))
    elif any(link.startswith(f"{name}/") for link in links):
        problems.append(Problem(path, f"links of the robot are named {name}/... already"))
    if not cfg.to:
        problems.append(
            Problem(f"{path}.to", f"missing value: a link; there are: {', '.join(links)}")
        )
    else:
        problems += find_in_spec(robot, cfg.to, f"{path}.to")[1]
    wrong = check_pose(_pose(cfg))
    problems += [replace(p, path=f"{path}.{p.path.removeprefix('init_')}") for p in wrong]
    try:
        file = read_model(locate(cfg.fpath), cfg.collision == "decompose")
    except ConfigError as error:
        return [*problems, *(Problem(f"{path}.fpath", str(p)) for p in error.problems)], None
    return problems, file


def _pose(cfg: AttachedFileCfg) -> ObjectBaseCfg:
    return ObjectBaseCfg(init_pos=cfg.pos, init_rot=cfg.rot, init_quat=cfg.quat)


def _loosen(file: ModelFile) -> list[str]:
    """Remove free joints and mocap flags, which an attached file cannot have."""
    notes: list[str] = []
    for body in file.spec.worldbody.bodies:
        free = [joint for joint in body.joints if joint.type == mujoco.mjtJoint.mjJNT_FREE]
        if free or body.mocap:
            notes.append(f"{file.path}: its free body {body.name!r} is fixed on the robot's link")
        for joint in free:
            left_out = remove_free_joint(file.spec, joint)
            if left_out:
                notes.append(f"{file.path}: left out with its free joint: {', '.join(left_out)}")
        body.mocap = False
    return notes


def _without_walls(file: ModelFile, part: RobotModel) -> list[str]:
    """Remove planes that are not floors, and what names them: planes cannot move."""
    walls = [plane for plane in part.planes if plane not in part.floors]
    removed = without_references(file.spec, walls)
    for wall in walls:
        file.spec.delete(file.spec.geom(wall))
    names = ", ".join([*(f"plane {wall!r}" for wall in walls), *removed])
    return [f"{file.path}: left out, for a plane cannot move: {names}"] if walls else []


def _joined_keyframe(parts: Mapping[str, RobotModel], names: tuple[str, ...]) -> Keyframe | None:
    """Return the initial values of all files as one keyframe; None if none has one.

    Args:
        parts: Prefix of names -> the file; the robot's own has none.
        names: (D,) joints of all files, in the order of the keyframe's arrays.
    """
    keyframes = {
        prefix: part.keyframe for prefix, part in parts.items() if part.keyframe is not None
    }
    if not keyframes:
        return None
    qpos: dict[str, float] = {}
    qvel: dict[str, float] = {}
    for prefix, part in parts.items():
        positions, _ = resolve_qpos(None, part.joints, part.mimics, part.keyframe, part.equalities)
        velocities = np.zeros(len(positions)) if part.keyframe is None else part.keyframe.qvel
        for name, position, velocity in zip(part.joints.names, positions, velocities, strict=True):
            qpos[f"{prefix}{name}"] = position
            qvel[f"{prefix}{name}"] = velocity
    own = keyframes.get("")
    joined = Keyframe(
        name=next(iter(keyframes.values())).name,
        qpos=np.array([qpos[name] for name in names]),
        qvel=np.array([qvel[name] for name in names]),
        root=None if own is None else own.root,
        root_qvel=np.zeros(6) if own is None else own.root_qvel,
    )
    for prefix, keyframe in keyframes.items():
        joined.balls.update({f"{prefix}{name}": pose for name, pose in keyframe.balls.items()})
        joined.ctrl.update({f"{prefix}{name}": ctrl for name, ctrl in keyframe.ctrl.items()})
        joined.act.update({f"{prefix}{name}": act for name, act in keyframe.act.items()})
    return joined
