"""Names of EmbodiChain that are not available: they raise NotImplementedError with the reason.

Objects and their configs raise when they are built, methods when they are called. Some methods of
the simulation return a constant instead, such as that there is no gizmo.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NoReturn, TypeVar

__all__ = [
    "ClothObject",
    "ClothObjectCfg",
    "Gizmo",
    "GizmoCfg",
    "RigidConstraint",
    "RigidConstraintCfg",
    "RigidObjectGroup",
    "RigidObjectGroupCfg",
    "SoftObject",
    "SoftObjectCfg",
    "not_available",
    "with_simulation_members",
]

Class = TypeVar("Class", bound=type)

_SOFT, _CLOTH = "soft bodies are not available", "cloth is not available"
_GROUP, _GIZMO = "object groups are not available", "gizmos are not available"
_TEXTURE, _MATERIAL = "textures are compiled into the model", "declare visual_material"
_LIGHT, _WELD = (
    "MuJoCo has none; add lights",
    "welds are equality constraints of an MJCF scene or robot",
)
_ENGINE = "the engine is MuJoCo's: model and data are scene.model and engine.rows"
_WINDOW = "the log of a run contains it: record=mcap, then `embodichain replay last --video FILE`"

SIMULATION_ANSWERS: Mapping[str, tuple[Any, str]] = {
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
"""Method of `SimulationManager` -> its constant return value, and why."""

SIMULATION_REFUSALS: Mapping[str, str] = {
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
"""Method of `SimulationManager` -> why it raises NotImplementedError."""


def not_available(what: str, why: str) -> Callable[..., NoReturn]:
    """Return a method that raises NotImplementedError."""

    def method(self: object, *args: Any, **kwargs: Any) -> NoReturn:
        raise NotImplementedError(f"{type(self).__name__}.{what} is not available: {why}")

    method.__name__ = what
    method.__doc__ = f"Not available: {why}; raises NotImplementedError."
    return method


def _answering(name: str, answer: Any, why: str) -> Callable[..., Any]:
    def method(*args: Any, **kwargs: Any) -> Any:
        return answer.copy() if isinstance(answer, (list, dict)) else answer

    method.__name__ = name
    method.__doc__ = f"{answer!r}: {why}."
    return method


def with_simulation_members(cls: Class) -> Class:
    """Decorate a class with `SIMULATION_ANSWERS` and `SIMULATION_REFUSALS`."""
    for name, (answer, why) in SIMULATION_ANSWERS.items():
        setattr(cls, name, staticmethod(_answering(name, answer, why)))
    for name, why in SIMULATION_REFUSALS.items():
        setattr(cls, name, not_available(name, why))
    return cls


class _Unavailable:
    """Raises NotImplementedError when built."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        raise NotImplementedError(f"{type(self).__name__}: {self.__doc__}")


def _refusing(name: str, why: str) -> tuple[type[_Unavailable], type[_Unavailable]]:
    """Return an unavailable class and its config class."""
    members = {"__doc__": why, "__module__": __name__}
    return type(name, (_Unavailable,), members), type(f"{name}Cfg", (_Unavailable,), members)


SoftObject, SoftObjectCfg = _refusing("SoftObject", _SOFT)
ClothObject, ClothObjectCfg = _refusing("ClothObject", _CLOTH)
RigidObjectGroup, RigidObjectGroupCfg = _refusing(
    "RigidObjectGroup", "object groups are not available: add objects one by one"
)
RigidConstraint, RigidConstraintCfg = _refusing("RigidConstraint", _WELD)
Gizmo, GizmoCfg = _refusing("Gizmo", _GIZMO)
