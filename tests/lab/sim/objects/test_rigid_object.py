"""Rigid objects: poses, velocities, forces and masses per environment."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation


def poses(n=3, seed=0):
    rotation = Rotation.random(n, random_state=seed).as_quat()[:, [3, 0, 1, 2]]
    position = np.random.default_rng(seed).uniform(-1, 1, (n, 3)) + np.array([0, 0, 3])
    return np.concatenate([position, rotation], 1)


@pytest.mark.parametrize("uid", ["box", "goal", "table"])
@pytest.mark.parametrize("kind", ["numpy", "torch", "matrix"])
def test_a_pose_written_is_the_pose_read(sim, uid, kind):
    obj = sim.get_rigid_object(uid)
    wanted = poses()
    given = wanted
    if kind == "torch":
        given = torch.from_numpy(wanted).float()
    if kind == "matrix":
        given = torch.eye(4).repeat(3, 1, 1)
        given[:, :3, :3] = torch.from_numpy(Rotation.from_quat(wanted[:, [4, 5, 6, 3]]).as_matrix())
        given[:, :3, 3] = torch.from_numpy(wanted[:, :3])
    obj.set_local_pose(given)
    got = obj.get_local_pose()
    assert got.shape == (3, 7) and got.dtype == torch.float32
    sign = torch.sign((got[:, 3:] * torch.from_numpy(wanted[:, 3:])).sum(1, keepdim=True))
    np.testing.assert_allclose(got[:, :3], wanted[:, :3], atol=1e-6)
    np.testing.assert_allclose(got[:, 3:] * sign, wanted[:, 3:], atol=1e-6)
    matrix = obj.get_local_pose(to_matrix=True)
    np.testing.assert_allclose(
        matrix[:, :3, :3], Rotation.from_quat(wanted[:, [4, 5, 6, 3]]).as_matrix(), atol=1e-6
    )
    # Physics sees it too: the body's frame in the simulation is there.
    body = obj.entity.root_body_id
    np.testing.assert_allclose(sim.engine.derived("xpos")[:, body], wanted[:, :3], atol=1e-6)


def test_a_partial_write_moves_nobody_else(sim):
    box = sim.get_rigid_object("box")
    before = sim.engine.rows.copy()
    box.set_local_pose(poses()[:1], env_ids=[1])
    np.testing.assert_array_equal(sim.engine.rows[[0, 2]], before[[0, 2]])
    box.set_local_pose(poses()[:2], env_ids=torch.tensor([True, False, True]))
    np.testing.assert_allclose(box.get_local_pose()[2, :3], poses()[1, :3], atol=1e-6)


@pytest.mark.parametrize(
    ("pose", "env_ids", "match"),
    [
        (np.zeros((3, 6)), None, r"\(3, 7\)"),
        (poses()[:2], None, r"\(3, 7\)"),
        (poses(), [0, 1], r"\(2, 7\)"),
        (poses()[:2], [1, 0], "sorted"),
        (poses()[:2], [1, 1], "unique"),
        (poses()[:2], [2, 3], r"\[0, 3\)"),
        (poses()[:2], [0.5, 1.5], "integers"),
        (poses(), [True, False], "mask"),
        (poses() * np.nan, None, "not finite"),
        (np.zeros((3, 7)), None, "quaternion"),
    ],
)
def test_bad_poses_raise_and_change_nothing(sim, pose, env_ids, match):
    before = sim.engine.rows.copy()
    with pytest.raises(ValueError, match=match):
        sim.get_rigid_object("box").set_local_pose(pose, env_ids)
    np.testing.assert_array_equal(sim.engine.rows, before)


def test_velocities_are_in_world_axes(sim):
    box = sim.get_rigid_object("box")
    box.set_local_pose(poses())
    lin, ang = np.eye(3), np.array([[0, 0, 1.0], [1, 0, 0], [0, 1, 0]])
    box.set_velocity(lin, ang)
    np.testing.assert_allclose(box.body_data.vel, np.concatenate([lin, ang], 1), atol=1e-6)
    # A short flight confirms the axes: orientation turns about the world axis given.
    before = Rotation.from_quat(box.get_local_pose()[:, [4, 5, 6, 3]])
    sim.engine.write("qvel", 0.0, None, slice(box.entity.free_qvel_adr, None))
    box.set_velocity(lin, ang)
    sim.update(step=1)
    turn = Rotation.from_quat(box.get_local_pose()[:, [4, 5, 6, 3]]) * before.inv()
    np.testing.assert_allclose(turn.as_rotvec(), ang * 0.01, atol=2e-4)


def test_wrong_velocities_change_nothing(sim):
    box = sim.get_rigid_object("box")
    box.set_velocity(np.eye(3), np.eye(3))
    before = sim.engine.state("qvel").copy()
    with pytest.raises(ValueError, match="ang_vel must have shape"):
        box.set_velocity(np.zeros((3, 3)), np.zeros((2, 3)))
    np.testing.assert_array_equal(sim.engine.state("qvel"), before)


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("damping", np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]])),
        ("friction", np.array([0.5, 0.25, 0.75])),
        ("body_scale", np.array([[1.0, 2.0, 0.5]] * 3)),
    ],
)
def test_tensors_and_arrays_of_a_value_are_the_same(sim, name, values):
    """What users set by tensors is what terms read as arrays, in single environments too."""
    box = sim.get_rigid_object("box")
    read = getattr(box, f"read_{name.removeprefix('body_')}")
    getattr(box, f"set_{name}")(values)
    np.testing.assert_allclose(read(), values)
    getattr(box, f"set_{name}")(2.0 * values[1:2], env_ids=[1])
    np.testing.assert_allclose(
        read(), values * np.reshape([1, 2, 1], (3, *[1] * (values.ndim - 1)))
    )
    np.testing.assert_allclose(getattr(box, f"get_{name}")(env_ids=[1]), 2.0 * values[1:2])


def test_kinematic_objects_do_not_fall_and_static_ones_do_not_move(sim):
    start = {u: sim.get_rigid_object(u).get_local_pose() for u in ("goal", "table", "box")}
    sim.update(step=20)
    for uid in ("goal", "table"):
        assert torch.equal(sim.get_rigid_object(uid).get_local_pose(), start[uid])
    assert (sim.get_rigid_object("box").get_local_pose()[:, 2] < start["box"][:, 2]).all()
    assert sim.get_rigid_object("table").body_data is None


def test_force_accelerates_by_mass(sim):
    box = sim.get_rigid_object("box")
    box.add_force_torque(force=[[4.0, 0, 0], [0, 0, 0], [0, 0, 2 * 9.81]])
    sim.update(step=1)
    np.testing.assert_allclose(
        box.body_data.lin_acc, [[2.0, 0, -9.81], [0, 0, -9.81], [0, 0, 0]], atol=1e-4
    )
    box.clear_dynamics()
    assert not box.body_data.vel.any()
    assert not sim.engine.state("xfrc_applied").any()


def test_damping_is_a_rate(sim):
    box = sim.get_rigid_object("box")
    rates = [[0.0, 0.0], [0.5, 0.0], [0.0, 0.5]]
    box.set_damping(rates)
    np.testing.assert_array_equal(box.get_damping(), rates)
    np.testing.assert_array_equal(box.get_damping([2]), rates[2:])
    sim.engine.write_model("opt.gravity", 0.0)
    box.set_velocity(np.tile([[1.0, 0, 0]], (3, 1)), np.tile([[0, 0, 1.0]], (3, 1)))
    sim.update(step=100)
    expected = np.exp(-0.5 * 1.0)
    vel = box.body_data.vel
    np.testing.assert_allclose(vel[:, 0], [1, expected, 1], rtol=5e-3)
    np.testing.assert_allclose(vel[:, 5], [1, 1, expected], rtol=5e-3)


def test_mass_scales_inertia_and_physics_follows(sim):
    box = sim.get_rigid_object("box")
    inertia = box.get_inertia()
    a, b, c = 0.1, 0.2, 0.3
    solid = np.sort([2 / 12 * (b * b + c * c), 2 / 12 * (a * a + c * c), 2 / 12 * (a * a + b * b)])
    np.testing.assert_allclose(np.sort(inertia[0]), solid, rtol=1e-5)
    box.set_mass([4.0], env_ids=[1])
    np.testing.assert_allclose(box.get_mass(), [2, 4, 2])
    np.testing.assert_allclose(box.get_inertia()[1], 2 * inertia[1], rtol=1e-6)
    box.add_force_torque(force=np.tile([[4.0, 0, 0]], (3, 1)))
    sim.update(step=1)
    np.testing.assert_allclose(box.body_data.lin_acc[:, 0], [2, 1, 2], atol=1e-4)
    with pytest.raises(ValueError, match="positive"):
        box.set_mass([0.0, 1.0, 1.0])
    with pytest.raises(ValueError, match="sum"):
        box.set_inertia([[1.0, 1.0, 5.0]] * 3)


def test_friction_and_collision_per_environment(sim):
    box = sim.get_rigid_object("box")
    box.set_local_pose(np.tile([[2.0, 0, 0.35, 1, 0, 0, 0]], (3, 1)))
    box.set_friction([0.0, 0.2, 0.2])
    sim.get_rigid_object("table").set_friction([0.0, 0.2, 0.2])
    box.enable_collision(torch.tensor([True, True, False]))
    sim.update(step=50)
    box.set_velocity(np.tile([[1.0, 0, 0]], (3, 1)), np.zeros((3, 3)))
    sim.update(step=20)
    pose, vel = box.get_local_pose(), box.body_data.lin_vel
    # Coulomb: v = v0 - mu g t, no tipping below mu = width / height.
    np.testing.assert_allclose(vel[:2, 0], [1.0, 1.0 - 0.2 * 9.81 * 0.2], atol=0.02)
    assert pose[2, 2] < 0.2 < pose[1, 2], "without collision it falls through the table"
    np.testing.assert_allclose(box.get_friction(), [0, 0.2, 0.2])


def test_what_only_dynamic_bodies_can_do_says_so(sim):
    with pytest.raises(ValueError, match="body_type: dynamic"):
        sim.get_rigid_object("goal").set_velocity(np.zeros((3, 3)))
    with pytest.raises(NotImplementedError, match="set_body_type"):
        sim.get_rigid_object("box").set_body_type("static")


def test_reset_of_one_object_leaves_the_rest(sim):
    box, goal = sim.get_rigid_object("box"), sim.get_rigid_object("goal")
    start = box.get_local_pose()
    box.set_local_pose(poses())
    goal.set_local_pose(poses())
    moved = goal.get_local_pose()
    box.reset(env_ids=[0, 2])
    assert torch.equal(box.get_local_pose()[[0, 2]], start[[0, 2]])
    assert not torch.equal(box.get_local_pose()[1], start[1])
    assert torch.equal(goal.get_local_pose(), moved)


def test_tensors_handed_out_are_the_callers(sim):
    box = sim.get_rigid_object("box")
    pose = box.get_local_pose()
    kept = pose.clone()
    sim.update(step=10)
    assert torch.equal(pose, kept)
    pose += 1
    assert not torch.equal(box.get_local_pose(), pose)
