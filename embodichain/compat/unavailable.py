"""Names of EmbodiChain that are not available: they raise NotImplementedError with the reason.

Objects and their configs raise when they are built, methods when they are called. Some methods of
the simulation return a constant instead, such as that there is no gizmo.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final, NoReturn

__all__ = ["ANSWERS", "CLASSES", "REFUSALS", "members_of"]

_SOFT = "soft bodies are not available"
_CLOTH = "cloth is not available"
_GROUP = "object groups are not available"
_GIZMO = "gizmos are not available"
_TEXTURE = "textures are compiled into the model"
_MATERIAL = "declare visual_material"
_LIGHT = "MuJoCo has none; add lights"
_WELD = "welds are equality constraints of an MJCF scene or robot"
_ENGINE = "the engine is MuJoCo's: model and data are scene.model and engine.rows"
_WINDOW = "the log of a run contains it: record=mcap, then `embodichain replay last --video FILE`"

_SIMULATION_ANSWERS: dict[str, tuple[Any, str]] = {
    "flush_cleanup_queue": (None, "`destroy` frees at once"),
    "wait_scene_destruction": (None, "`destroy` frees at once"),
    "init_gpu_physics": (
        None,
        "device=cuda is MuJoCo Warp from the first step; no engine needs a start",
    ),
    "set_default_background": (None, "the background is MuJoCo's sky and ground plane"),
    "get_soft_object": (None, _SOFT),
    "get_soft_object_uid_list": ([], _SOFT),
    "get_cloth_object": (None, _CLOTH),
    "get_cloth_object_uid_list": ([], _CLOTH),
    "get_rigid_object_group": (None, _GROUP),
    "get_rigid_object_group_uid_list": ([], _GROUP),
    "has_gizmo": (False, _GIZMO),
    "get_gizmo": (None, _GIZMO),
    "list_gizmos": ({}, _GIZMO),
    "update_gizmos": (None, _GIZMO),
    "is_window_recording": (False, "windows are not recorded"),
    "get_texture_cache": (None, _TEXTURE),
}
ANSWERS: Final[Mapping[str, dict[str, tuple[Any, str]]]] = {
    "SimulationManager": _SIMULATION_ANSWERS,
}
"""Class -> method -> its constant return value, and why."""

_SIMULATION_REFUSALS: dict[str, str] = {
    "add_soft_object": _SOFT,
    "add_cloth_object": _CLOTH,
    "add_rigid_object_group": "add objects one by one",
    **dict.fromkeys(
        ("create_visual_material", "get_visual_material", "clean_materials"), _MATERIAL
    ),
    **dict.fromkeys(("create_rigid_constraint", "remove_rigid_constraint"), _WELD),
    "export_usd": "USD is not written",
    "draw_marker": "add a kinematic object instead",
    "remove_marker": "remove or hide the kinematic object that stands for it",
    **dict.fromkeys(("enable_gizmo", "disable_gizmo", "toggle_gizmo_visibility"), _GIZMO),
    "set_gizmo_visibility": _GIZMO,
    "visualize_point_cloud": "the observation camera_points returns them; no window draws them",
    **dict.fromkeys(("set_indirect_lighting", "set_emission_light"), _LIGHT),
    "set_ground_plane_visibility": "SimulationManagerCfg(ground_plane=False) leaves it out",
    "set_texture_cache": _TEXTURE,
    "render_camera_group": "a camera sensor is drawn when it is read: update, then get_data",
    **dict.fromkeys(("get_env", "get_world"), _ENGINE),
    **dict.fromkeys(("start_window_record", "stop_window_record"), _WINDOW),
    **dict.fromkeys(("toggle_window_record", "enable_window_record_hotkey"), _WINDOW),
    "add_custom_window_control": "the window is MuJoCo's viewer",
}
REFUSALS: Final[Mapping[str, dict[str, str]]] = {
    "SimulationManager": _SIMULATION_REFUSALS,
    "Articulation": {
        "set_fix_base": "declare fix_base: it is compiled into the model",
        "set_self_collision": "declare disable_self_collision",
        "set_link_physical_attr": "declare attrs; set_mass works",
    },
    "Robot": {"init_solver": "declare solver_cfg: tool points are compiled"},
    "RigidObject": {
        "set_body_type": "the body type is compiled into the model",
        "set_attrs": "use set_mass, set_friction, set_damping, set_inertia",
        "set_collision_filter": "environments never share a world",
        "set_physical_visible": "use set_visible",
        "set_visual_material": "declare shape.visual_material",
        "get_vertices": "the compiled model has its meshes: sim.engine.model",
        "get_triangles": "the compiled model has its meshes: sim.engine.model",
    },
}
"""Class -> method -> why it raises NotImplementedError."""


def _make_refusing_method(name: str, why: str) -> Callable[..., NoReturn]:
    """Return a method that raises NotImplementedError."""

    def method(self: object, *args: Any, **kwargs: Any) -> NoReturn:
        raise NotImplementedError(f"{type(self).__name__}.{name} is not available: {why}")

    method.__name__ = name
    method.__doc__ = f"Not available: {why}; raises NotImplementedError."
    return method


def _make_answering_method(name: str, answer: Any, why: str) -> Callable[..., Any]:
    """Return a function that always has the same result."""

    def method(*args: Any, **kwargs: Any) -> Any:
        if isinstance(answer, (list, dict)):  # the caller may change it
            return answer.copy()
        return answer

    method.__name__ = name
    method.__doc__ = f"{answer!r}: {why}."
    return method


def members_of(name: str) -> dict[str, Any]:
    """Return the methods of EmbodiChain that a class lacks here.

    Args:
        name: The class, such as ``Robot``.

    Returns:
        Name -> a method that raises the reason, or a static method with a constant result.
    """
    members: dict[str, Any] = {
        method: _make_refusing_method(method, why) for method, why in REFUSALS.get(name, {}).items()
    }
    for method, (answer, why) in ANSWERS.get(name, {}).items():
        members[method] = staticmethod(_make_answering_method(method, answer, why))
    return members


class _Unavailable:
    """Raises NotImplementedError when built."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        raise NotImplementedError(f"{type(self).__name__}: {self.__doc__}")


def _make_refusing_class(name: str, why: str) -> type[_Unavailable]:
    """Return a class that raises NotImplementedError when built."""
    return type(name, (_Unavailable,), {"__doc__": why, "__module__": __name__})


_WHY = {
    "SoftObject": _SOFT,
    "ClothObject": _CLOTH,
    "RigidObjectGroup": "object groups are not available: add objects one by one",
    "RigidConstraint": _WELD,
    "Gizmo": _GIZMO,
}
_CONFIG_WHY = {f"{name}Cfg": why for name, why in _WHY.items()}
CLASSES: Final[Mapping[str, type]] = {
    name: _make_refusing_class(name, why) for name, why in (_WHY | _CONFIG_WHY).items()
}
"""Name of an object or of its config -> the class that raises when it is built."""
