"""A small scene with a robot, a dynamic, a kinematic and a static object."""

import numpy as np
import pytest

from embodichain.lab.sim.cfg import (
    RigidBodyAttributesCfg,
    RigidObjectCfg,
    RobotCfg,
    SimulationManagerCfg,
)
from embodichain.lab.sim.shapes import CubeCfg, SphereCfg

HOME = [1.57079, -1.57079, 1.57079, -1.57079, -1.57079, -3.14159]


def build(num_envs=3, **sim):
    """A simulation with everything added, not compiled."""
    from embodichain.lab.sim.sim_manager import SimulationManager

    manager = SimulationManager(SimulationManagerCfg(headless=True, num_envs=num_envs, **sim))
    manager.add_robot(
        RobotCfg(
            uid="ur10",
            fpath="UniversalRobots/UR10/UR10.urdf",
            init_pos=(0, 0, 1),
            init_qpos=np.array(HOME),
            control_parts={"arm": ["Joint[1-6]"], "wrist": ["Joint[4-6]"]},
        )
    )
    free = RigidBodyAttributesCfg(mass=2.0, linear_damping=0.0, angular_damping=0.0)
    manager.add_rigid_object(
        RigidObjectCfg(
            uid="box", shape=CubeCfg(size=[0.1, 0.2, 0.3]), attrs=free, init_pos=(2.0, 0.0, 1.5)
        )
    )
    manager.add_rigid_object(
        RigidObjectCfg(
            uid="goal",
            shape=SphereCfg(radius=0.02),
            body_type="kinematic",
            attrs=RigidBodyAttributesCfg(enable_collision=False),
            init_pos=(0.0, 0.0, 0.5),
        )
    )
    manager.add_rigid_object(
        RigidObjectCfg(
            uid="table", shape=CubeCfg(size=[1, 1, 0.2]), body_type="static", init_pos=(2.0, 0, 0.1)
        )
    )
    return manager


@pytest.fixture
def sim():
    manager = build()
    yield manager
    manager.destroy()
