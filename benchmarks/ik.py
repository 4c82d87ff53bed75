"""Inverse kinematics: success and CPU time per pose, beside mink's.

`python -m benchmarks.ik [--poses 10000] [--peer 200] [--all] [--out FILE]`: random reachable
poses of four arms (those of the tests), from the initial joint positions. mink solves quadratic
programs (daqp) pose by pose, with the same tolerances, limits and number of iterations, without
restarts. With `--all`: how many solutions a pose has, and what it costs to find them.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mink
import numpy as np

from tests.helpers.arms import arm_cfg, arm_in, random_qpos

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from embodichain.lab.sim.objects.robot import Robot

ARMS = (("ur10", True), ("ur5e", True), ("ur5e", False), ("panda", True), ("seven", True))
"""Arm, and whether its closed form is used where it has one."""


def measured(name: str, closed: bool, folder: Path, poses: int, peer: int) -> dict[str, Any]:
    """Success, errors and microseconds of CPU time per pose for one arm."""
    sim, robot = arm_in(arm_cfg(name, folder, closed_form=closed))
    solver, ids = robot.get_solver("arm"), np.zeros(poses, np.int64)
    start = np.tile(robot.read_qpos(), (poses, 1))
    qpos = start.copy()
    qpos[:, robot.get_joint_ids("arm")] = random_qpos(robot, poses)
    pos, quat = solver.forward(qpos, ids)
    found: dict[str, Any] = {"arm": name, "closed_form": solver.has_closed_form, "poses": poses}
    for label, restarts in (("restarts", True), ("first", False)):
        began = time.process_time()
        solved, reached = solver.inverse(start, pos, quat, ids, restarts=restarts)
        found[f"{label}_us"] = 1e6 * (time.process_time() - began) / poses
        found[f"{label}_success"] = float(reached.mean())
        if restarts:
            at, turned = solver.forward(solved, ids)
            found["position_error"] = float(np.linalg.norm(at - pos, axis=1)[reached].max())
            signs = np.sign((turned * quat).sum(axis=1))[:, None]
            chords = np.linalg.norm(signs * turned - quat, axis=1)
            found["rotation_error"] = float(2.0 * chords[reached].max())
    found |= with_mink(robot, pos[:peer], quat[:peer])
    sim.destroy()
    return found


def all_solutions(name: str, closed: bool, folder: Path, poses: int) -> dict[str, Any]:
    """Solutions of a pose and microseconds of CPU time per pose for one arm."""
    sim, robot = arm_in(arm_cfg(name, folder, closed_form=closed))
    solver, ids = robot.get_solver("arm"), np.zeros(poses, np.int64)
    start = np.tile(robot.read_qpos(), (poses, 1))
    qpos = start.copy()
    qpos[:, robot.get_joint_ids("arm")] = random_qpos(robot, poses)
    pos, quat = solver.forward(qpos, ids)
    began = time.process_time()
    _, exist = solver.solutions(start, pos, quat, ids)
    spent = time.process_time() - began
    found: dict[str, Any] = {"arm": name, "closed_form": solver.has_closed_form, "poses": poses}
    found |= {"solutions": float(exist.sum(axis=0).mean()), "all_us": 1e6 * spent / poses}
    sim.destroy()
    return found


def report_all(found: list[dict[str, Any]]) -> str:
    """What `all_solutions` measured, as a Markdown table."""
    lines = ["| arm | solutions of a pose, mean | us/pose |", "| --- | --- | --- |"]
    for one in found:
        arm = one["arm"] + (", closed form" if one["closed_form"] else "")
        lines.append(f"| {arm} | {one['solutions']:.1f} | {one['all_us']:.0f} |")
    return "\n".join(lines)


def with_mink(robot: Robot, pos: NDArray[Any], quat: NDArray[Any]) -> dict[str, float]:
    """Success and time of mink, from the same initial positions."""
    solver, cfg = robot.get_solver("arm"), robot.solver_cfg("arm")
    model = robot.engine.model
    configuration = mink.Configuration(model)
    body = model.body(solver.chain.body).name
    task = mink.FrameTask(body, "body", position_cost=1.0, orientation_cost=1.0, lm_damping=0.1)
    limits = [mink.ConfigurationLimit(model)]
    data = robot.engine.data_of(0)
    reached = 0
    began = time.process_time()
    for place, turn in zip(pos, quat, strict=True):
        configuration.data.mocap_pos[:], configuration.data.mocap_quat[:] = (
            data.mocap_pos,
            data.mocap_quat,
        )
        configuration.update(data.qpos.copy())
        task.set_target(mink.SE3.from_rotation_and_translation(mink.SO3(turn), place))
        for _ in range(cfg.max_iterations):
            error = task.compute_error(configuration)
            if np.linalg.norm(error[:3]) < cfg.pos_eps and np.linalg.norm(error[3:]) < cfg.rot_eps:
                reached += 1
                break
            velocity = mink.solve_ik(configuration, [task], 1.0, "daqp", limits=limits)
            configuration.integrate_inplace(velocity, 1.0)
    spent = time.process_time() - began
    return {"mink_us": 1e6 * spent / len(pos), "mink_success": reached / len(pos)}


def report(found: list[dict[str, Any]]) -> str:
    """The measurements as a Markdown table."""
    lines = [
        "| arm | reached | us/pose | first search | us/pose | error | mink | us/pose |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for one in found:
        arm = one["arm"] + (", closed form" if one["closed_form"] else "")
        errors = f"{one['position_error']:.0e} m, {one['rotation_error']:.0e} rad"
        lines.append(
            f"| {arm} | {one['restarts_success']:.4f} | {one['restarts_us']:.0f} "
            f"| {one['first_success']:.3f} | {one['first_us']:.0f} | {errors} "
            f"| {one['mink_success']:.3f} | {one['mink_us']:.0f} |"
        )
    return "\n".join(lines)


def main() -> None:
    """Measure every arm and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--poses", type=int, default=10_000)
    parser.add_argument("--peer", type=int, default=200, help="poses that mink solves")
    parser.add_argument("--all", action="store_true", help="all solutions of a pose")
    parser.add_argument("--out", type=Path, help="a JSON file")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        if given.all:
            found = [all_solutions(*arm, Path(folder), given.poses) for arm in ARMS]
        else:
            found = [measured(*arm, Path(folder), given.poses, given.peer) for arm in ARMS]
    if given.out:
        given.out.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    print(report_all(found) if given.all else report(found))


if __name__ == "__main__":
    main()
