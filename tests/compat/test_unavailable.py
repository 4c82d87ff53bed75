"""Methods of EmbodiChain's `SimulationManager`: there, and true, or refused with the reason."""

import pytest

from embodichain.lab.sim import SimulationManager, SimulationManagerCfg
from embodichain.lab.sim.cfg import LightCfg, RigidObjectCfg

MEMBERS = [
    "add_articulation",
    "add_custom_window_control",
    "add_light",
    "add_rigid_object",
    "add_rigid_object_group",
    "add_robot",
    "add_sensor",
    "add_soft_object",
    "add_cloth_object",
    "arena_offsets",
    "asset_uids",
    "clean_materials",
    "close_window",
    "create_visual_material",
    "destroy",
    "disable_gizmo",
    "draw_marker",
    "enable_gizmo",
    "enable_physics",
    "enable_window_record_hotkey",
    "export_usd",
    "flush_cleanup_queue",
    "get_articulation",
    "get_articulation_uid_list",
    "get_asset",
    "get_cloth_object",
    "get_cloth_object_uid_list",
    "get_env",
    "get_gizmo",
    "get_instance",
    "get_instance_num",
    "get_light",
    "get_light_uid_list",
    "get_rigid_object",
    "get_rigid_object_group",
    "get_rigid_object_group_uid_list",
    "get_rigid_object_uid_list",
    "get_robot",
    "get_robot_uid_list",
    "get_sensor",
    "get_sensor_uid_list",
    "get_soft_object",
    "get_soft_object_uid_list",
    "get_texture_cache",
    "get_visual_material",
    "get_world",
    "has_gizmo",
    "has_non_static_rigid_object",
    "init_gpu_physics",
    "is_instantiated",
    "is_physics_manually_update",
    "is_use_gpu_physics",
    "is_window_recording",
    "list_gizmos",
    "num_envs",
    "open_window",
    "remove_asset",
    "remove_marker",
    "render_camera_group",
    "reset",
    "reset_objects_state",
    "set_default_background",
    "set_emission_light",
    "set_gizmo_visibility",
    "set_ground_plane_visibility",
    "set_indirect_lighting",
    "set_manual_update",
    "set_texture_cache",
    "start_window_record",
    "stop_window_record",
    "toggle_gizmo_visibility",
    "toggle_window_record",
    "update",
    "update_gizmos",
    "wait_scene_destruction",
]
"""Public members of release 0.2.1."""


@pytest.fixture
def sim():
    manager = SimulationManager(SimulationManagerCfg(headless=True))
    yield manager
    manager.destroy()


@pytest.mark.parametrize("name", MEMBERS)
def test_every_member_exists(sim, name):
    assert hasattr(sim, name)


def test_what_scripts_ask_before_they_start(sim, caplog):
    assert (sim.is_use_gpu_physics, sim.is_physics_manually_update) == (False, True)
    sim.set_manual_update(True)
    assert caplog.text == ""
    sim.set_manual_update(False)
    assert "physics advances in update() only" in caplog.text
    assert not sim.has_non_static_rigid_object
    sim.add_rigid_object(RigidObjectCfg(uid="wall", body_type="static"))
    assert not sim.has_non_static_rigid_object
    sim.add_rigid_object(RigidObjectCfg(uid="cube"))
    assert sim.has_non_static_rigid_object
    lamp = sim.add_light(LightCfg(uid="lamp"))
    assert sim.get_light("lamp") is lamp and sim.get_light_uid_list() == ["lamp"]
    assert sim.get_light("none") is None and not sim.has_gizmo("cube")
    with pytest.raises(NotImplementedError, match="scene.model"):
        sim.get_world()


def test_simulations_are_counted_and_reset_destroys_one():
    before = SimulationManager.get_instance_num()
    sim = SimulationManager(SimulationManagerCfg(headless=True))
    number = sim.instance_id
    assert SimulationManager.is_instantiated(number)
    assert SimulationManager.get_instance_num() == before + 1
    SimulationManager.reset(number)
    assert not SimulationManager.is_instantiated(number)
    SimulationManager.reset(number)
    SimulationManager.flush_cleanup_queue()
    with pytest.raises(RuntimeError, match="destroyed"):
        sim.update(step=1)
