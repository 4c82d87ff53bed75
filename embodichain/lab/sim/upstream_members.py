"""`UpstreamMembers`: methods of EmbodiChain's `SimulationManager` that mean little or nothing here.

They exist so that its scripts run: those that cannot do their work raise NotImplementedError.
"""

from __future__ import annotations

import logging
import weakref
from typing import TYPE_CHECKING, Any, Self, cast

from embodichain.lab.sim.unavailable import not_available

if TYPE_CHECKING:
    import torch

__all__ = ["UpstreamMembers"]

_log = logging.getLogger(__name__)
_ENGINE = "the engine is MuJoCo's: model and data are scene.model and engine.rows"
_GIZMO = "gizmos are not available"
_TEXTURES = "textures are compiled into the model"
_WINDOW = "the log of a run holds it: record=full, then `embodichain replay last --video FILE`"


_instances: dict[int, weakref.ref[Any]] = {}
"""Simulations of this process by `instance_id`, while they live."""


class UpstreamMembers:
    """The part of `SimulationManager` that exists for EmbodiChain's scripts.

    Attributes:
        instance_id: The simulation's number among those of this process.
    """

    device: torch.device
    rigid_objects: Any

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

    @staticmethod
    def flush_cleanup_queue() -> None:
        """Do nothing: `destroy` frees at once."""

    @staticmethod
    def wait_scene_destruction(timeout_ms: int = 0) -> None:
        """Do nothing: `destroy` frees at once."""

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

    @property
    def has_non_static_rigid_object(self) -> bool:
        """Whether a rigid object can move."""
        return any(obj.cfg.body_type != "static" for obj in self.rigid_objects.values())

    # -- what can be asked, and is never there -----------------------------------------------------

    def get_soft_object(self, uid: str) -> None:
        """None: soft bodies are not available."""

    def get_cloth_object(self, uid: str) -> None:
        """None: cloth is not available."""

    def get_rigid_object_group(self, uid: str) -> None:
        """None: object groups are not available."""

    def get_soft_object_uid_list(self) -> list[str]:
        """Empty: soft bodies are not available."""
        return []

    def get_cloth_object_uid_list(self) -> list[str]:
        """Empty: cloth is not available."""
        return []

    def get_rigid_object_group_uid_list(self) -> list[str]:
        """Empty: object groups are not available."""
        return []

    def has_gizmo(self, uid: str, control_part: str | None = None) -> bool:
        """False: gizmos are not available."""
        return False

    def get_gizmo(self, uid: str, control_part: str | None = None) -> None:
        """None: gizmos are not available."""

    def list_gizmos(self) -> dict[str, bool]:
        """Empty: gizmos are not available."""
        return {}

    def update_gizmos(self) -> None:
        """Do nothing: there are no gizmos."""

    def is_window_recording(self) -> bool:
        """False: windows are not recorded."""
        return False

    def get_texture_cache(self, key: str | None = None) -> Any:
        """None: textures are compiled into the model."""
        return None

    def set_default_background(self) -> None:
        """Do nothing: the background is MuJoCo's sky and ground plane."""

    # -- what is not available ---------------------------------------------------------------------

    add_soft_object = not_available("add_soft_object", "soft bodies come later")
    add_cloth_object = not_available("add_cloth_object", "cloth comes later")
    add_rigid_object_group = not_available("add_rigid_object_group", "add objects one by one")
    create_visual_material = not_available("create_visual_material", "declare visual_material")
    get_visual_material = not_available("get_visual_material", "declare visual_material")
    clean_materials = not_available("clean_materials", "declare visual_material")
    create_rigid_constraint = not_available("create_rigid_constraint", "welds come later")
    remove_rigid_constraint = not_available("remove_rigid_constraint", "welds come later")
    export_usd = not_available("export_usd", "USD is not written")
    draw_marker = not_available("draw_marker", "add a kinematic object instead")
    remove_marker = not_available("remove_marker", "no marker can be drawn")
    enable_gizmo = not_available("enable_gizmo", _GIZMO)
    disable_gizmo = not_available("disable_gizmo", _GIZMO)
    toggle_gizmo_visibility = not_available("toggle_gizmo_visibility", _GIZMO)
    set_gizmo_visibility = not_available("set_gizmo_visibility", _GIZMO)
    visualize_point_cloud = not_available("visualize_point_cloud", "point clouds come later")
    set_indirect_lighting = not_available("set_indirect_lighting", "MuJoCo has none; add lights")
    set_emission_light = not_available("set_emission_light", "MuJoCo has none; add lights")
    set_ground_plane_visibility = not_available(
        "set_ground_plane_visibility", "SimulationManagerCfg(ground_plane=False) leaves it out"
    )
    set_texture_cache = not_available("set_texture_cache", _TEXTURES)
    render_camera_group = not_available("render_camera_group", "cameras come later")
    get_env = not_available("get_env", _ENGINE)
    get_world = not_available("get_world", _ENGINE)
    start_window_record = not_available("start_window_record", _WINDOW)
    stop_window_record = not_available("stop_window_record", _WINDOW)
    toggle_window_record = not_available("toggle_window_record", _WINDOW)
    enable_window_record_hotkey = not_available("enable_window_record_hotkey", _WINDOW)
    add_custom_window_control = not_available(
        "add_custom_window_control", "the window is MuJoCo's viewer"
    )
