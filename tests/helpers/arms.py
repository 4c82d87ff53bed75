"""Arms for tests of kinematics: two of files, two written here from their parameters."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from embodichain.lab.sim.cfg import RobotCfg, SimulationManagerCfg, SolverCfg
from embodichain.lab.sim.sim_manager import SimulationManager

HALF = np.pi / 2
UR5E = (
    # theta's joint: d, a, alpha. Universal Robots, "DH parameters for calculations of kinematics
    # and dynamics".
    (0.1625, 0.0, HALF),
    (0.0, -0.425, 0.0),
    (0.0, -0.3922, 0.0),
    (0.1333, 0.0, HALF),
    (0.0997, 0.0, -HALF),
    (0.0996, 0.0, 0.0),
)
SEVEN = (
    # A shoulder, elbow and wrist of seven alternating axes.
    (0.34, 0.0, -HALF),
    (0.0, 0.0, HALF),
    (0.40, 0.0, HALF),
    (0.0, 0.0, -HALF),
    (0.39, 0.0, -HALF),
    (0.0, 0.0, HALF),
    (0.13, 0.0, 0.0),
)
SEVEN_LIMIT = (2.9, 2.0, 2.9, 2.0, 2.9, 2.0, 3.0)

GANTRY = """<mujoco model="gantry"><worldbody><body name="base"><geom size="0.05" mass="1"/>
  <body name="cart" pos="0.1 0 0.2" euler="10 20 30">
    <joint name="x" type="slide" axis="1 0.5 0" range="-1 1"/><geom size="0.05" mass="1"/>
    <body name="arm" pos="0 0.1 0.1">
      <joint name="pan" axis="0 0 1" pos="0.05 0.02 0" range="-3 3"/>
      <joint name="tilt" axis="0 1 0.3" pos="0 0 0.1" range="-3 3"/>
      <geom size="0.05" mass="1"/>
      <body name="plate" pos="0.3 0 0" euler="0 0 45"><geom size="0.02" mass="0.1"/>
        <body name="lift" pos="0 0 0.1"><joint name="z" type="slide" axis="0 0 1" range="-1 1"/>
          <geom size="0.02" mass="0.1"/>
          <body name="tip" pos="0.05 0 0.02"><geom size="0.01" mass="0.1"/></body>
      </body></body>
    </body>
  </body>
</body></worldbody></mujoco>"""
"""Two slides and two hinges whose axes are not at the origins of bodies."""


def dh_matrix(d: float, a: float, alpha: float, theta: float) -> np.ndarray:
    """Rz(theta) Tz(d) Tx(a) Rx(alpha)."""
    ct, st, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
    return np.array(
        [
            [ct, -st * ca, st * sa, a * ct],
            [st, ct * ca, -ct * sa, a * st],
            [0, sa, ca, d],
            [0, 0, 0, 1],
        ]
    )


def dh_model(name: str, rows: tuple[tuple[float, float, float], ...], limits) -> str:
    """MJCF of an arm with Denavit-Hartenberg parameters; the last body is ``tool``."""
    text, close, place = "", "", 'pos="0 0 0"'
    for number, ((d, a, alpha), limit) in enumerate(zip(rows, limits, strict=True), 1):
        text += f'<body name="link{number}" {place}><inertial pos="0 0 0" mass="1" '
        text += 'diaginertia="0.01 0.01 0.01"/>'
        text += f'<joint name="joint{number}" axis="0 0 1" range="{-limit} {limit}"/>'
        place = f'pos="{a} 0 {d}" euler="{alpha} 0 0"'
        close += "</body>"
    text += f'<body name="tool" {place}/>'
    return (
        f'<mujoco model="{name}"><compiler angle="radian"/><worldbody><body name="base">'
        f"{text}{close}</body></worldbody></mujoco>"
    )


def arm_cfg(name: str, folder: Path, **solver) -> RobotCfg:
    """The config of ``ur10``, ``panda``, ``ur5e``, ``seven`` or ``gantry``, on a tilted base."""
    place = {"init_pos": (0.1, 0.2, 0.3), "init_rot": (10.0, 20.0, 30.0)}
    if name == "ur10":
        fpath, link, joints = "UniversalRobots/UR10/UR10.urdf", "ee_link", "Joint[1-6]"
    elif name == "panda":
        fpath, link = "panda_description/urdf/panda.urdf", "panda_hand"
        joints = "panda_joint[1-7]"
    else:
        file = folder / f"{name}.xml"
        if name == "ur5e":
            file.write_text(dh_model(name, UR5E, [6.28] * 6))
        elif name == "seven":
            file.write_text(dh_model(name, SEVEN, SEVEN_LIMIT))
        else:
            file.write_text(GANTRY)
        fpath, link, joints = str(file), "tip" if name == "gantry" else "tool", ".*"
    tool = SolverCfg(end_link_name=link, **solver)
    parts = {"arm": [joints]}
    return RobotCfg(uid="arm", fpath=fpath, control_parts=parts, solver_cfg={"arm": tool}, **place)


def arm_in(cfg: RobotCfg, num_envs: int = 1):
    """A simulation with the arm alone, and its handle."""
    sim = SimulationManager(SimulationManagerCfg(headless=True, num_envs=num_envs, num_threads=1))
    return sim, sim.add_robot(cfg)


def random_qpos(robot, count: int, seed: int = 0) -> np.ndarray:
    """(count, k) positions of the part ``arm``, uniform between its limits, within one turn."""
    joints = robot.get_joint_ids("arm")
    low, high = robot.drives.limits.values[0, joints].T
    bounds = np.maximum(low, -np.pi), np.minimum(high, np.pi)
    return np.random.default_rng(seed).uniform(*bounds, (count, len(joints)))
