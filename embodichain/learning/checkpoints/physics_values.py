"""`physics_values`: the values of a compiled model that affect physics, by element and field.

They serve to compare two models and name the differences. Visual geoms, colours, textures, lights,
cameras, indices and values that MuJoCo derives are left out. Elements are identified by name.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

__all__ = ["DESCRIBED", "Element", "physics_values"]

Element = dict[str, Any]
"""Field -> value: a number, a list of numbers, or the name of another element."""

_OBJ = mujoco.mjtObj
_WRAP = mujoco.mjtWrap
_TRANSMISSION = mujoco.mjtTrn
_DIGITS = 9
_MESH = int(mujoco.mjtGeom.mjGEOM_MESH)
_HFIELD = int(mujoco.mjtGeom.mjGEOM_HFIELD)
_FREE = int(mujoco.mjtJoint.mjJNT_FREE)
_BALL = int(mujoco.mjtJoint.mjJNT_BALL)

_DOF_FIELDS = ("armature", "damping", "dampingpoly", "frictionloss", "solref", "solimp")
_POOLED_ARRAYS = {
    "flex": ("flex_vert0", "flex_node0", "flex_stiffness", "flex_bending", "flex_elem"),
    "plugin": ("plugin_attr",),
}
"""Large arrays of rare kinds, compared by their `_moments`."""

_WRAPPED = {
    int(_WRAP.mjWRAP_JOINT): _OBJ.mjOBJ_JOINT,
    int(_WRAP.mjWRAP_SITE): _OBJ.mjOBJ_SITE,
    int(_WRAP.mjWRAP_SPHERE): _OBJ.mjOBJ_GEOM,
    int(_WRAP.mjWRAP_CYLINDER): _OBJ.mjOBJ_GEOM,
}
"""Kind of the element that a tendon passes; a pulley is none."""
_ACTUATED = {
    int(_TRANSMISSION.mjTRN_JOINT): _OBJ.mjOBJ_JOINT,
    int(_TRANSMISSION.mjTRN_JOINTINPARENT): _OBJ.mjOBJ_JOINT,
    int(_TRANSMISSION.mjTRN_SLIDERCRANK): _OBJ.mjOBJ_SITE,
    int(_TRANSMISSION.mjTRN_TENDON): _OBJ.mjOBJ_TENDON,
    int(_TRANSMISSION.mjTRN_SITE): _OBJ.mjOBJ_SITE,
    int(_TRANSMISSION.mjTRN_BODY): _OBJ.mjOBJ_BODY,
}
"""Kind of the element that an actuator moves."""


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
    elements = {"option": _plain_nonzero(_option(model))}
    for kind in _KINDS:
        for index in range(kind.count(model)):
            if kind.name == "geom" and not _affects_physics(model, index):
                continue
            name = _name(model, kind.obj_type, index)
            elements[f"{kind.name} {name}"] = _plain_nonzero(kind.values(model, index))
    for name, names in _POOLED_ARRAYS.items():
        moments = _pooled_moments(model, names)
        if moments:
            elements[f"{name} arrays"] = _plain_nonzero(moments)
    excluded_pairs = sorted(_excluded_pairs(model))
    if excluded_pairs:
        elements["exclude"] = {"bodies": excluded_pairs}
    return elements


def _option(model: mujoco.MjModel) -> Element:
    names = (name for name in dir(model.opt) if not name.startswith("_"))
    return {name: getattr(model.opt, name) for name in names}


# -- values of one element that are not a row of an array, by kind --------------------------------


def _body(model: mujoco.MjModel, index: int) -> Element:
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, model.body_iquat[index])
    axes = rotation.reshape(3, 3)
    tensor = (axes * model.body_inertia[index]) @ axes.T
    values: Element = {
        "inertia": tensor[np.triu_indices(3)],
        "mocap": int(model.body_mocapid[index] >= 0),
        "parent": _name(model, _OBJ.mjOBJ_BODY, model.body_parentid[index]),
    }
    trees = np.flatnonzero(model.tree_bodyadr == index)
    if len(trees):
        values["sleep_policy"] = model.tree_sleep_policy[trees[0]]
    return values


def _joint(model: mujoco.MjModel, index: int) -> Element:
    if model.jnt_type[index] == _FREE:
        nq, nv = 7, 6
    elif model.jnt_type[index] == _BALL:
        nq, nv = 4, 3
    else:
        nq, nv = 1, 1
    first_qpos = model.jnt_qposadr[index]
    first_dof = model.jnt_dofadr[index]
    qpos = slice(first_qpos, first_qpos + nq)
    dofs = slice(first_dof, first_dof + nv)
    values: Element = {name: getattr(model, f"dof_{name}")[dofs] for name in _DOF_FIELDS}
    # A joint's solver parameters are for its limits, those of its dofs for friction.
    values["solref_friction"] = values.pop("solref")
    values["solimp_friction"] = values.pop("solimp")
    values["qpos0"] = model.qpos0[qpos]
    values["qpos_spring"] = model.qpos_spring[qpos]
    return values


def _geom(model: mujoco.MjModel, index: int) -> Element:
    if model.geom_type[index] == _HFIELD:
        return _height_field(model, index)
    if model.geom_type[index] == _MESH:
        return _mesh(model, index)
    return {}


def _height_field(model: mujoco.MjModel, geom: int) -> Element:
    hfield = int(model.geom_dataid[geom])
    rows = int(model.hfield_nrow[hfield])
    columns = int(model.hfield_ncol[hfield])
    start = int(model.hfield_adr[hfield])
    heights = model.hfield_data[start : start + rows * columns]
    return {"size": model.hfield_size[hfield], "grid": [rows, columns], **_moments(heights)}


def _mesh(model: mujoco.MjModel, geom: int) -> Element:
    mesh = int(model.geom_dataid[geom])
    start = model.mesh_vertadr[mesh]
    count = model.mesh_vertnum[mesh]
    vertices = model.mesh_vert[start : start + count].astype(np.float64)
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, model.geom_quat[geom])
    in_body = vertices @ rotation.reshape(3, 3).T + model.geom_pos[geom]
    covariance = np.cov(in_body.T, bias=True)
    return {
        # The frame and the size depend on the mesh's principal axes; zeros are left out.
        "size": 0.0,
        "pos": 0.0,
        "quat": 0.0,
        "mesh_counts": [int(count), int(model.mesh_facenum[mesh])],
        "mesh_mean": in_body.mean(0),
        "mesh_spread": covariance[np.triu_indices(3)],
    }


def _tendon(model: mujoco.MjModel, index: int) -> Element:
    start = model.tendon_adr[index]
    path: list[Any] = []
    for wrap in range(start, start + model.tendon_num[index]):
        obj_type = _WRAPPED.get(int(model.wrap_type[wrap]))
        if obj_type is None:
            path.append("pulley")
        else:
            path.append(_name(model, obj_type, model.wrap_objid[wrap]))
        path.append(float(model.wrap_prm[wrap]))
    return {"path": path}


def _actuator(model: mujoco.MjModel, index: int) -> Element:
    obj_type = _ACTUATED.get(int(model.actuator_trntype[index]))
    if obj_type is None:
        return {"moves": []}
    ids = [int(i) for i in np.atleast_1d(model.actuator_trnid[index]) if i >= 0]
    return {"moves": [_name(model, obj_type, i) for i in ids]}


def _equality(model: mujoco.MjModel, index: int) -> Element:
    obj_type = _OBJ(int(model.eq_objtype[index]))
    ids = [model.eq_obj1id[index], model.eq_obj2id[index]]
    return {"between": [_name(model, obj_type, i) for i in ids if i >= 0]}


def _pair(model: mujoco.MjModel, index: int) -> Element:
    geoms = [model.pair_geom1[index], model.pair_geom2[index]]
    return {"between": [_name(model, _OBJ.mjOBJ_GEOM, geom) for geom in geoms]}


def _sensor(model: mujoco.MjModel, index: int) -> Element:
    return {
        "obj": _sensed_name(model, model.sensor_objtype[index], model.sensor_objid[index]),
        "ref": _sensed_name(model, model.sensor_reftype[index], model.sensor_refid[index]),
    }


def _sensed_name(model: mujoco.MjModel, obj_type: Any, index: Any) -> str | float:
    """Return the name of the element that a sensor refers to; 0.0 if there is none."""
    if index < 0:
        return 0.0
    return _name(model, _OBJ(int(obj_type)), int(index))


# -- arrays whose rows are elements ---------------------------------------------------------------


def _words(text: str) -> tuple[str, ...]:
    return tuple(text.split())


@dataclass(frozen=True, slots=True)
class _Kind:
    """One kind of elements.

    Attributes:
        name: Its name in the result.
        obj_type: MuJoCo's type, for the names of elements.
        count_field: The model's field with the number of elements.
        prefix: Prefix of the model's arrays with one row for each element.
        fields: Names of these arrays without the prefix.
        body_field: The array with the element's body, if there is one.
        other_values: Returns the values that are not a row of an array.
    """

    name: str
    obj_type: mujoco.mjtObj
    count_field: str
    prefix: str
    fields: tuple[str, ...]
    body_field: str = ""
    other_values: Callable[[mujoco.MjModel, int], Element] | None = None

    def count(self, model: mujoco.MjModel) -> int:
        """Return the number of elements in a model."""
        return int(getattr(model, self.count_field))

    def values(self, model: mujoco.MjModel, index: int) -> Element:
        """Return the values of an element, zeros included."""
        values: Element = {name: self._array(model, name)[index] for name in self.fields}
        if self.other_values is not None:
            values |= self.other_values(model, index)
        if self.body_field:
            body = getattr(model, self.body_field)[index]
            values["body"] = _name(model, _OBJ.mjOBJ_BODY, body)
        return values

    def _array(self, model: mujoco.MjModel, name: str) -> Any:
        """Return an array of this kind; zeros where this version of MuJoCo has no such array."""
        array = getattr(model, f"{self.prefix}_{name}", None)
        if array is None:
            return np.zeros(self.count(model))
        return array


_KINDS = (
    _Kind(
        name="body",
        obj_type=_OBJ.mjOBJ_BODY,
        count_field="nbody",
        prefix="body",
        fields=_words("pos quat mass ipos gravcomp"),
        other_values=_body,
    ),
    _Kind(
        name="joint",
        obj_type=_OBJ.mjOBJ_JOINT,
        count_field="njnt",
        prefix="jnt",
        fields=_words(
            "type pos axis limited range margin solref solimp stiffness stiffnesspoly springyield"
            " actfrclimited actfrcrange actgravcomp"
        ),
        body_field="jnt_bodyid",
        other_values=_joint,
    ),
    _Kind(
        name="geom",
        obj_type=_OBJ.mjOBJ_GEOM,
        count_field="ngeom",
        prefix="geom",
        fields=_words(
            "type size pos quat contype conaffinity condim priority friction solmix solref solimp"
            " margin gap adhesion surfacevel fluid"
        ),
        body_field="geom_bodyid",
        other_values=_geom,
    ),
    _Kind(
        name="site",
        obj_type=_OBJ.mjOBJ_SITE,
        count_field="nsite",
        prefix="site",
        fields=_words("type size pos quat"),
        body_field="site_bodyid",
    ),
    _Kind(
        name="tendon",
        obj_type=_OBJ.mjOBJ_TENDON,
        count_field="ntendon",
        prefix="tendon",
        fields=_words(
            "type limited range margin stiffness stiffnesspoly springyield damping dampingpoly"
            " frictionloss armature lengthspring actfrclimited actfrcrange solref_lim solimp_lim"
            " solref_fri solimp_fri"
        ),
        other_values=_tendon,
    ),
    _Kind(
        name="actuator",
        obj_type=_OBJ.mjOBJ_ACTUATOR,
        count_field="nactuator",
        prefix="actuator",
        fields=_words(
            "trntype gaintype gainprm biastype biasprm dyntype dynprm gear ctrllimited ctrlrange"
            " ctrlspec ctrlnum forcelimited forcerange actlimited actrange actearly actnum"
            " cranklength lengthrange armature damping dampingpoly delay history"
        ),
        other_values=_actuator,
    ),
    _Kind(
        name="equality",
        obj_type=_OBJ.mjOBJ_EQUALITY,
        count_field="neq",
        prefix="eq",
        fields=_words("type data active0 solref solimp"),
        other_values=_equality,
    ),
    _Kind(
        name="pair",
        obj_type=_OBJ.mjOBJ_PAIR,
        count_field="npair",
        prefix="pair",
        fields=_words("dim friction margin gap adhesion solref solreffriction solimp"),
        other_values=_pair,
    ),
    _Kind(
        name="sensor",
        obj_type=_OBJ.mjOBJ_SENSOR,
        count_field="nsensor",
        prefix="sensor",
        fields=_words("type dim cutoff noise delay history interval intprm"),
        other_values=_sensor,
    ),
    _Kind(
        name="flex",
        obj_type=_OBJ.mjOBJ_FLEX,
        count_field="nflex",
        prefix="flex",
        fields=_words(
            "dim contype conaffinity condim priority friction solmix solref solimp margin gap"
            " radius size damping edgestiffness edgedamping edgeequality rigid centered"
            " selfcollide activelayers passive interp yield plasticmode vertnum elemnum edgenum"
        ),
    ),
)
_READ_IN_FUNCTIONS = _words(
    "body_parentid body_mocapid body_inertia body_iquat jnt_bodyid geom_bodyid geom_dataid"
    " site_bodyid actuator_trnid eq_objtype eq_obj1id eq_obj2id pair_geom1 pair_geom2"
    " sensor_objtype sensor_objid sensor_reftype sensor_refid tendon_adr tendon_num wrap_type"
    " wrap_objid wrap_prm exclude_signature qpos0 qpos_spring jnt_qposadr jnt_dofadr"
    " tree_bodyadr tree_sleep_policy mesh_vert mesh_vertadr mesh_vertnum mesh_facenum hfield_data"
    " hfield_adr hfield_size hfield_nrow hfield_ncol"
)
DESCRIBED = frozenset(
    [f"{kind.prefix}_{name}" for kind in _KINDS for name in kind.fields]
    + [f"dof_{name}" for name in _DOF_FIELDS]
    + [name for names in _POOLED_ARRAYS.values() for name in names]
    + list(_READ_IN_FUNCTIONS)
)
"""Arrays of `mujoco.MjModel` read here; the others are visual, derived or indices."""


# -- helpers --------------------------------------------------------------------------------------


def _affects_physics(model: mujoco.MjModel, geom: int) -> bool:
    """Whether a geom takes part in physics, by contact or fluid forces, or may come to do so."""
    is_paired = geom in model.pair_geom1 or geom in model.pair_geom2
    collides = bool(model.geom_contype[geom] or model.geom_conaffinity[geom])
    # Shapes of `any_of` that environments do not have at first; see `index_variants`.
    is_latent = model.nuser_body > 0 and model.geom_rgba[geom, 3] == 0
    return bool(collides or is_paired or is_latent or np.any(model.geom_fluid[geom]))


def _excluded_pairs(model: mujoco.MjModel) -> list[str]:
    """Return the pairs of bodies that do not collide, each as ``A, B``."""
    pairs = []
    for signature in model.exclude_signature.tolist():
        # MuJoCo packs the two body ids into one integer.
        bodies = [signature >> 16, signature & 0xFFFF]
        names = sorted(_name(model, _OBJ.mjOBJ_BODY, body) for body in bodies)
        pairs.append(", ".join(names))
    return pairs


def _pooled_moments(model: mujoco.MjModel, names: tuple[str, ...]) -> Element:
    moments: Element = {}
    for name in names:
        array = np.asarray(getattr(model, name), np.float64)
        if array.size:
            moments |= {f"{name}.{key}": value for key, value in _moments(array).items()}
    return moments


def _moments(array: NDArray[Any]) -> Element:
    values = np.asarray(array, np.float64).reshape(-1)
    weights = np.arange(1, values.size + 1) / values.size  # makes the order count
    return {"count": values.size, "mean": values.mean(), "moment": (values * weights).mean()}


def _name(model: mujoco.MjModel, obj_type: mujoco.mjtObj, index: Any) -> str:
    """Return an element's name; for geoms and unnamed ones, the number within the body or model.

    Names of geoms are not used: they may be numbers that count visual geoms too.
    """
    index = int(index)
    is_geom = obj_type == _OBJ.mjOBJ_GEOM
    name = None if is_geom else mujoco.mj_id2name(model, obj_type, index)
    if name:
        return str(name)
    if is_geom:
        bodies = model.geom_bodyid
    elif obj_type == _OBJ.mjOBJ_SITE:
        bodies = model.site_bodyid
    elif obj_type == _OBJ.mjOBJ_JOINT:
        bodies = model.jnt_bodyid
    else:
        return f"#{index}"
    body = bodies[index]
    earlier = np.flatnonzero(bodies[:index] == body).tolist()
    if is_geom:
        earlier = [geom for geom in earlier if _affects_physics(model, geom)]
    return f"#{len(earlier)} of {_name(model, _OBJ.mjOBJ_BODY, body)}"


def _plain_nonzero(values: Element) -> Element:
    """Return the values that are not zero, as plain values."""
    plain = {name: _plain(value) for name, value in values.items()}
    return {name: value for name, value in plain.items() if not _is_zero(value)}


def _plain(value: Any) -> Any:
    """Return a string, a rounded number, or a list of them; a list of one becomes its element."""
    if isinstance(value, str):
        return value
    if isinstance(value, np.ndarray):
        value = value.reshape(-1)
    if isinstance(value, (list, tuple, np.ndarray)):
        items = [_plain(item) for item in value]
        return items[0] if len(items) == 1 else items
    number = float(f"{float(value):.{_DIGITS}g}")
    if not np.isfinite(number):
        return str(number)  # JSON has no such number
    return int(number) if number.is_integer() else number


def _is_zero(value: Any) -> bool:
    if isinstance(value, str):
        return False
    if isinstance(value, list):
        return all(_is_zero(item) for item in value)
    return bool(value == 0)
