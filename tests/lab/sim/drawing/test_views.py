"""Views of the scene's cameras, against the frusta and poses that MuJoCo draws with."""

import mujoco
import numpy as np
import pytest

from embodichain.lab.sim.drawing.views import Viewpoint, view_of
from embodichain.lab.sim.engine.cpu.cpu_engine import CpuEngine

SCENE = """
<mujoco>
  <worldbody>
    <geom type="plane" size="1 1 .1"/>
    <body name="arm" pos="0 0 1">
      <joint name="hinge" axis="1 0 0"/>
      <geom type="capsule" size=".05 .2"/>
      <camera name="plain" pos=".1 -1 .2" euler="70 10 0" fovy="50"/>
      <camera name="lens" pos="0 -1 0" xyaxes="1 0 0 0 0 1" resolution="200 100"
        sensorsize=".02 .01" focal=".01 .02" principal=".002 .001"/>
      <camera name="flat" pos="0 -1 0" projection="orthographic"/>
    </body>
  </worldbody>
</mujoco>
"""
SIZE = 200, 100


@pytest.fixture
def engine():
    engine = CpuEngine(mujoco.MjModel.from_xml_string(SCENE), 3)
    engine.write("qpos", [[0.0], [0.4], [-0.9]])
    return engine


def drawn_by_mujoco(engine: CpuEngine, env: int, camera: int) -> mujoco.MjvGLCamera:
    data = engine.data_of(env)
    scene, seen = mujoco.MjvScene(data.model, 100), mujoco.MjvCamera()
    seen.type, seen.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, camera
    everything = mujoco.mjtCatBit.mjCAT_ALL.value
    mujoco.mjv_updateScene(data.model, data, mujoco.MjvOption(), None, seen, everything, scene)
    return scene.camera[0]  # the left one of two, half the distance of the eyes to the left


@pytest.mark.parametrize("name", ["plain", "lens"])
def test_pose_and_lens_are_those_that_mujoco_draws_with(engine, name):
    index = engine.model.camera(name).id
    if name == "plain":
        fovy = engine.model_field("cam_fovy").copy()
        fovy[:, index] = 40.0, 50.0, 60.0
        engine.write_model("cam_fovy", fovy)
    view = view_of(engine, name, *SIZE)
    assert view.axes.shape == (3, 3, 3) and view.position.shape == (3, 3)
    for env in range(3):
        seen = drawn_by_mujoco(engine, env, index)
        right, up, back = view.axes[env].T
        np.testing.assert_allclose(seen.forward, -back, atol=1e-6)
        np.testing.assert_allclose(seen.up, up, atol=1e-6)
        eyes = 0.5 * engine.model.cam_ipd[index]
        np.testing.assert_allclose(seen.pos, view.position[env] - eyes * right, atol=1e-6)
        assert view.optics.near == pytest.approx(seen.frustum_near)
        assert view.optics.far == pytest.approx(seen.frustum_far)
        focal = view.optics.focal if view.focal is None else view.focal[env]
        (fx, fy), (cx, cy), near = focal, view.optics.centre, view.optics.near
        assert seen.frustum_top == pytest.approx(near * cy / fy, rel=1e-5)
        assert seen.frustum_bottom == pytest.approx(-near * (SIZE[1] - cy) / fy, rel=1e-5)
        half = seen.frustum_width or 0.5 * (seen.frustum_top - seen.frustum_bottom) * 2.0
        assert seen.frustum_center - half == pytest.approx(-near * cx / fx, rel=1e-5)
        assert seen.frustum_center + half == pytest.approx(near * (SIZE[0] - cx) / fx, rel=1e-5)


def test_a_viewpoint_looks_at_its_target(engine):
    view = view_of(engine, Viewpoint.look_at((1.0, 2.0, 2.0), (0.0, 0.0, 0.0), fovy=90.0), *SIZE)
    np.testing.assert_allclose(view.axes[0, :, 2], np.array([1.0, 2.0, 2.0]) / 3.0)
    assert view.axes[0, 2, 0] == pytest.approx(0.0)  # its right side is level
    assert view.axes[0, 2, 1] > 0.5 and np.linalg.det(view.axes[0]) == pytest.approx(1.0)
    assert view.optics.focal == pytest.approx((50.0, 50.0))  # 100 / 2 / tan(45 degrees)
    down = Viewpoint.look_at((0.0, 0.0, 2.0), (0.0, 0.0, 0.0))
    np.testing.assert_allclose(down.axes[0, :, 1], [1.0, 0.0, 0.0])
    with pytest.raises(ValueError, match="the eye is at the target"):
        Viewpoint.look_at((1.0, 2.0, 3.0), (1.0, 2.0, 3.0))


def test_wrong_cameras_are_refused(engine):
    with pytest.raises(ValueError, match=r"no camera 'plane'; there are: plain, lens, flat.*plain"):
        view_of(engine, "plane", *SIZE)
    with pytest.raises(ValueError, match="no camera 3"):
        view_of(engine, 3, *SIZE)
    with pytest.raises(ValueError, match="'flat' is orthographic"):
        view_of(engine, "flat", *SIZE)


def test_a_principal_point_of_one_environment(engine):
    before = view_of(engine, "lens", *SIZE).lens
    optics = engine.model_field("cam_intrinsic").reshape(3, 3, 4).copy()
    optics[1, 1, 2] += 0.001  # of a sensor 0.02 wide: a twentieth of the picture
    engine.write_model("cam_intrinsic", optics.reshape(3, -1))
    moved = view_of(engine, "lens", *SIZE).lens - before
    np.testing.assert_allclose(moved, [[0] * 4, [0, 0, -SIZE[0] / 20, 0], [0] * 4], atol=1e-4)
