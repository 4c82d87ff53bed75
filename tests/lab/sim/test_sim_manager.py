"""The simulation: what may be added when, lookups, resets, devices, pictures."""

import numpy as np
import pytest
import torch

from embodichain.lab.sim import SimulationManager, SimulationManagerCfg
from embodichain.lab.sim.cfg import ArticulationCfg, RigidObjectCfg, RobotCfg
from embodichain.lab.sim.drawing.views import Viewpoint, view_of
from embodichain.lab.sim.objects import ClothObject, SoftObject
from embodichain.utils.errors import ConfigError, DeviceError
from tests.lab.sim.conftest import build


def test_everything_is_found_by_its_uid(sim):
    assert sim.asset_uids == ["default_plane", "ur10", "box", "goal", "table"]
    assert sim.get_robot().uid == "ur10" and sim.get_robot("nobody") is None
    assert sim.get_rigid_object("nothing") is None
    assert sim.get_asset("box") is sim.get_rigid_object("box")
    assert sim.get_rigid_object_uid_list() == ["box", "goal", "table"]
    assert SimulationManager.get_instance(sim.instance_id) is sim


def test_nothing_is_added_after_physics_began(sim):
    sim.update(step=1)
    with pytest.raises(RuntimeError, match="add every robot and object first"):
        sim.add_rigid_object(RigidObjectCfg(uid="late"))


def test_a_uid_is_taken_once(sim):
    for uid in ("box", "default_plane"):
        with pytest.raises(ConfigError, match=f"'{uid}' is taken"):
            sim.add_rigid_object(RigidObjectCfg(uid=uid))


def test_the_same_file_twice():
    sim = SimulationManager(SimulationManagerCfg(headless=True, num_envs=2))
    for uid, x in (("left", -1.0), ("right", 1.0)):
        sim.add_robot(RobotCfg(uid=uid, fpath="UniversalRobots/UR10/UR10.urdf", init_pos=(x, 0, 1)))
    sim.get_robot("left").set_qpos(torch.full((2, 6), 0.4), target=False)
    assert not sim.get_robot("right").get_qpos().any()
    assert sim.get_robot() is None, "two robots: none is 'the' robot"


def test_a_robot_without_uid_takes_its_files_name():
    sim = SimulationManager(SimulationManagerCfg(headless=True))
    assert sim.add_robot(RobotCfg(fpath="UniversalRobots/UR10/UR10.urdf")).uid == "UR10"


@pytest.mark.parametrize(
    ("device", "match"),
    [
        ("cuda", "there is no CUDA device here"),
        ("cuda:1", "there is no CUDA device here"),
        ("cpuu", "Did you mean 'cpu'"),
        ("meta", "unknown device 'meta'; allowed: cpu, cuda, cuda:N"),
    ],
)
def test_devices_without_an_engine_are_refused(device, match):
    with pytest.raises(DeviceError, match=match):
        SimulationManager(SimulationManagerCfg(sim_device=device))


def test_devices_may_be_torch_devices():
    assert (
        SimulationManager(SimulationManagerCfg(sim_device=torch.device("cpu"))).device.type == "cpu"
    )


def test_arena_offsets_are_a_grid():
    sim = build(num_envs=5, arena_space=2.0)
    expected = [[0, 0, 0], [2, 0, 0], [4, 0, 0], [0, 2, 0], [2, 2, 0]]
    np.testing.assert_array_equal(sim.arena_offsets, expected)


def test_a_full_reset_leaves_nothing_behind():
    """The whole integration state, as Gymnasium's check_mujoco_reset_state does it."""
    sim = build()
    first = sim.engine.rows.copy()
    robot, box = sim.get_robot("ur10"), sim.get_rigid_object("box")
    robot.set_qpos(torch.randn(3, 6))
    robot.set_qf(torch.ones(3, 6))
    box.add_force_torque(force=np.ones((3, 3)), torque=np.ones((3, 3)))
    sim.get_rigid_object("goal").set_local_pose(torch.tensor([[1.0, 2, 3, 0, 1, 0, 0]] * 3))
    sim.update(step=17)
    sim.reset_objects_state(env_ids=[0, 2])
    np.testing.assert_array_equal(sim.engine.rows[[0, 2]], first[[0, 2]])
    assert not np.array_equal(sim.engine.rows[1], first[1])
    sim.reset_objects_state()
    np.testing.assert_array_equal(sim.engine.rows, first)


def test_physics_dt_is_compiled(sim):
    sim.update(0.01, 2)
    with pytest.raises(ValueError, match="compiled into the scene"):
        sim.update(0.02, 2)
    with pytest.raises(ValueError, match="negative"):
        sim.update(step=-1)


@pytest.mark.parametrize("num_envs", [1, 3, 64])
@pytest.mark.parametrize("threads", [1, 2, 5])
@pytest.mark.parametrize("persistent", [True, False])
def test_environment_0_has_the_same_bytes_in_every_batch(num_envs, threads, persistent):
    def run(sim):
        robot, out = sim.get_robot("ur10"), []
        for k in range(12):
            index = torch.arange(sim.num_envs)[:, None]
            robot.set_qpos(torch.sin(0.5 * k + index + torch.arange(6.0)))
            sim.update(step=4)
            if k == 6:
                sim.reset_objects_state(env_ids=np.arange(0, sim.num_envs, 2))
            out += [robot.get_qf()[0], robot.get_link_pose("ee_link")[0], robot.get_qvel()[0]]
        return sim.engine.rows[0].tobytes() + torch.cat(out).numpy().tobytes()

    assert run(build(num_envs, num_threads=threads, persistent=persistent)) == run(build(1))


def test_pictures_of_all_environments_in_one_call(sim):
    """As one by one, from a camera and from elsewhere; in any order of environments."""
    engine = sim.engine
    above = Viewpoint.look_at((0.5, 0.1, 2.0), (0.0, 0.0, 0.0))
    for camera in ("default", 0, above):
        every = sim.render(None, camera, 40, 30)
        assert every.shape == (sim.num_envs, 30, 40, 3) and every.dtype == np.uint8
        for env, picture in enumerate(every):
            np.testing.assert_array_equal(sim.render(env, camera, 40, 30), picture)
    views = [
        view_of(engine, "default", 24, 16, outputs=("color", "depth")),
        view_of(engine, above, 32, 32, outputs=("mask",)),
    ]
    first, second = sim.draw(views)
    assert {name: values.shape[1:] for name, values in first.items()} == {
        "color": (16, 24, 4),
        "depth": (16, 24),
    }
    assert set(second) == {"mask"} and second["mask"].shape == (sim.num_envs, 32, 32)
    (last,) = sim.draw(views[1:], [sim.num_envs - 1])
    np.testing.assert_array_equal(last["mask"][0], second["mask"][-1])
    with pytest.raises(ValueError, match="env_ids"):
        sim.draw(views, [sim.num_envs])


def test_a_picture_shows_the_scene(sim):
    picture = sim.render(env_id=1, width=160, height=120)
    assert picture.shape == (120, 160, 3) and picture.dtype == np.uint8
    assert picture.std() > 5, "not one flat colour"
    rows = sim.engine.rows.copy()
    other = sim.render(env_id=1, width=160, height=120)
    np.testing.assert_array_equal(picture, other)
    np.testing.assert_array_equal(sim.engine.rows, rows)
    with pytest.raises(ValueError, match="default"):
        sim.render(camera="defualt")
    with pytest.raises(ValueError, match=r"\[0, 3\)"):
        sim.render(env_id=3)


def test_what_is_not_here_yet_says_so(sim):
    with pytest.raises(NotImplementedError, match="soft bodies"):
        sim.add_soft_object(None)
    for cls in (SoftObject, ClothObject):
        with pytest.raises(NotImplementedError):
            cls()


def test_a_files_own_actuators_start_at_its_keyframe(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(
        '<mujoco><worldbody><body name="b"><joint name="j" axis="0 1 0"/>'
        '<geom size=".1" mass="1"/></body></worldbody>'
        '<actuator><motor name="m" joint="j"/></actuator>'
        '<keyframe><key name="home" qpos="0.3" ctrl="0.7"/></keyframe></mujoco>'
    )
    sim = SimulationManager(SimulationManagerCfg(headless=True, num_envs=2))
    sim.add_articulation(ArticulationCfg(uid="arm", fpath=str(path)))
    assert sim.engine.state("ctrl").tolist() == [[0.7], [0.7]]
    assert sim.engine.state("qpos").tolist() == [[0.3], [0.3]]
    sim.engine.write("ctrl", 0.0)
    sim.get_articulation("arm").reset(env_ids=[1])
    assert sim.engine.state("ctrl").tolist() == [[0.0], [0.7]]
    with pytest.raises(ValueError, match="no drive"):
        sim.get_articulation("arm").set_qpos([0.1])


def test_physics_can_be_switched_off(sim):
    box = sim.get_rigid_object("box")
    sim.enable_physics(False)
    before = box.get_local_pose()
    sim.update(step=5)
    assert torch.equal(box.get_local_pose(), before)
    moved = before.clone()
    moved[:, 2] += 1.0
    box.set_local_pose(moved)
    sim.update(step=5)
    assert torch.equal(box.get_local_pose(), moved)
    assert (sim.engine.state("time") == 0).all()
    sim.enable_physics(True)
    sim.update(step=5)
    assert (sim.engine.state("time") > 0).all()
