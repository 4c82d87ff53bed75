"""`physics_values`: the values of a compiled model that affect physics, by element and field.

They serve to compare two models and name the differences. Visual geoms, colours, textures, lights,
cameras, indices and values that MuJoCo derives are left out. Elements are identified by name.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

__all__ = ["DESCRIBED", "Element", "physics_values"]

Element = dict[str, Any]
"""Field -> value: a number, a list of numbers, or the name of another element."""

_OBJ = mujoco.mjtObj
_TRN = mujoco.mjtTrn
_DIGITS = 9
_MESH, _HFIELD = int(mujoco.mjtGeom.mjGEOM_MESH), int(mujoco.mjtGeom.mjGEOM_HFIELD)


@dataclass(frozen=True, slots=True)
class _Kind:
    """One kind of elements: its name, and its arrays by prefix and field."""

    word: str
    obj: mujoco.mjtObj
    count: str
    prefix: str
    fields: tuple[str, ...]
    body: str = ""
    """The array with the element's body, if there is one."""


def _words(text: str) -> tuple[str, ...]:
    return tuple(text.split())


_KINDS = (
    _Kind("body", _OBJ.mjOBJ_BODY, "nbody", "body", _words("pos quat mass ipos gravcomp")),
    _Kind(
        "joint",
        _OBJ.mjOBJ_JOINT,
        "njnt",
        "jnt",
        _words(
            "type pos axis limited range margin solref solimp stiffness stiffnesspoly springyield"
            " actfrclimited actfrcrange actgravcomp"
        ),
        "jnt_bodyid",
    ),
    _Kind(
        "geom",
        _OBJ.mjOBJ_GEOM,
        "ngeom",
        "geom",
        _words(
            "type size pos quat contype conaffinity condim priority friction solmix solref solimp"
            " margin gap adhesion surfacevel fluid"
        ),
        "geom_bodyid",
    ),
    _Kind("site", _OBJ.mjOBJ_SITE, "nsite", "site", _words("type size pos quat"), "site_bodyid"),
    _Kind(
        "tendon",
        _OBJ.mjOBJ_TENDON,
        "ntendon",
        "tendon",
        _words(
            "type limited range margin stiffness stiffnesspoly springyield damping dampingpoly"
            " frictionloss armature lengthspring actfrclimited actfrcrange solref_lim solimp_lim"
            " solref_fri solimp_fri"
        ),
    ),
    _Kind(
        "actuator",
        _OBJ.mjOBJ_ACTUATOR,
        "nactuator",
        "actuator",
        _words(
            "trntype gaintype gainprm biastype biasprm dyntype dynprm gear ctrllimited ctrlrange"
            " ctrlspec ctrlnum forcelimited forcerange actlimited actrange actearly actnum"
            " cranklength lengthrange armature damping dampingpoly delay history"
        ),
    ),
    _Kind("equality", _OBJ.mjOBJ_EQUALITY, "neq", "eq", _words("type data active0 solref solimp")),
    _Kind(
        "pair",
        _OBJ.mjOBJ_PAIR,
        "npair",
        "pair",
        _words("dim friction margin gap adhesion solref solreffriction solimp"),
    ),
    _Kind(
        "sensor",
        _OBJ.mjOBJ_SENSOR,
        "nsensor",
        "sensor",
        _words("type dim cutoff noise delay history interval intprm"),
    ),
    _Kind(
        "flex",
        _OBJ.mjOBJ_FLEX,
        "nflex",
        "flex",
        _words(
            "dim contype conaffinity condim priority friction solmix solref solimp margin gap"
            " radius size damping edgestiffness edgedamping edgeequality rigid centered"
            " selfcollide activelayers passive interp yield plasticmode vertnum elemnum edgenum"
        ),
    ),
)
_DOF = _words("armature damping dampingpoly frictionloss solref solimp")
_POOLED = {
    "flex": ("flex_vert0", "flex_node0", "flex_stiffness", "flex_bending", "flex_elem"),
    "plugin": ("plugin_attr",),
}
"""Large arrays of rare kinds, compared by their `_moments`."""
_ELSEWHERE = _words(
    "body_parentid body_mocapid body_inertia body_iquat jnt_bodyid geom_bodyid geom_dataid"
    " site_bodyid actuator_trnid eq_objtype eq_obj1id eq_obj2id pair_geom1 pair_geom2"
    " sensor_objtype sensor_objid sensor_reftype sensor_refid tendon_adr tendon_num wrap_type"
    " wrap_objid wrap_prm exclude_signature qpos0 qpos_spring jnt_qposadr jnt_dofadr"
    " tree_bodyadr tree_sleep_policy mesh_vert mesh_vertadr mesh_vertnum mesh_facenum hfield_data"
    " hfield_adr hfield_size hfield_nrow hfield_ncol"
)
DESCRIBED = frozenset(
    [f"{kind.prefix}_{name}" for kind in _KINDS for name in kind.fields]
    + [f"dof_{name}" for name in _DOF]
    + [name for names in _POOLED.values() for name in names]
    + list(_ELSEWHERE)
)
"""Arrays of `mujoco.MjModel` read here; the others are visual, derived or indices."""


def physics_values(model: mujoco.MjModel) -> dict[str, Element]:
    """Return the values of a model that affect physics.

    Inertias are full tensors about the centre of mass in the body's axes, and meshes are described
    by counts and moments of their vertices in the body's frame, because principal axes of symmetric
    bodies may differ between machines. Fields that are all zero are left out; numbers have 9
    digits.

    Args:
        model: The compiled model.

    Returns:
        ``option`` and ``KIND NAME`` (``joint panda/panda_joint7``) -> field -> value.
    """
    found = {"option": _kept(_option(model))}
    for kind in _KINDS:
        for index in range(getattr(model, kind.count)):
            if kind.word == "geom" and not _touches(model, index):
                continue
            values = {name: _array(model, kind, name)[index] for name in kind.fields}
            values |= _MORE[kind.word](model, index) if kind.word in _MORE else {}
            if kind.body:
                values["body"] = _name(model, _OBJ.mjOBJ_BODY, getattr(model, kind.body)[index])
            found[f"{kind.word} {_name(model, kind.obj, index)}"] = _kept(values)
    found |= {f"{k} arrays": _kept(v) for k, v in _pooled(model).items() if v}
    excluded = sorted(_excluded(model))
    if excluded:
        found["exclude"] = {"bodies": excluded}
    return found


def _array(model: mujoco.MjModel, kind: _Kind, name: str) -> Any:
    """An array of a kind's elements; zeros if MuJoCo has no such array."""
    array = getattr(model, f"{kind.prefix}_{name}", None)
    return np.zeros(getattr(model, kind.count)) if array is None else array


def _option(model: mujoco.MjModel) -> Element:
    names = (name for name in dir(model.opt) if not name.startswith("_"))
    return {name: getattr(model.opt, name) for name in names}


def _body(model: mujoco.MjModel, index: int) -> Element:
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, model.body_iquat[index])
    axes = rotation.reshape(3, 3)
    tensor = (axes * model.body_inertia[index]) @ axes.T
    found: Element = {
        "inertia": tensor[np.triu_indices(3)],
        "mocap": int(model.body_mocapid[index] >= 0),
        "parent": _name(model, _OBJ.mjOBJ_BODY, model.body_parentid[index]),
    }
    trees = np.flatnonzero(model.tree_bodyadr == index)
    if len(trees):
        found["sleep_policy"] = model.tree_sleep_policy[trees[0]]
    return found


def _joint(model: mujoco.MjModel, index: int) -> Element:
    widths = {0: (7, 6), 1: (4, 3)}  # free and ball; slide and hinge have one of each
    nq, nv = widths.get(int(model.jnt_type[index]), (1, 1))
    at, dof = model.jnt_qposadr[index], model.jnt_dofadr[index]
    found: Element = {f"{name}": getattr(model, f"dof_{name}")[dof : dof + nv] for name in _DOF}
    # A joint's solver parameters are for its limits, those of its dofs for friction.
    found |= {f"{name}_friction": found.pop(name) for name in ("solref", "solimp")}
    found |= {name: getattr(model, name)[at : at + nq] for name in ("qpos0", "qpos_spring")}
    return found


def _geom(model: mujoco.MjModel, index: int) -> Element:
    """Values in place of a mesh's frame and size, which depend on its principal axes."""
    kind, data = int(model.geom_type[index]), int(model.geom_dataid[index])
    if kind == _HFIELD:
        rows, columns, start = (
            int(array[data]) for array in (model.hfield_nrow, model.hfield_ncol, model.hfield_adr)
        )
        heights = model.hfield_data[start : start + rows * columns]
        return {"size": model.hfield_size[data], "grid": [rows, columns], **_moments(heights)}
    if kind != _MESH:
        return {}
    start = model.mesh_vertadr[data]
    vertices = model.mesh_vert[start : start + model.mesh_vertnum[data]].astype(np.float64)
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, model.geom_quat[index])
    placed = vertices @ rotation.reshape(3, 3).T + model.geom_pos[index]
    spread = np.cov(placed.T, bias=True)[np.triu_indices(3)]
    counts = [int(model.mesh_vertnum[data]), int(model.mesh_facenum[data])]
    taken = {"size": 0.0, "pos": 0.0, "quat": 0.0}
    return taken | {"mesh_counts": counts, "mesh_mean": placed.mean(0), "mesh_spread": spread}


def _tendon(model: mujoco.MjModel, index: int) -> Element:
    start = model.tendon_adr[index]
    path: list[Any] = []
    kinds = {
        int(mujoco.mjtWrap.mjWRAP_JOINT): _OBJ.mjOBJ_JOINT,
        int(mujoco.mjtWrap.mjWRAP_SITE): _OBJ.mjOBJ_SITE,
        int(mujoco.mjtWrap.mjWRAP_SPHERE): _OBJ.mjOBJ_GEOM,
        int(mujoco.mjtWrap.mjWRAP_CYLINDER): _OBJ.mjOBJ_GEOM,
    }
    for at in range(start, start + model.tendon_num[index]):
        obj = kinds.get(int(model.wrap_type[at]))
        through = "pulley" if obj is None else _name(model, obj, model.wrap_objid[at])
        path += [through, float(model.wrap_prm[at])]
    return {"path": path}


def _actuator(model: mujoco.MjModel, index: int) -> Element:
    kinds = {
        int(_TRN.mjTRN_JOINT): _OBJ.mjOBJ_JOINT,
        int(_TRN.mjTRN_JOINTINPARENT): _OBJ.mjOBJ_JOINT,
        int(_TRN.mjTRN_SLIDERCRANK): _OBJ.mjOBJ_SITE,
        int(_TRN.mjTRN_TENDON): _OBJ.mjOBJ_TENDON,
        int(_TRN.mjTRN_SITE): _OBJ.mjOBJ_SITE,
        int(_TRN.mjTRN_BODY): _OBJ.mjOBJ_BODY,
    }
    obj = kinds.get(int(model.actuator_trntype[index]))
    ids = [int(i) for i in np.atleast_1d(model.actuator_trnid[index]) if i >= 0]
    return {"moves": [_name(model, obj, i) for i in ids] if obj is not None else []}


def _equality(model: mujoco.MjModel, index: int) -> Element:
    obj = _OBJ(int(model.eq_objtype[index]))
    ids = model.eq_obj1id[index], model.eq_obj2id[index]
    return {"between": [_name(model, obj, i) for i in ids if i >= 0]}


def _pair(model: mujoco.MjModel, index: int) -> Element:
    ids = model.pair_geom1[index], model.pair_geom2[index]
    return {"between": [_name(model, _OBJ.mjOBJ_GEOM, i) for i in ids]}


def _sensor(model: mujoco.MjModel, index: int) -> Element:
    found: Element = {}
    for word in ("obj", "ref"):
        kind = int(getattr(model, f"sensor_{word}type")[index])
        at = int(getattr(model, f"sensor_{word}id")[index])
        found[word] = _name(model, _OBJ(kind), at) if at >= 0 else 0.0
    return found


_MORE = {
    "body": _body,
    "joint": _joint,
    "geom": _geom,
    "tendon": _tendon,
    "actuator": _actuator,
    "equality": _equality,
    "pair": _pair,
    "sensor": _sensor,
}


def _touches(model: mujoco.MjModel, index: int) -> bool:
    """Whether a geom takes part in physics, by contact or fluid forces, or may come to do so."""
    paired = index in model.pair_geom1 or index in model.pair_geom2
    collides = bool(model.geom_contype[index] or model.geom_conaffinity[index])
    # Shapes of `any_of` that environments do not have at first; see `index_variants`.
    latent = model.nuser_body > 0 and model.geom_rgba[index, 3] == 0
    return bool(collides or paired or latent or np.any(model.geom_fluid[index]))


def _excluded(model: mujoco.MjModel) -> Iterator[str]:
    for signature in model.exclude_signature.tolist():
        pair = (_name(model, _OBJ.mjOBJ_BODY, i) for i in (signature >> 16, signature & 0xFFFF))
        yield ", ".join(sorted(pair))


def _pooled(model: mujoco.MjModel) -> dict[str, Element]:
    found: dict[str, Element] = {}
    for word, names in _POOLED.items():
        arrays = {name: np.asarray(getattr(model, name), np.float64) for name in names}
        found[word] = {
            f"{name}.{what}": value
            for name, array in arrays.items()
            if array.size
            for what, value in _moments(array).items()
        }
    return found


def _moments(array: NDArray[Any]) -> Element:
    values = np.asarray(array, np.float64)
    weights = np.arange(1, values.size + 1) / values.size  # makes the order count
    flat = values.reshape(-1)
    return {"count": flat.size, "mean": flat.mean(), "moment": (flat * weights).mean()}


def _name(model: mujoco.MjModel, obj: mujoco.mjtObj, index: Any) -> str:
    """The element's name; for geoms and unnamed elements, the number within the body or model.

    Names of geoms are not used: they may be numbers that count visual geoms too.
    """
    at = int(index)
    name = mujoco.mj_id2name(model, obj, at) if obj != _OBJ.mjOBJ_GEOM else None
    if name:
        return str(name)
    owners = {
        _OBJ.mjOBJ_GEOM: model.geom_bodyid,
        _OBJ.mjOBJ_SITE: model.site_bodyid,
        _OBJ.mjOBJ_JOINT: model.jnt_bodyid,
    }
    if obj not in owners:
        return f"#{at}"
    owner = owners[obj]
    before = np.flatnonzero(owner[:at] == owner[at]).tolist()
    rank = sum(1 for i in before if obj != _OBJ.mjOBJ_GEOM or _touches(model, i))
    return f"#{rank} of {_name(model, _OBJ.mjOBJ_BODY, owner[at])}"


def _kept(values: Element) -> Element:
    """Plain values without zeros."""
    plain = {name: _plain(value) for name, value in values.items()}
    return {name: value for name, value in plain.items() if not _is_zero(value)}


def _plain(value: Any) -> Any:
    """A string, a rounded number, or a list of them; a list of one becomes its element."""
    if isinstance(value, str):
        return value
    if isinstance(value, (list, tuple, np.ndarray)):
        flat = value.reshape(-1) if isinstance(value, np.ndarray) else value
        items = [_plain(item) for item in flat]
        return items[0] if len(items) == 1 else items
    number = float(f"{float(value):.{_DIGITS}g}")
    if not np.isfinite(number):
        return str(number)  # JSON has no such number
    return int(number) if number.is_integer() else number


def _is_zero(value: Any) -> bool:
    if isinstance(value, list):
        return all(_is_zero(item) for item in value)
    return not isinstance(value, str) and value == 0
