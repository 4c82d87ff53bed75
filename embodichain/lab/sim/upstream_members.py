"""`UpstreamMembers`: methods of EmbodiChain's `SimulationManager` that mean little or nothing here.

They exist so that its scripts run: those that cannot do their work raise NotImplementedError.
"""

from __future__ import annotations

import logging
import weakref
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Self, cast

from embodichain.lab.sim.unavailable import not_available

if TYPE_CHECKING:
    import torch

__all__ = ["UpstreamMembers"]

_log = logging.getLogger(__name__)
_instances: dict[int, weakref.ref[Any]] = {}
"""Simulations of this process by `instance_id`, while they live."""

_SOFT, _CLOTH = "soft bodies are not available", "cloth is not available"
_GROUP, _GIZMO = "object groups are not available", "gizmos are not available"
_TEXTURE, _MATERIAL = "textures are compiled into the model", "declare visual_material"
_LIGHT, _WELD = "MuJoCo has none; add lights", "welds come later"
_ENGINE = "the engine is MuJoCo's: model and data are scene.model and engine.rows"
_WINDOW = "the log of a run holds it: record=full, then `embodichain replay last --video FILE`"

_ANSWERS: dict[str, tuple[Any, str]] = {
    "flush_cleanup_queue": (None, "`destroy` frees at once"),
    "wait_scene_destruction": (None, "`destroy` frees at once"),
    "init_gpu_physics": (None, "there is no GPU engine yet, and the CPU's needs no start"),
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
"""Method -> what it returns always, and why."""

_REFUSALS = {
    "add_soft_object": "soft bodies come later",
    "add_cloth_object": "cloth comes later",
    "add_rigid_object_group": "add objects one by one",
    **dict.fromkeys(
        ("create_visual_material", "get_visual_material", "clean_materials"), _MATERIAL
    ),
    **dict.fromkeys(("create_rigid_constraint", "remove_rigid_constraint"), _WELD),
    "export_usd": "USD is not written",
    "draw_marker": "add a kinematic object instead",
    "remove_marker": "no marker can be drawn",
    **dict.fromkeys(("enable_gizmo", "disable_gizmo", "toggle_gizmo_visibility"), _GIZMO),
    "set_gizmo_visibility": _GIZMO,
    "visualize_point_cloud": "point clouds come later",
    **dict.fromkeys(("set_indirect_lighting", "set_emission_light"), _LIGHT),
    "set_ground_plane_visibility": "SimulationManagerCfg(ground_plane=False) leaves it out",
    "set_texture_cache": _TEXTURE,
    "render_camera_group": "cameras come later",
    **dict.fromkeys(("get_env", "get_world"), _ENGINE),
    **dict.fromkeys(("start_window_record", "stop_window_record"), _WINDOW),
    **dict.fromkeys(("toggle_window_record", "enable_window_record_hotkey"), _WINDOW),
    "add_custom_window_control": "the window is MuJoCo's viewer",
}
"""Method -> why it raises NotImplementedError."""


class UpstreamMembers:
    """The part of `SimulationManager` that exists for EmbodiChain's scripts.

    Attributes:
        instance_id: The simulation's number among those of this process.
    """

    device: torch.device

    def __init__(self) -> None:
        self.instance_id = max(_instances, default=-1) + 1
        _instances[self.instance_id] = weakref.ref(self)

    def forget_instance(self) -> None:
        """No longer count this simulation among the living ones."""
        _instances.pop(self.instance_id, None)

    def destroy(self, exit_process: bool = False) -> None:
        """Free the simulation."""
        raise NotImplementedError

    @classmethod
    def get_instance(cls, instance_id: int = 0) -> Self:
        """Return a living simulation by the order of its creation.

        Raises:
            ValueError: If there is none; lists the living ones.
        """
        alive = [i for i, ref in _instances.items() if ref() is not None]
        if instance_id not in alive:
            raise ValueError(f"no simulation {instance_id}; living ones: {alive}")
        return cast(Self, _instances[instance_id]())

    @staticmethod
    def get_instance_num() -> int:
        """How many simulations live in this process."""
        return sum(ref() is not None for ref in _instances.values())

    @staticmethod
    def is_instantiated(instance_id: int = 0) -> bool:
        """Whether a simulation of that number lives."""
        return _instances.get(instance_id, lambda: None)() is not None

    @classmethod
    def reset(cls, instance_id: int = 0) -> None:
        """Destroy a simulation if it lives; states are reset by `reset_objects_state`."""
        if cls.is_instantiated(instance_id):
            cls.get_instance(instance_id).destroy()

    @property
    def is_use_gpu_physics(self) -> bool:
        """Whether physics runs on a GPU."""
        return self.device.type == "cuda"

    @property
    def is_physics_manually_update(self) -> bool:
        """True: physics advances in `update` only."""
        return True

    def set_manual_update(self, enable: bool) -> None:
        """Accept the call; False is warned of: physics advances in `update` only."""
        if not enable:
            _log.warning("set_manual_update(False): no effect, physics advances in update() only")


def _answering(name: str, answer: Any, why: str) -> Callable[..., Any]:
    def method(*args: Any, **kwargs: Any) -> Any:
        return answer.copy() if isinstance(answer, (list, dict)) else answer

    method.__name__ = name
    method.__doc__ = f"{answer!r}: {why}."
    return method


for _name, (_answer, _why) in _ANSWERS.items():
    setattr(UpstreamMembers, _name, staticmethod(_answering(_name, _answer, _why)))
for _name, _why in _REFUSALS.items():
    setattr(UpstreamMembers, _name, not_available(_name, _why))
