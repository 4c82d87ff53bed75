"""Cameras with arrays on a device, by MuJoCo Warp's renderer, against those on the host."""

import logging
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from embodichain.lab.sim.cfg import (
    LightCfg,
    RigidObjectCfg,
    RobotCfg,
    SimulationManagerCfg,
    WarpCfg,
)
from embodichain.lab.sim.drawing.rays import RayRenderer
from embodichain.lab.sim.drawing.views import view_of
from embodichain.lab.sim.engine.device.device_array import DeviceArray, EnvMask
from embodichain.lab.sim.engine.warp.device_cameras import _say_once
from embodichain.lab.sim.sensors import CameraCfg, ExtrinsicsCfg, LinksCfg, StereoCameraCfg
from embodichain.lab.sim.shapes import CubeCfg, SphereCfg, VisualMaterialCfg
from embodichain.lab.sim.sim_manager import SimulationManager
from embodichain.utils.errors import ConfigError
from tests.helpers.warp_scene import DEVICE
from tests.lab.sim.sensors.conftest import cube

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]

N, WIDTH, HEIGHT = 3, 64, 48
LENS = (70.0, 90.0, 20.0, 30.0)
AHEAD = ExtrinsicsCfg(eye=(0, 0, 1), target=(1, 0, 1))
EVERY = ["color", "depth", "distance", "mask", "normal", "position"]
RED = (0.8, 0.2, 0.1)
FULL = os.environ.get("EMBODICHAIN_TEST_WARP") == "all"

ARM = """
<mujoco>
  <asset>
    <texture name="six" type="cube" builtin="flat" rgb1="0 0 1" rgb2="0 0 1" width="4" height="24"/>
    <material name="blue" texture="six"/>
    <mesh name="wedge" vertex="0 0 0  .4 0 0  0 .4 0  0 0 .4"/>
  </asset>
  <worldbody>
    <body name="base">
      <geom type="mesh" mesh="wedge" pos="0 0 .02"/>
      <body name="upper" pos="0 0 .5">
        <joint name="turn" axis="0 1 0"/>
        <geom type="capsule" size=".04" fromto="0 0 0 0 0 .4" material="blue"/>
      </body>
      <body name="glass" pos="0 .6 .5">
        <geom type="ellipsoid" size=".1 .1 .2" rgba="0 1 0 .5" mass="1"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def camera(uid: str, **given: Any) -> CameraCfg:
    given = {"intrinsics": LENS, "extrinsics": AHEAD, "width": WIDTH, "height": HEIGHT} | given
    if "fovy" in given:
        del given["intrinsics"]
    return CameraCfg(uid=uid, **given)


def add_scene(sim: SimulationManager, folder: Path) -> SimulationManager:
    """A wall 1.5 m ahead with a box before it; behind the eye an arm and a ball."""
    file = folder / "arm.xml"
    file.write_text(ARM)
    sim.add_robot(RobotCfg(uid="arm", fpath=str(file), init_pos=(-2, 0, 0.5)))
    wall = CubeCfg(size=[0.2, 9.0, 9.0])
    red = CubeCfg(size=[0.2, 0.2, 0.2], visual_material=VisualMaterialCfg(base_color=[*RED, 1]))
    ball = SphereCfg(radius=0.3)
    static = {"body_type": "static"}
    sim.add_rigid_object(RigidObjectCfg(uid="wall", shape=wall, init_pos=(1.6, 0, 1), **static))
    sim.add_rigid_object(RigidObjectCfg(uid="red", shape=red, init_pos=(1.1, 0, 1.1), **static))
    sim.add_rigid_object(RigidObjectCfg(uid="ball", shape=ball, init_pos=(-2, -0.7, 1), **static))
    sim.add_rigid_object(cube("loose", (-1.5, 0.3, 1.5)))
    sim.add_light(LightCfg(uid="lamp", light_type="direction", direction=(1, 0, 0), intensity=9.0))
    behind = ExtrinsicsCfg(eye=(-0.2, 0.4, 1.6), target=(-2, -0.1, 0.9))
    moving = {"of": LinksCfg(uid="arm", link_names=["upper"])}
    for cfg in (
        camera("eye", data_types=EVERY),
        camera("back", extrinsics=behind, fovy=70, data_types=["color", "depth", "mask"]),
        camera("near", near=1.3, data_types=["depth", "mask"]),
        camera("far", far=1.2, no_hit="inf", data_types=["color", "depth", "mask"]),
        camera("tip", **moving, extrinsics=ExtrinsicsCfg(pos=(0, 0, 0.6)), data_types=["mask"]),
        camera("slow", extrinsics=behind, fovy=70, rate=25.0, data_types=["depth"]),
        camera("film", extrinsics=behind, look="full", data_types=["color", "mask"]),
        StereoCameraCfg(
            **{"uid": "two", "width": WIDTH, "height": HEIGHT, "extrinsics": AHEAD},
            left_to_right_pos=(0.1, 0.0, 0.0),
            data_types=["depth", "disparity"],
        ),
    ):
        sim.add_sensor(cfg)
    return sim


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, SimulationManager]]:
    folder, found = tmp_path_factory.mktemp("scene"), {}
    for name, engine in (("host", "mujoco"), ("device", "warp")):
        warp = WarpCfg(nconmax=64, njmax=64, arrays=name) if engine == "warp" else WarpCfg()
        common: Any = {"headless": True, "num_envs": N, "num_threads": 1, "physics_dt": 0.02}
        device = DEVICE if engine == "warp" else "cpu"
        cfg = SimulationManagerCfg(engine=engine, warp=warp, sim_device=device, **common)
        found[name] = add_scene(SimulationManager(cfg), folder)
    yield found
    for sim in found.values():
        sim.destroy()


@pytest.fixture
def device(made: dict[str, SimulationManager]) -> SimulationManager:
    return made["device"]


def seen(sim: SimulationManager, uid: str, name: str) -> Any:
    """An image, on the host."""
    sensor: Any = sim.get_sensor(uid)
    return sim.arrays.host(sensor.read(name))


def test_a_wall_at_one_and_a_half_metres(device: SimulationManager) -> None:
    """The numbers of `test_camera`, worked by hand."""
    eye: Any = device.get_sensor("eye")
    assert type(eye.read("color")) is DeviceArray
    data = eye.get_data()
    size = (N, HEIGHT, WIDTH)
    assert {name: (tuple(image.shape), image.dtype) for name, image in data.items()} == {
        "color": ((*size, 4), torch.uint8),
        "depth": (size, torch.float32),
        "distance": (size, torch.float32),
        "mask": (size, torch.int32),
        "normal": ((*size, 3), torch.float32),
        "position": ((*size, 3), torch.float32),
    }
    data = {name: image.cpu().numpy() for name, image in data.items()}
    right = (np.arange(WIDTH) + 0.5 - 20.0) / 70.0
    down = (np.arange(HEIGHT) + 0.5 - 30.0) / 90.0
    # The box's face is 1 m away, from y -0.1 to 0.1 and from z 1 to 1.2.
    inside = np.outer((down > -0.2) & (down < 0.0), np.abs(right) < 0.1)
    depth = np.where(inside, 1.0, 1.5)
    np.testing.assert_allclose(data["depth"], [depth] * N, atol=2e-6)
    grown = depth * np.sqrt(1.0 + right[None, :] ** 2 + down[:, None] ** 2)
    np.testing.assert_allclose(data["distance"], [grown] * N, atol=4e-6)
    wall, red = (device.get_asset(uid).entity.root_body_id for uid in ("wall", "red"))
    np.testing.assert_array_equal(data["mask"], [np.where(inside, red, wall)] * N)
    point = data["position"][2, 40, 11]
    np.testing.assert_allclose(point, [1.5, -1.5 * right[11], 1.0 - 1.5 * down[40]], atol=4e-6)
    np.testing.assert_allclose(data["normal"][0, 40, 11], [-1, 0, 0], atol=1e-3)


def test_masks_and_depths_are_those_of_rays(made: dict[str, SimulationManager]) -> None:
    """Meshes, capsules, ellipsoids, the ground and the sky, against MuJoCo's rays."""
    host, device = made["host"], made["device"]
    sensor: Any = host.get_sensor("back")
    view = view_of(
        *(host.engine, sensor.eyes[0], WIDTH, HEIGHT),
        near=0.005,
        far=100.0,
        outputs=("depth", "mask"),
    )
    glass = next(g for g, rgba in enumerate(host.engine.model.geom_rgba) if rgba[3] == 0.5)
    alpha = slice(4 * glass + 3, 4 * glass + 4)
    host.engine.write_model("geom_rgba", 1.0, None, alpha)  # as it is on the device
    (exact,) = RayRenderer(host.engine.model).draw(host.engine, [view])
    host.engine.write_model("geom_rgba", 0.5, None, alpha)
    mask, depth = seen(device, "back", "mask"), seen(device, "back", "depth")
    wanted = sensor.index.entity_of_geom[exact["mask"]]
    # Rays through an edge hit either side, by rounding.
    same = mask == wanted
    assert same.mean() > 0.998
    assert len(np.unique(mask)) == 5  # the sky, the ground, the arm, the ball, the loose cube
    np.testing.assert_allclose(depth[same], exact["depth"][same], rtol=1e-4, atol=1e-5)


def test_pictures_are_close_to_those_of_opengl(made: dict[str, SimulationManager]) -> None:
    _say_once.cache_clear()
    host, device = (seen(made[name], "back", "color") for name in ("host", "device"))
    masks = [seen(made[name], "back", "mask") for name in ("host", "device")]
    assert (host[..., 3] == 255).all() and (device[..., 3] == 255).all()
    # Glass is opaque on the device, and the arm's cube of pictures has one colour anyway.
    ball = made["device"].get_asset("ball").entity.root_body_id
    for uid, both in (("ball", (masks[0] == ball) & (masks[1] == ball)), ("sky", masks[0] == -1)):
        error = np.abs(host[both].astype(int) - device[both])
        assert error.mean() < 2.0, uid
    upper = [picture[0].reshape(-1, 4).astype(int) for picture in (host, device)]
    blue = [seen[(seen[:, 2] > 90) & (seen[:, 1] < 9)] for seen in upper]
    assert len(blue[0]) > 9 and len(blue[1]) > 9
    np.testing.assert_allclose(blue[1].mean(axis=0), blue[0].mean(axis=0), atol=6)
    # A face that the light and the eye look at: ambient, headlight and lamp.
    front = [seen(made[name], "eye", "color")[0, 22, 20, :3] for name in ("host", "device")]
    np.testing.assert_allclose(front[1], front[0], atol=2)
    assert front[1][0] > 3 * front[1][1]


def test_what_is_drawn_otherwise_is_said_once(
    made: dict[str, SimulationManager], caplog: pytest.LogCaptureFixture
) -> None:
    from embodichain.lab.sim.engine.warp.device_cameras import DeviceCameras

    engine: Any = made["device"].engine
    _say_once.cache_clear()
    for _ in range(2):
        cameras = DeviceCameras(engine.worlds, engine.model, N, DEVICE, engine.fields.written)
        with caplog.at_level(logging.WARNING):
            # What the first picture does, without drawing one.
            cameras._make_scene()
    assert [record.getMessage() for record in caplog.records] == [
        "transparent shapes are drawn opaque on a device: arm/glass",
        "textures that are cubes are drawn as their mean colour on a device, of materials arm/blue",
    ]


def test_near_and_far(device: SimulationManager) -> None:
    red = device.get_asset("red").entity.root_body_id
    mask, depth = seen(device, "near", "mask"), seen(device, "near", "depth")
    assert (mask != red).all()
    np.testing.assert_allclose(depth, 1.5, atol=2e-6)
    mask, depth = seen(device, "far", "mask"), seen(device, "far", "depth")
    assert set(np.unique(mask)) == {-1, red}
    assert (depth[mask == -1] == np.inf).all()
    np.testing.assert_allclose(depth[mask == red], 1.0, atol=2e-6)
    sky, face = (seen(device, "far", "color")[0, row, 20] for row in (2, 22))
    assert sky[2] > sky[0] and face[0] > face[2]


def test_two_eyes(device: SimulationManager) -> None:
    depth, right = seen(device, "two", "depth"), seen(device, "two", "depth_right")
    focal = 1.25 * HEIGHT
    np.testing.assert_allclose(seen(device, "two", "disparity"), focal * 0.1 / depth, rtol=1e-5)
    # 60 px x 0.1 m / 1 m: the box is 6 columns further left for the right eye.
    columns = [np.flatnonzero(part[0, 20] < 1.2).min() for part in (depth, right)]
    assert columns[0] - columns[1] == 6


def test_a_camera_on_a_link_and_a_rate(made: dict[str, SimulationManager]) -> None:
    """Poses of environments, by writes of some of them; readings that stay."""
    for sim in made.values():
        sim.reset_objects_state()
        before = seen(sim, "slow", "depth").copy()
        sim.get_robot("arm").set_qpos(torch.tensor([[0.0], [1.2], [-0.6]]), target=False)
        sim.get_rigid_object("loose").set_local_pose([[-1.2, 0.3, 1.3, 1, 0, 0, 0]] * N)
        turned = seen(sim, "tip", "mask")
        assert len({turned[i].tobytes() for i in range(N)}) == N
        sim.update(step=1)  # 0.02 s, of 0.04 s
        np.testing.assert_array_equal(seen(sim, "slow", "depth"), before)
        sim.update(step=1)
        assert (seen(sim, "slow", "depth") != before).any(axis=(1, 2)).all()
    masks = [seen(sim, "tip", "mask") for sim in made.values()]
    assert (masks[0] == masks[1]).mean() > 0.98
    for sim in made.values():
        sim.reset_objects_state()


def test_model_fields_of_environments(device: SimulationManager) -> None:
    """A colour, a size, a light and a pose; by a mask, as events write them."""
    engine: Any = device.engine
    flags = torch.tensor([False, True, False], device=DEVICE)
    one, first = EnvMask(flags), engine.model.geom("red/geom").id
    material, light = engine.model.geom_matid[first], engine.model.light("lamp").id
    before = seen(device, "eye", "color").astype(int)
    face0, wall0 = before[1, 22, 20, :3], before[1, 40, 50, :3]

    def changed(field: str, start: int, values: Any) -> Any:
        """Pixels of the box and of the wall in all environments, after a write in one."""
        columns = slice(start, start + np.size(values))
        kept = engine.model_field(field)[:, columns].copy()
        engine.write_model(field, device.arrays.put(np.tile(values, (N, 1))), one, columns)
        image = seen(device, "eye", "color").astype(int)
        engine.write_model(field, kept, None, columns)
        np.testing.assert_array_equal(image[[0, 2]], before[[0, 2]])
        return image[1, 22, 20, :3], image[1, 40, 50, :3]

    face, wall = changed("mat_rgba", 4 * material, [0.1, 0.2, 0.8])
    assert face[2] > 3 * face[0] and (wall == wall0).all()
    face, _ = changed("geom_size", 3 * first, [0.004, 0.004, 0.004])
    assert np.abs(face - wall0).max() <= 1  # beside the box, now
    face, wall = changed("light_diffuse", 3 * light, [0.0, 0.0, 0.0])
    assert face[0] < face0[0] and (wall < wall0).all()
    eye: Any = device.get_sensor("eye")
    eye.look_at([[0.5, 0, 1]], [[1.5, 0, 1]], env_ids=[1])
    assert seen(device, "eye", "depth")[:, 40, 50] == pytest.approx([1.5, 1.0, 1.5], abs=1e-5)
    pose = eye.get_local_pose()
    assert pose[:, 0].tolist() == [0.0, 0.5, 0.0] and str(pose.device).startswith(DEVICE)
    eye.look_at([0, 0, 1], [1, 0, 1])


def test_lenses_of_environments(device: SimulationManager) -> None:
    """The last: from now on, rays are computed for each environment."""
    eye: Any = device.get_sensor("eye")
    before = seen(device, "eye", "depth")
    eye.set_intrinsics([70.0, 90.0, 40.0, 30.0], env_ids=[2])
    depth, mask = seen(device, "eye", "depth"), seen(device, "eye", "mask")
    np.testing.assert_allclose(depth[:2], before[:2], atol=2e-5)
    # The axis has moved 20 columns to the right.
    np.testing.assert_allclose(depth[2, :, 20:], before[2, :, :-20], atol=2e-5)
    np.testing.assert_array_equal(mask[2, :, 20:], mask[1, :, :-20])
    assert eye.get_intrinsics()[:, 0, 2].tolist() == pytest.approx([20.0, 20.0, 40.0], abs=1e-4)
    with pytest.raises(ConfigError, match=r"'near': near must be at most 0\.005 m, got 1\.3,"):
        device.get_sensor("near").get_data()
    # A field of view is another field.
    back = seen(device, "back", "depth")
    engine: Any = device.engine
    number = device.get_sensor("back").eyes[0]
    engine.write_model("cam_fovy", 70.0, None, slice(number, number + 1))
    wide = seen(device, "back", "depth")
    assert (np.abs(wide - back) < 1e-4).mean() > 0.99
    # Compiling one takes seconds: fields and poses that change must not ask for more.
    assert len(engine._cameras._kernels) <= 5


@pytest.mark.skipif(not FULL, reason="compiles another kernel: make test-warp")
def test_full_look(made: dict[str, SimulationManager]) -> None:
    """Shadows, highlights and four samples a pixel; the mask is that of one sample."""
    host, device = (seen(sim, "film", "color").astype(int) for sim in made.values())
    fast = seen(made["device"], "back", "color")
    error = np.abs(host - device)[..., :3].max(axis=-1)
    assert np.median(error) < 10
    assert device.shape == fast.shape and (device != fast).any()
    masks = [seen(sim, "film", "mask") for sim in made.values()]
    assert (masks[0] == masks[1]).mean() > 0.95  # glass has none on the host
