"""`read_robot`: one file, or several URDF files as one model, by EmbodiChain's rules."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import mujoco
import numpy as np

from embodichain.lab.sim.cfg import ArticulationCfg
from embodichain.lab.sim.compiler.index import F64
from embodichain.lab.sim.compiler.model_files import ModelFile, compile_quietly, locate, read_model
from embodichain.lab.sim.urdf_cfg import COMPONENTS, URDFCfg
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.math import matrix_to_quat
from embodichain.utils.suggest import did_you_mean

__all__ = ["attach", "read_robot"]


def attach(
    parent: mujoco.MjSpec,
    child: mujoco.MjSpec,
    link: str,
    pos: F64,
    quat: F64,
    prefix: str,
) -> None:
    """Fix a model's world on a link.

    Args:
        parent: Grows by the child's bodies, joints, shapes, assets, equalities and actuators.
        child: A copy of it is used; it stays as it is.
        link: A body of the parent.
        pos: (3,) metres, the child's world in the link's frame.
        quat: (4,) wxyz, likewise.
        prefix: Before every name of the child; no name of the parent may begin with it.

    Raises:
        ValueError: If the parent has no such link.
    """
    body = parent.body(link)
    if body is None:
        raise ValueError(f"no link is called {link!r}")
    parent.attach(child.copy(), frame=body.add_frame(pos=pos, quat=quat), prefix=prefix)


_ON_FIRST = ("chassis", "head", "left_hand", "right_hand", "hand")
"""Components that carry others on their first link; the rest on the last one of the file."""
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
"""Component -> what carries it: the first of these that is there, else the base."""
_SEPARATOR = ":"  # between a component and its names while it is attached


def read_robot(cfg: ArticulationCfg) -> ModelFile:
    """Read the file of an articulation, or the files of a robot with a `urdf_cfg`.

    Raises:
        ConfigError: If a file is missing or malformed, or a component is wrong; problems of
            components have paths that begin with ``urdf_cfg``.
    """
    urdf: URDFCfg | None = getattr(cfg, "urdf_cfg", None)
    convex_parts = cfg.collision == "decompose"
    if urdf is None:
        return read_model(locate(cfg.fpath), convex_parts)
    if cfg.fpath:
        file = read_model(locate(cfg.fpath), convex_parts)
        file.notes.append("urdf_cfg has no effect: fpath names the robot's file")
        return file
    return _assemble(urdf, convex_parts)


def _assemble(cfg: URDFCfg, convex_parts: bool) -> ModelFile:
    files, problems = _read(cfg, convex_parts)
    transforms, wrong = _transforms(cfg)
    problems += wrong
    if problems:
        raise ConfigError(problems)
    if len(files) == 1:
        (file,) = files.values()
        if cfg.parts()[0].transform is not None:
            file.notes.append("transform of the only component has no effect: use init_pos")
        return file
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.compiler.fusestatic = False  # links of fixed joints keep their bodies
    spec.worldbody.add_body(name=cfg.base_link_name)
    carrying: dict[str, str] = {}
    links, joints = {cfg.base_link_name: cfg.base_link_name}, dict[str, str]()
    velocity: dict[str, float] = {}
    for kind, prefix in cfg.prefixes().items():
        if kind not in files:
            continue
        file = files[kind]
        own_links = [body.name for body in file.spec.bodies[1:]]  # the first is the world
        own_joints = [joint.name for joint in file.spec.joints]
        carrier = next((c for c in _CARRIERS.get(kind, ()) if c in files), None)
        on = cfg.base_link_name if carrier is None else carrying[carrier]
        pos, quat = transforms[kind]
        attach(spec, file.spec, on, pos, quat, f"{kind}{_SEPARATOR}")
        new_links = _link_names(own_links, kind, prefix, cfg, set(links.values()))
        new_joints = _joint_names(own_joints, prefix, cfg, set(joints.values()))
        links |= {f"{kind}{_SEPARATOR}{old}": new for old, new in new_links.items()}
        joints |= {f"{kind}{_SEPARATOR}{old}": new for old, new in new_joints.items()}
        velocity |= {new_joints[old]: v for old, v in file.velocity_limits.items()}
        last = own_links[0] if kind in _ON_FIRST else file.last_link
        carrying[kind] = f"{kind}{_SEPARATOR}{last}"
    _rename(spec, links, joints)
    path = next(iter(files.values())).path
    notes = [note for file in files.values() for note in file.notes]
    return ModelFile(path, True, spec, compile_quietly(spec), velocity, notes=notes)


def _read(cfg: URDFCfg, convex_parts: bool) -> tuple[dict[str, ModelFile], list[Problem]]:
    """The files by component, and what is wrong with them."""
    files: dict[str, ModelFile] = {}
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
        try:
            file = read_model(locate(part.urdf_path), convex_parts)
        except ConfigError as error:
            problems += [Problem(f"{path}.urdf_path", str(p)) for p in error.problems]
            continue
        if not file.is_urdf and len(parts) > 1:
            problems.append(Problem(f"{path}.urdf_path", f"{file.path} is no URDF"))
        files.setdefault(kind, file)
    return files, problems


def _transforms(cfg: URDFCfg) -> tuple[dict[str, tuple[F64, F64]], list[Problem]]:
    """Position and wxyz quaternion of each component in its carrier."""
    found: dict[str, tuple[F64, F64]] = {}
    problems: list[Problem] = []
    for number, part in enumerate(cfg.parts()):
        matrix = _matrix(part.transform)
        if matrix is None:
            path = f"urdf_cfg.components.{number}.transform"
            message = f"expected a 4x4 pose (rotation, position), got {part.transform!r}"
            problems.append(Problem(path, message))
        else:
            found[part.component_type] = (matrix[:3, 3], matrix_to_quat(matrix[:3, :3]))
    return found, problems


def _matrix(value: Any) -> F64 | None:
    if value is None:
        return np.eye(4)
    try:
        matrix = np.asarray(value, np.float64)
    except (TypeError, ValueError):
        return None
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        return None
    turn = matrix[:3, :3]
    proper = np.allclose(turn @ turn.T, np.eye(3), atol=1e-4) and np.linalg.det(turn) > 0
    return matrix if proper and np.allclose(matrix[3], (0, 0, 0, 1)) else None


def _spelled(name: str, case: str | None) -> str:
    return name.upper() if case == "upper" else name.lower() if case == "lower" else name


def _prefixed(name: str, prefix: str) -> str:
    return name if name.lower().startswith(prefix.lower()) else f"{prefix}{name}"


def _link_names(
    names: Iterable[str], kind: str, prefix: str, cfg: URDFCfg, taken: set[str]
) -> dict[str, str]:
    """Old -> new. A name that is taken gets the component before it, or a number behind it."""
    found: dict[str, str] = {}
    for name in names:
        new = _spelled(_prefixed(name, prefix), cfg.name_case.get("link"))
        if new in taken and not prefix:
            new = _spelled(f"{kind}_{name}", cfg.name_case.get("link"))
        found[name] = _unused(new, taken)
        taken.add(found[name])
    return found


def _joint_names(
    names: Iterable[str], prefix: str, cfg: URDFCfg, taken: set[str]
) -> dict[str, str]:
    """Old -> new. A name that is taken gets a number behind it."""
    found: dict[str, str] = {}
    for name in names:
        new = _spelled(_prefixed(name, prefix), cfg.name_case.get("joint"))
        found[name] = _unused(new, taken)
        taken.add(found[name])
    return found


def _unused(name: str, taken: set[str]) -> str:
    number, found = 0, name
    while found in taken:
        number += 1
        found = f"{name}_{number}"
    return found


def _rename(spec: mujoco.MjSpec, links: dict[str, str], joints: dict[str, str]) -> None:
    """Rename bodies and joints, and joints in equalities: a URDF has no other references."""
    for body in spec.bodies[1:]:
        body.name = links[body.name]
    for joint in spec.joints:
        joint.name = joints[joint.name]
    for equality in spec.equalities:
        equality.name1 = joints[equality.name1]
        equality.name2 = joints[equality.name2]
