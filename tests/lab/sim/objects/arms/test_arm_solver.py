"""Inverse kinematics: random reachable poses of several arms, limits, seeds, unreachable poses."""

import numpy as np
import pytest
import torch

from embodichain.lab.sim.cfg import RobotCfg, SolverCfg
from embodichain.utils.errors import ConfigError
from tests.helpers.arms import arm_cfg, arm_in, random_qpos

COUNT = 1000
FORK = """<mujoco><worldbody><body name="base">
  <body name="left"><joint name="l"/><geom size="0.1"/></body>
  <body name="right"><joint name="r"/><geom size="0.1"/></body>
</body></worldbody></mujoco>"""


def errors(robot, qpos, pose) -> tuple[np.ndarray, np.ndarray]:
    """Distances in metres and angles in rad between the tool at positions (m, k) and poses."""
    reached = robot.compute_batch_fk(qpos[None], "arm", env_ids=[0])[0].double().numpy()
    pose = pose.double().numpy()
    lengths = np.linalg.norm(reached[:, :3] - pose[:, :3], axis=1)
    # The sign of a quaternion has no meaning.
    signs = np.sign((reached[:, 3:] * pose[:, 3:]).sum(axis=1))
    chords = np.linalg.norm(signs[:, None] * reached[:, 3:] - pose[:, 3:], axis=1)
    return lengths, 2.0 * chords


@pytest.mark.parametrize(
    ("name", "closed"), [("ur10", True), ("ur5e", True), ("ur5e", False), ("panda", True),
                         ("seven", True)],
)  # fmt: skip
def test_random_reachable_poses_are_reached(name, closed, tmp_path) -> None:
    sim, robot = arm_in(arm_cfg(name, tmp_path, closed_form=closed))
    solver = robot.get_solver("arm")
    assert solver.has_closed_form == (closed and name.startswith("ur"))
    pose = robot.compute_batch_fk(random_qpos(robot, COUNT)[None], "arm")
    success, qpos = robot.compute_batch_ik(pose, name="arm")
    assert success.shape == (1, COUNT) and success.dtype == torch.bool
    assert success.float().mean() >= 0.99
    lengths, angles = errors(robot, qpos[0], pose[0])
    good = success[0].numpy()
    assert lengths[good].max() < 1e-4 and angles[good].max() < 1e-3
    limits = robot.get_qpos_limits("arm")[0]
    assert (qpos >= limits[:, 0] - 1e-6).all() and (qpos <= limits[:, 1] + 1e-6).all()
    sim.destroy()


@pytest.mark.parametrize("name", ["ur10", "seven"])
def test_a_result_depends_neither_on_the_number_nor_on_the_place(name, tmp_path) -> None:
    sim, robot = arm_in(arm_cfg(name, tmp_path), num_envs=5)
    pose = robot.compute_fk(random_qpos(robot, 5), "arm")
    pose[3, :3] *= 9.0  # out of reach
    solver, home = robot.get_solver("arm"), robot.read_qpos().copy()
    pos, quat = pose[:, :3].double().numpy(), pose[:, 3:].double().numpy()
    quat /= np.linalg.norm(quat, axis=1, keepdims=True)
    found, reached = solver.inverse(home, pos, quat)
    assert reached.tolist() == [True, True, True, False, True]
    for ids in ([4], [0, 3], [3, 1, 1], np.arange(5)[::-1]):
        some = np.array(ids)
        again, ok = solver.inverse(home[some], pos[some], quat[some], some)
        assert np.array_equal(again, found[some]) and np.array_equal(ok, reached[some])
    many = np.arange(640) % 5
    again, _ = solver.inverse(home[many], pos[many], quat[many], many)
    assert np.array_equal(again, found[many])
    alone, own = arm_in(arm_cfg(name, tmp_path))
    single, _ = own.get_solver("arm").inverse(home[:1], pos[2:3], quat[2:3])
    assert np.array_equal(single, found[2:3])
    sim.destroy()
    alone.destroy()


@pytest.mark.parametrize("name", ["ur10", "panda", "seven"])
def test_poses_out_of_reach_are_flagged_and_finite(name, tmp_path) -> None:
    sim, robot = arm_in(arm_cfg(name, tmp_path), num_envs=3)
    far = torch.tensor([[0.1, 5.0, 0.3], [0.1, 0.2, 0.3], [1e6, 0.0, 0.0]])
    pose = torch.cat([far, torch.tensor([[1.0, 0.0, 0.0, 0.0]] * 3)], dim=1)
    success, qpos = robot.compute_ik(pose, name="arm")
    assert not success[0] and not success[2]
    assert torch.isfinite(qpos).all()
    # The nearest that was found: the arm points at the target beside it.
    tool = robot.compute_fk(qpos, "arm")[0, :3].numpy()
    away = np.linalg.norm(tool - [0.1, 0.2, 0.3])
    ahead = (tool - [0.1, 0.2, 0.3]) @ [0.0, 1.0, 0.0]
    assert ahead > 0.6 * away and ahead > 0.4
    everything, all_qpos = robot.compute_ik(pose, name="arm", return_all_solutions=True)
    assert not everything[0].any() and torch.isfinite(all_qpos).all()
    with pytest.raises(ValueError, match="not finite in rows"):
        robot.compute_ik(pose * float("nan"), name="arm")
    sim.destroy()


def test_a_redundant_arm_approaches_its_posture(tmp_path) -> None:
    found = {}
    for elbow in (-1.0, 1.0):
        cfg = arm_cfg("seven", tmp_path, posture={"joint3": elbow})
        sim, robot = arm_in(cfg)
        qpos = torch.tensor([[0.2, 0.6, 0.0, -1.2, 0.1, 0.8, 0.3]])
        pose = robot.compute_fk(qpos, "arm")
        success, solved = robot.compute_ik(pose, qpos, "arm")
        assert success.all()
        lengths, angles = errors(robot, solved.numpy(), pose)
        assert lengths[0] < 1e-4 and angles[0] < 1e-3
        found[elbow] = float(solved[0, 2])
        sim.destroy()
    assert found[-1.0] < -0.8 and found[1.0] > 0.8


def test_joints_outside_the_part_stay_where_they_are(tmp_path) -> None:
    cfg = arm_cfg("ur10", tmp_path)
    cfg = cfg.replace(
        control_parts={"wrist": ["Joint[4-6]"], "arm": ["Joint[1-6]"]},
        solver_cfg={"wrist": SolverCfg(end_link_name="ee_link", root_link_name="forearm_link")},
    )
    sim, robot = arm_in(cfg, num_envs=2)
    robot.set_qpos(torch.tensor([0.1, -0.4, 0.5]), joint_ids=[0, 1, 2], target=False)
    pose = robot.compute_fk(torch.tensor([0.3, -0.2, 0.4]), "wrist")
    success, qpos = robot.compute_ik(pose, name="wrist")
    assert success.all() and qpos.shape == (2, 3)
    robot.set_qpos(qpos, name="wrist", target=False)
    np.testing.assert_allclose(robot.get_link_pose("ee_link")[:, :3], pose[:, :3], atol=2e-5)
    base = robot.get_control_part_base_pose("wrist")
    assert torch.equal(base, robot.get_link_pose("forearm_link"))
    sim.destroy()


def all_solutions(robot, qpos, seed):
    """The distinct solutions of `compute_ik` for the poses at positions (m, k), a row each."""
    pose = robot.compute_fk(qpos, "arm")
    exist, every = robot.compute_ik(pose, seed, "arm", return_all_solutions=True)
    return pose, exist.numpy(), every.numpy()


@pytest.mark.parametrize(("name", "most"), [("ur5e", 8), ("panda", 31), ("seven", 31)])
def test_an_iterative_arm_returns_all_solutions_that_it_finds(name, most, tmp_path) -> None:
    count = 40
    sim, robot = arm_in(arm_cfg(name, tmp_path, closed_form=False), num_envs=count)
    seed = torch.tensor(random_qpos(robot, 1, 5)[0], dtype=torch.float32)
    pose, exist, every = all_solutions(robot, random_qpos(robot, count, 1), seed)
    width = every.shape[2]
    assert every.shape == (count, 31, width) and exist.shape == (count, 31)
    counts = exist.sum(axis=1)
    assert counts.min() >= 1 and np.median(counts) >= 6
    assert (np.diff(exist.astype(int), axis=1) <= 0).all()  # those that exist come first
    padding = np.broadcast_to(seed.numpy(), every.shape)
    assert np.array_equal(every[~exist], padding[~exist])
    limits = robot.get_qpos_limits("arm")[0].numpy()
    far = ((every - seed.numpy()) ** 2).sum(axis=2)
    for i in range(count):
        mine = every[i, : counts[i]]
        assert (mine >= limits[:, 0] - 1e-6).all() and (mine <= limits[:, 1] + 1e-6).all()
        assert (np.diff(far[i, : counts[i]]) >= -1e-5).all()
        apart = np.abs(mine[:, None] - mine[None]).max(axis=2) + np.eye(len(mine))
        assert apart.min() > 0.0099
        lengths, angles = errors(robot, mine, pose[i : i + 1])
        assert lengths.max() < 1e-4 and angles.max() < 1e-3
    success, single = robot.compute_ik(pose, seed, "arm")
    assert success.all()
    turned = (single.numpy()[:, None] - every + np.pi) % (2 * np.pi) - np.pi
    assert (np.abs(turned).max(axis=2).min(axis=1) < 0.0101).all()  # one of them
    sim.destroy()
    alone, own = arm_in(arm_cfg(name, tmp_path, closed_form=False))
    again = own.compute_ik(pose[3:4], seed, "arm", return_all_solutions=True)
    assert np.array_equal(again[0].numpy(), exist[3:4])
    assert np.array_equal(again[1].numpy(), every[3:4])
    alone.destroy()


def test_searches_find_the_solutions_of_the_closed_form(tmp_path) -> None:
    found = []
    for closed in (True, False):
        cfg = arm_cfg("ur5e", tmp_path, closed_form=closed, ik_nearest_weight=[9, 4, 1, 1, 1, 1])
        sim, robot = arm_in(cfg, num_envs=50)
        _, exist, every = all_solutions(robot, random_qpos(robot, 50, 2), torch.zeros(6))
        found.append([mine[there] for mine, there in zip(every, exist, strict=True)])
        sim.destroy()
    hits = [
        np.abs(one[:, None] - few[None]).max(axis=2) < 0.01 for one, few in zip(*found, strict=True)
    ]
    total = sum(len(one) for one in found[0])
    assert sum(hit.any(axis=1).sum() for hit in hits) > 0.8 * total
    for hit in hits:  # those that both find have the same order
        places = [int(np.argmax(row)) for row in hit if row.any()]
        assert places == sorted(places)


def test_the_number_of_searches_is_a_setting(tmp_path) -> None:
    for samples in (0, 5):
        sim, robot = arm_in(arm_cfg("panda", tmp_path, num_samples=samples))
        pose = robot.compute_fk(random_qpos(robot, 1)[0], "arm")
        exist, every = robot.compute_ik(pose, name="arm", return_all_solutions=True)
        assert exist.shape == (1, 1 + samples) and every.shape == (1, 1 + samples, 7)
        pose[:, :3] += 9.0
        exist, every = robot.compute_ik(pose, name="arm", return_all_solutions=True)
        assert not exist.any()
        assert torch.equal(every, robot.get_qpos("arm")[:, None].expand_as(every))
        sim.destroy()


@pytest.mark.parametrize("name", ["ur10", "panda"])
def test_no_environments_and_no_poses_have_no_solutions(name, tmp_path) -> None:
    sim, robot = arm_in(arm_cfg(name, tmp_path), num_envs=3)
    width = len(robot.get_joint_ids("arm"))
    for every in (False, True):
        success, qpos = robot.compute_ik(
            torch.zeros(0, 7), name="arm", env_ids=[], return_all_solutions=every
        )
        assert success.shape[0] == qpos.shape[0] == 0 and qpos.shape[-1] == width
    success, qpos = robot.compute_batch_ik(torch.zeros(3, 0, 7), name="arm")
    assert success.shape == (3, 0) and qpos.shape == (3, 0, width)
    assert robot.compute_batch_fk(torch.zeros(3, 0, width), "arm").shape == (3, 0, 7)
    assert robot.compute_jacobian(env_ids=[], name="arm").shape == (0, 6, width)
    sim.destroy()


def test_mistakes_are_named(tmp_path) -> None:
    cfg = arm_cfg("panda", tmp_path, ik_nearest_weight=[1.0, 2.0])
    sim, robot = arm_in(cfg)
    with pytest.raises(ConfigError, match="needs 7 values"):
        robot.get_solver("arm")
    with pytest.raises(ValueError, match=r"no control part 'amr'.*Did you mean 'arm'"):
        robot.compute_ik(torch.zeros(1, 7), name="amr")
    sim.destroy()
    sim, robot = arm_in(arm_cfg("seven", tmp_path, posture={"elbow": 1.0}))
    with pytest.raises(ConfigError, match=r"elbow.*joint1"):
        robot.get_solver("arm")
    sim.destroy()
    sim, robot = arm_in(arm_cfg("ur10", tmp_path))
    with pytest.raises(ValueError, match=r"pose must have 3 axes, 1 environments first"):
        robot.compute_batch_ik(torch.zeros(2, 5, 7), name="arm")
    with pytest.raises(ValueError, match=r"joint_seed must have shape \(1, 6\)"):
        robot.compute_ik(torch.tensor([[0.5, 0, 0, 1, 0, 0, 0]]), torch.zeros(5), "arm")
    sim.destroy()
    path = tmp_path / "fork.xml"
    path.write_text(FORK)
    sim, robot = arm_in(RobotCfg(uid="fork", fpath=str(path)))
    with pytest.raises(ValueError, match=r"whole robot suggests no link as the tool: declare"):
        robot.compute_fk(torch.zeros(2))
    sim.destroy()
