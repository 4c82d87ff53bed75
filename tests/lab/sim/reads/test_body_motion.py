"""Motion of bodies: MuJoCo's own numbers in every frame, stored until the state changes."""

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import embodichain

TASK = "quadruped_velocity"
BODIES = ["base", "FL_calf"]  # a floating root, which has a joint of its own, and a link


@pytest.fixture
def env():
    env = embodichain.make(TASK, num_envs=3)
    env.reset(seed=4)
    draw = np.random.default_rng(0)
    for _ in range(5):
        env.step(draw.uniform(-1, 1, env.action_space.shape).astype(np.float32))
    yield env
    env.close()


@pytest.fixture(params=BODIES)
def body(request, env) -> int:
    return int(env.robot.body_of(request.param))


def of_mujoco(env, body: int) -> tuple[np.ndarray, ...]:
    """Rotation (N, 3, 3), linear and angular velocity (N, 3), world axes, by MuJoCo itself."""
    turned, linear, angular = [], [], []
    for i in range(env.num_envs):
        data = env.sim.engine.data_of(i)
        both = np.zeros(6)
        kind = int(mujoco.mjtObj.mjOBJ_XBODY)
        mujoco.mj_objectVelocity(env.sim.engine.model, data, kind, body, both, 0)
        turned.append(data.xmat[body].reshape(3, 3))
        angular.append(both[:3])
        linear.append(both[3:])
    return np.array(turned), np.array(linear), np.array(angular)


def test_velocities_are_those_of_mujoco_in_every_frame(env, body) -> None:
    motion = env.robot.motion(body)
    turned, linear, angular = of_mujoco(env, body)
    np.testing.assert_allclose(motion.axes(), turned, atol=1e-12)
    yaw = np.arctan2(turned[:, 1, 0], turned[:, 0, 0])
    frames = {
        "world": Rotation.identity(len(yaw)),
        "body": Rotation.from_matrix(turned),
        "yaw": Rotation.from_euler("z", yaw[:, None]),
    }
    for frame, axes in frames.items():
        for read, world in ((motion.linear_velocity, linear), (motion.angular_velocity, angular)):
            np.testing.assert_allclose(read(frame), axes.inv().apply(world), atol=1e-9)


def test_a_body_is_read_anew_only_when_the_state_has_changed(env, body) -> None:
    motion = env.robot.motion(body)
    assert env.robot.motion(body) is motion
    first = motion.linear_velocity("body")
    assert motion.linear_velocity("body") is first
    before = first.copy()
    env.sim.engine.write("qvel", 0.0)
    assert np.abs(before).max() > 1e-3
    np.testing.assert_array_equal(motion.linear_velocity("body"), 0.0 * before)


def test_the_heading_of_a_vertical_body_is_that_of_the_world(env) -> None:
    engine = env.sim.engine
    root = env.robot.motion(int(env.robot.body_of("base")))
    quat = np.array([np.sqrt(0.5), 0.0, -np.sqrt(0.5), 0.0])  # about y: the x axis points up
    engine.write("qpos", quat, None, slice(3, 7))
    engine.write("qvel", np.array([1.0, 2.0, 3.0]), None, slice(0, 3))
    level = root.linear_velocity("yaw")
    assert np.isfinite(level).all()
    np.testing.assert_allclose(np.linalg.norm(level, axis=1), np.sqrt(14.0))
    np.testing.assert_allclose(level[:, 2], 3.0)
