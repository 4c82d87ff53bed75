"""The closed form of the UR family: eight solutions, each of which reproduces the pose."""

import numpy as np
import pytest
import torch

from tests.helpers.arms import arm_cfg, arm_in, random_qpos

COUNT = 500


def spread(angles: np.ndarray) -> np.ndarray:
    """Differences of angles, in [-pi, pi]."""
    return np.abs((angles + np.pi) % (2 * np.pi) - np.pi)


@pytest.mark.parametrize("name", ["ur10", "ur5e"])
def test_eight_solutions_reproduce_the_pose_and_contain_the_given_one(name, tmp_path) -> None:
    sim, robot = arm_in(arm_cfg(name, tmp_path))
    solver = robot.get_solver("arm")
    given = random_qpos(robot, COUNT)
    ids = np.zeros(COUNT, np.int64)
    pos, quat = solver.forward(given, ids)
    found, exist = solver.solutions(given, pos, quat, ids)
    assert found.shape == (8, COUNT, 6)
    # Four wrist and elbow solutions exist or not together with each of the two shoulders.
    assert exist.sum(axis=0).min() >= 2 and (exist.sum(axis=0) == 8).mean() > 0.4
    for solution, there in zip(found, exist, strict=True):
        reached, turned = solver.forward(solution, ids)
        assert np.abs(reached - pos)[there].max() < 1e-9
        assert np.abs(np.abs((turned * quat).sum(axis=1)) - 1.0)[there].max() < 1e-9
    gaps = spread(found - given).max(axis=2)
    assert gaps.min(axis=0).max() < 1e-6
    # Different from each other, except near singular poses.
    apart = [spread(found[i] - found[j]).max(axis=1) for i in range(8) for j in range(i)]
    full = exist.all(axis=0)
    assert np.median(np.min(apart, axis=0)[full]) > 0.1
    sim.destroy()


def test_the_nearest_solution_within_limits_comes_first(tmp_path) -> None:
    sim, robot = arm_in(arm_cfg("ur10", tmp_path))
    given = random_qpos(robot, 50)
    for seed in given[:5]:
        pose = robot.compute_fk(seed, "arm")
        near = torch.tensor(seed + 0.02)
        success, qpos = robot.compute_ik(pose, near, "arm")
        assert success.all()
        np.testing.assert_allclose(qpos[0], seed, atol=1e-4)
        # A whole turn away the same solution is the nearest one, where limits allow it.
        turned = seed.copy()
        turned[5] += 2 * np.pi if seed[5] < 0 else -2 * np.pi
        _, qpos = robot.compute_ik(pose, turned, "arm")
        np.testing.assert_allclose(qpos[0], turned, atol=1e-4)
        exist, every = robot.compute_ik(pose, near, "arm", return_all_solutions=True)
        gaps = ((every[0] - near) ** 2).sum(axis=1)[exist[0]]
        assert (gaps[1:] >= gaps[:-1] - 1e-6).all()
    low, high = robot.get_qpos_limits("arm")[0].T
    assert (every[exist] >= low - 1e-6).all() and (every[exist] <= high + 1e-6).all()
    sim.destroy()


def test_weights_choose_the_solution(tmp_path) -> None:
    weights, chosen = [1.0, 1.0, 1.0, 1.0, 1.0, 20.0], []
    for given in (None, weights):
        sim, robot = arm_in(arm_cfg("ur10", tmp_path, ik_nearest_weight=given))
        qpos, seeds = (random_qpos(robot, 40, seed)[None] for seed in (0, 1))
        pose = robot.compute_batch_fk(qpos, "arm")
        chosen.append(robot.compute_batch_ik(pose, seeds, "arm")[1][0].numpy())
        sim.destroy()
    plain, weighted = (
        [(factors * (found - seeds[0]) ** 2).sum(axis=1) for found in chosen]
        for factors in (np.ones(6), np.array(weights))
    )
    assert (plain[0] <= plain[1] + 1e-5).all() and (plain[0] < plain[1] - 1e-3).any()
    assert (weighted[1] <= weighted[0] + 1e-5).all()


def test_singular_poses_have_solutions(tmp_path) -> None:
    sim, robot = arm_in(arm_cfg("ur5e", tmp_path))
    for qpos in ([0.3, -1.0, 1.2, 0.5, 0.0, 0.7], [0.1, -0.6, 0.0, 0.4, 1.0, 0.2], [0.0] * 6):
        pose = robot.compute_fk(torch.tensor(qpos), "arm")
        success, found = robot.compute_ik(pose, torch.tensor(qpos) + 0.01, "arm")
        again = robot.compute_fk(found, "arm")
        assert success.all() and torch.allclose(again[:, :3], pose[:, :3], atol=1e-4)
    sim.destroy()


def test_a_seed_that_solves_stays_to_the_bit(tmp_path) -> None:
    sim, robot = arm_in(arm_cfg("ur5e", tmp_path))
    solver = robot.get_solver("arm")
    for qpos in ([0.3, -1.0, 1.2, 0.5, 0.9, 0.7], [0.3, -1.0, 1.2, 0.5, 0.0, 0.7]):
        seed = np.array([qpos])  # the second with axes 4 and 6 parallel
        found, reached = solver.inverse(seed, *solver.forward(seed))
        assert reached.all() and np.array_equal(found, seed)
    sim.destroy()


def test_other_arms_have_no_closed_form(tmp_path) -> None:
    sim, robot = arm_in(arm_cfg("panda", tmp_path))
    assert not robot.get_solver("arm").has_closed_form
    sim.destroy()
