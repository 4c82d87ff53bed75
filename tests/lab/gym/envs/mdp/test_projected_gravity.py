"""The direction of gravity in a body's axes: of the scene, of each environment, without gravity."""

from typing import Any

import numpy as np
import pytest

from embodichain.lab.gym.envs.cfg import EventCfg, ObservationCfg, PhysicsTaskCfg
from embodichain.lab.sim.cfg import RigidObjectCfg
from embodichain.lab.sim.configs.physics_cfg import FlagsCfg
from embodichain.lab.sim.sensors import ImuSensorCfg, LinksCfg
from embodichain.lab.sim.shapes import CubeCfg
from tests.helpers.ur10_task import builder

CUBE = {"entity_cfg": {"uid": "cube"}}
TERMS = {
    "of": ObservationCfg("projected_gravity", CUBE),
    "imu": ObservationCfg("imu_projected_gravity", {"sensor": "imu"}),
    "flat": ObservationCfg("projected_gravity", {**CUBE, "axes": "xy"}),
    "up": ObservationCfg("upright", CUBE),
}


def observed(**sections: Any) -> dict[str, np.ndarray]:
    """The entries after a reset; the cube, turned by 90 degrees, has the world's y as its x."""
    cube = RigidObjectCfg(
        shape=CubeCfg(size=[0.1, 0.1, 0.1]), init_pos=(0.5, 0.5, 0.5), init_rot=(0, 0, 90)
    )
    imu = ImuSensorCfg(entity_cfg=LinksCfg(uid="cube"), observe=True)
    with builder() as build:
        env = build(objects={"cube": cube}, sensors={"imu": imu}, observations=TERMS, **sections)
        obs, _ = env.reset()
        found = {name: obs[name].numpy() for name in TERMS}
        found["read"] = obs["sensor", "imu", "projected_gravity"].numpy()
        found["fields"] = np.array(env.sim.engine.model_values("opt.gravity"))
    return found


def in_axes(gravity: np.ndarray) -> np.ndarray:
    """(N, 3) its direction in the cube's axes, worked out by hand."""
    unit = gravity / np.linalg.norm(gravity, axis=1, keepdims=True)
    return np.stack([unit[:, 1], -unit[:, 0], unit[:, 2]], axis=1)


@pytest.mark.parametrize("gravity", [(0.0, 0.0, -9.81), (4.0, 0.0, -9.0), (0.0, -2.0, 1.0)])
def test_it_is_that_of_the_scene(gravity) -> None:
    found = observed(physics=PhysicsTaskCfg(gravity=list(gravity)))
    wanted = np.tile(in_axes(np.array([gravity])), (3, 1))
    if gravity[0]:
        np.testing.assert_allclose(wanted[0], [0, -0.406, -0.914], atol=1e-3)
    for name in ("of", "imu", "read"):
        np.testing.assert_allclose(found[name], wanted, atol=1e-6)
    np.testing.assert_allclose(found["flat"], wanted[:, :2], atol=1e-6)
    np.testing.assert_allclose(found["up"], 1.0, atol=1e-6)  # about the vertical


@pytest.mark.parametrize("mode", ["startup", "reset"])
def test_it_is_that_of_each_environment(mode) -> None:
    drawn = EventCfg("randomize", {"gravity": [[-5, -5, 0], [5, 5, 8]]}, mode)
    found = observed(events={"g": drawn})
    gravity = found["fields"].reshape(3, 3)
    assert len(np.unique(gravity[:, 0])) == 3
    for name in ("of", "imu", "read"):
        np.testing.assert_allclose(found[name], in_axes(gravity), atol=1e-6)


def test_without_gravity_it_is_zero() -> None:
    found = observed(physics=PhysicsTaskCfg(gravity=[0.0, 0.0, 0.0]))
    for name in ("of", "imu", "read", "flat"):
        assert not found[name].any()


def test_gravity_that_is_switched_off_is_none() -> None:
    found = observed(physics=PhysicsTaskCfg(flags=FlagsCfg(gravity="disable")))
    for name in ("of", "imu", "read"):
        assert not found[name].any()
