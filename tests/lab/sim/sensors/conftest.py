"""`scene(...)`: small simulations with objects and sensors, closed after the test."""

from collections.abc import Callable, Iterator
from typing import Any

import pytest

from embodichain.lab.sim.cfg import (
    PhysicsCfg,
    RigidBodyAttributesCfg,
    RigidObjectCfg,
    SimulationManagerCfg,
)
from embodichain.lab.sim.shapes import CubeCfg


def cube(uid: str, pos: Any = (0, 0, 0.05), mass: float = 2.0, **kwargs: Any) -> RigidObjectCfg:
    """A cube of 10 cm that nothing but contacts and gravity slows down."""
    attrs = RigidBodyAttributesCfg(mass=mass, linear_damping=0.0, angular_damping=0.0)
    shape = CubeCfg(size=[0.1, 0.1, 0.1])
    return RigidObjectCfg(uid=uid, shape=shape, attrs=attrs, init_pos=pos, **kwargs)


@pytest.fixture
def scene() -> Iterator[Callable[..., Any]]:
    """Builds `(entities, sensors)` -> simulation; keywords are `SimulationManagerCfg`'s."""
    from embodichain.lab.sim.sim_manager import SimulationManager

    built = []

    def build(objects: Any, sensors: Any, robots: Any = (), gravity: float = 9.81, **kw: Any):
        physics = PhysicsCfg(gravity=[0.0, 0.0, -gravity])
        kw = {"num_envs": 3, "num_threads": 1, **kw}
        sim = SimulationManager(SimulationManagerCfg(headless=True, physics_config=physics, **kw))
        built.append(sim)
        for cfg in robots:
            sim.add_robot(cfg)
        for cfg in objects:
            sim.add_rigid_object(cfg)
        for cfg in sensors:
            sim.add_sensor(cfg)
        return sim

    yield build
    for sim in built:
        sim.destroy()
