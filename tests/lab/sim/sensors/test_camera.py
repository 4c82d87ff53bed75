"""Images of cameras against values worked by hand: a wall, a cube's corners, a ball in two eyes."""

import subprocess
import sys

import numpy as np
import pytest
import torch

from embodichain.lab.sim.cfg import RigidObjectCfg, RobotCfg
from embodichain.lab.sim.sensors import (
    CameraCfg,
    ExtrinsicsCfg,
    LinksCfg,
    SensorCfg,
    StereoCameraCfg,
)
from embodichain.lab.sim.shapes import CubeCfg, SphereCfg
from embodichain.utils.errors import ConfigError
from tests.lab.sim.sensors.conftest import cube

pytestmark = pytest.mark.slow

WIDTH, HEIGHT = 64, 48
LENS = (70.0, 90.0, 20.0, 30.0)
AHEAD = ExtrinsicsCfg(eye=(0, 0, 1), target=(1, 0, 1))
WALL = RigidObjectCfg(
    uid="wall", shape=CubeCfg(size=[0.2, 9.0, 9.0]), body_type="static", init_pos=(1.6, 0, 1)
)


def camera(uid: str = "eye", **kwargs) -> CameraCfg:
    """A small camera at (0, 0, 1) that looks along x, unless told otherwise."""
    kwargs = {"intrinsics": LENS, "extrinsics": AHEAD, "width": WIDTH, "height": HEIGHT, **kwargs}
    if "fovy" in kwargs or "camera" in kwargs:
        del kwargs["intrinsics"]
    if "camera" in kwargs:
        del kwargs["extrinsics"]
    return CameraCfg(uid=uid, **kwargs)


def pixels(point, lens=LENS, eye=(0.0, 0.0, 1.0)) -> tuple[float, float]:
    """Column and row of a point for a camera that looks along x with z up."""
    x, y, z = np.subtract(point, eye)
    return lens[2] + lens[0] * -y / x, lens[3] + lens[1] * -z / x


def test_a_wall_at_one_and_a_half_metres(scene):
    every = ["color", "depth", "distance", "mask", "normal", "position"]
    data = scene([WALL], [camera(data_types=every)]).get_sensor("eye").get_data()
    shapes = {name: (tuple(image.shape), image.dtype) for name, image in data.items()}
    size = (3, HEIGHT, WIDTH)
    assert shapes == {
        "color": ((*size, 4), torch.uint8),
        "depth": (size, torch.float32),
        "distance": (size, torch.float32),
        "mask": (size, torch.int32),
        "normal": ((*size, 3), torch.float32),
        "position": ((*size, 3), torch.float32),
    }
    torch.testing.assert_close(data["depth"], torch.full(size, 1.5), atol=1e-3, rtol=0)
    right = (np.arange(WIDTH) + 0.5 - 20.0) / 70.0
    down = (np.arange(HEIGHT) + 0.5 - 30.0) / 90.0
    grown = 1.5 * np.sqrt(1.0 + right[None, :] ** 2 + down[:, None] ** 2)
    np.testing.assert_allclose(data["distance"][1], grown, atol=2e-3)
    np.testing.assert_allclose(data["normal"][0].reshape(-1, 3), [[-1, 0, 0]] * 3072, atol=1e-3)
    point = data["position"][2, 7, 11].numpy()
    np.testing.assert_allclose(point, [1.5, -1.5 * right[11], 1.0 - 1.5 * down[7]], atol=2e-3)


def test_the_corners_of_a_cube_are_on_their_pixels(scene):
    box = cube("box", (1.5, 0.1, 1.1), body_type="static")
    image = scene([WALL, box], [camera(data_types=["mask"])]).get_sensor("eye").read("mask")[0]
    rows, columns = np.nonzero(image == 2)
    left, top = pixels((1.45, 0.15, 1.15))
    far_right, bottom = pixels((1.45, 0.05, 1.05))
    # A pixel belongs to the cube if its middle is inside the face that is 1.45 m away.
    assert (columns.min(), columns.max()) == (round(left), round(far_right) - 1)
    assert (rows.min(), rows.max()) == (round(top), round(bottom) - 1)


def test_masks_have_the_ids_of_entities(scene, arm):
    box = cube("box", (0.6, 0.3, 0.05))
    pose = ExtrinsicsCfg(eye=(2, -1, 1.5), target=(0.3, 0, 0.8))
    sim = scene([box], [camera(fovy=60, extrinsics=pose, data_types=["mask"])], [arm])
    found = set(np.unique(sim.get_sensor("eye").read("mask")).tolist())
    ids = {sim.get_asset(uid).entity.root_body_id for uid in ("arm", "box")}
    assert found == {-1, 0, *ids}
    assert len(ids - {0}) == 2


def test_what_is_not_hit(scene):
    up = ExtrinsicsCfg(eye=(0, 0, 1), target=(0, 0, 2))
    sensors = [
        camera(kind, extrinsics=up, far=30.0, no_hit=kind, data_types=["depth", "mask", "normal"])
        for kind in ("zero", "far", "inf")
    ]
    sim = scene([], sensors)
    for uid, depth in (("zero", 0.0), ("far", 30.0), ("inf", np.inf)):
        data = sim.get_sensor(uid).get_data()
        assert (data["depth"] == depth).all()
        assert (data["mask"] == -1).all()
        assert (data["normal"] == 0).all()


def test_a_pose_and_a_lens_of_one_environment(scene):
    sim = scene([WALL], [camera(data_types=["depth", "position"])])
    eye = sim.get_sensor("eye")
    eye.look_at([[0.5, 0, 1]], [[1.5, 0, 1]], env_ids=[1])
    eye.set_intrinsics([70.0, 90.0, 40.0, 30.0], env_ids=[2])
    depth, points = eye.read("depth"), eye.read("position")
    assert depth[:, 5, 5] == pytest.approx([1.5, 1.0, 1.5], abs=1e-3)
    # The axis has moved 20 columns to the right.
    np.testing.assert_allclose(points[2, :, 20:], points[0, :, :-20], atol=2e-3)
    assert eye.get_intrinsics()[2, 0, 2] == pytest.approx(40.0, abs=1e-4)
    pose = eye.get_local_pose(to_matrix=True)
    assert pose[:, 0, 3].tolist() == [0.0, 0.5, 0.0]
    eye.set_local_pose(pose)
    np.testing.assert_allclose(eye.read("depth"), depth, atol=1e-4)


def test_conventions(scene):
    ahead = (0.5, -0.5, 0.5, -0.5)  # z along x, x along -y, y along -z: ROS's camera axes
    pose = ExtrinsicsCfg(pos=(0, 0, 1), quat=ahead)
    sensors = [camera("ros", extrinsics=pose, convention="ros"), camera("eye")]
    sim = scene([WALL], sensors)
    torch.testing.assert_close(
        sim.get_sensor("ros").get_arena_pose(True), sim.get_sensor("eye").get_arena_pose(True)
    )


def test_on_a_link_and_of_a_file(scene, arm):
    offset = ExtrinsicsCfg(pos=(0.0, 0.0, 0.1))
    links = LinksCfg(uid="arm", link_names=["upper"])
    parent = ExtrinsicsCfg(pos=(0.0, 0.0, 0.1), parent="upper")
    sensors = [
        camera("on_link", of=links, extrinsics=offset),
        camera("parent", extrinsics=parent),
        camera("own", camera="arm/wrist"),
    ]
    sim = scene([], sensors, [arm])
    sim.get_robot("arm").set_qpos([[0.0], [np.pi / 2], [-np.pi / 2]], target=False)
    pos = sim.get_sensor("on_link").get_arena_pose()[:, :3]
    # The link's axis is y, at z = 0.5: 0.1 along its z turns into x.
    wanted = torch.tensor([[0.0, 0.0, 0.6], [0.1, 0.0, 0.5], [-0.1, 0.0, 0.5]])
    torch.testing.assert_close(pos, wanted, atol=1e-6, rtol=0)
    torch.testing.assert_close(sim.get_sensor("parent").get_arena_pose()[:, :3], pos)
    own = sim.get_sensor("own")
    assert own.get_intrinsics()[0, 1, 1] == pytest.approx(24.0 / np.tan(np.radians(35.0)))
    torch.testing.assert_close(own.get_local_pose()[0, :3], torch.tensor([0.0, 0.2, 0.0]))
    with pytest.raises(ValueError, match="own: it has a field of view"):
        own.set_intrinsics([70.0, 90.0, 40.0, 30.0])


def test_disparity_of_a_ball(scene):
    ball = RigidObjectCfg(
        uid="ball", shape=SphereCfg(radius=0.03), body_type="static", init_pos=(2.0, 0, 1)
    )
    two = StereoCameraCfg(
        uid="two",
        width=160,
        height=32,
        intrinsics=(150.0, 150.0, 80.0, 16.0),
        left_to_right_pos=(0.2, 0.0, 0.0),
        extrinsics=AHEAD,
        data_types=["mask", "depth", "disparity"],
    )
    sensor = scene([ball], [two]).get_sensor("two")
    data = {name: image[0] for name, image in sensor.get_data().items()}
    assert list(data) == ["depth", "depth_right", "mask", "mask_right", "disparity"]
    left, right = (np.nonzero(data[name] == 1)[:, 1].float() for name in ("mask", "mask_right"))
    # 150 px x 0.2 m / 2 m
    assert (left.mean() - right.mean()).item() == pytest.approx(15.0, abs=0.5)
    middle = data["disparity"][16, round(left.mean().item())]
    assert middle.item() == pytest.approx(150 * 0.2 / 1.97, abs=0.1)
    assert data["disparity"][0, 0] == 0.0  # the sky
    eyes = sensor.get_left_right_arena_pose()
    assert [pose[0, 1, 3].item() for pose in eyes] == pytest.approx([0.1, -0.1])
    torch.testing.assert_close(sensor.get_local_pose()[0, :3], torch.tensor([0.0, 0.0, 1.0]))


def test_a_rate(scene):
    box = cube("box", (1.0, 0.0, 1.2))
    sensors = [camera("slow", data_types=["mask"], rate=25.0), camera("eye", data_types=["mask"])]
    sim = scene([box], sensors, physics_dt=0.02)
    slow, eye = sim.get_sensor("slow"), sim.get_sensor("eye")
    same = []
    for _ in range(6):
        same.append(np.array_equal(slow.read("mask"), eye.read("mask")))
        sim.update(step=1)
    assert same == [True, False] * 3
    sim.reset_objects_state([1])
    np.testing.assert_array_equal(slow.read("mask")[1], eye.read("mask")[1])


def test_a_reading_stays_until_something_changes(scene):
    sim = scene([cube("box", (1.0, 0.0, 1.2))], [camera()])
    eye = sim.get_sensor("eye")
    first = eye.read("color")
    assert eye.read("color") is first
    sim.get_rigid_object("box").set_local_pose([[1.0, 0.1, 1.2, 1, 0, 0, 0]], env_ids=[1])
    moved = eye.read("color")
    assert [bool((moved[i] != first[i]).any()) for i in range(3)] == [False, True, False]


@pytest.mark.unmeasured
def test_a_camera_that_is_not_read_loads_no_opengl():
    script = """
        import sys
        from embodichain.lab.sim.cfg import SimulationManagerCfg
        from embodichain.lab.sim.sensors import CameraCfg
        from embodichain.lab.sim.sim_manager import SimulationManager

        sim = SimulationManager(SimulationManagerCfg(headless=True, num_envs=2))
        eye = sim.add_sensor(CameraCfg(uid="eye", width=8, height=8))
        sim.update(step=3)
        print("OpenGL.GL" in sys.modules)
        eye.get_data()
        print("OpenGL.GL" in sys.modules)
    """
    lines = "\n".join(line[8:] for line in script.splitlines())
    done = subprocess.run([sys.executable, "-c", lines], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "True"]


WRONG = {
    "width": ({"width": 0}, r"width: must be within 1 and 16384 pixels, got 0"),
    "far": ({"near": 2.0, "far": 1.0}, r"far: must be greater than near, 2.0 m, got 1.0"),
    "lens": ({"fovy": 45.0, "intrinsics": LENS}, r"intrinsics: fovy is given as well"),
    "fovy": ({"fovy": 180.0, "intrinsics": None}, r"fovy: must be greater than 0 and less"),
    "focal": (
        {"intrinsics": (0.0, 1.0, 2.0, 3.0)},
        r"intrinsics: fx, .* fx and fy positive; got \[0.0, 1.0",
    ),
    "link": (
        {"of": LinksCfg(uid="arm", link_names=["uper"])},
        r"of.link_names: no link of 'arm' matches 'uper'; .* Did you mean 'upper'\?",
    ),
    "parent": (
        {"extrinsics": ExtrinsicsCfg(parent="uper")},
        r"extrinsics.parent: no link is called 'uper'; .* Did you mean 'upper'\?",
    ),
    "target": ({"extrinsics": ExtrinsicsCfg(eye=(0, 0, 1))}, r"extrinsics.target: missing"),
    "same": (
        {"extrinsics": ExtrinsicsCfg(eye=(0, 0, 1), target=(0, 0, 1))},
        r"extrinsics.target: the eye is at the target",
    ),
    "twice": (
        {"extrinsics": ExtrinsicsCfg(eye=(0, 0, 1), target=(1, 0, 1), pos=(1, 0, 0))},
        r"extrinsics.pos: eye and target are given as well",
    ),
    "disparity": ({"data_types": ["disparity"]}, r"data_types: disparity is an image of a stereo"),
    "name": (
        {"data_types": ["color", "dept"]},
        r"data_types\.1: expected one of .* got 'dept'\. Did you mean 'depth'\?",
    ),
    "nothing": ({"enable_color": False}, r"data_types: names no image"),
    "own": ({"camera": "arm/wrist"}, r"intrinsics: camera 'arm/wrist' has its own"),
}


@pytest.mark.parametrize("case", WRONG)
def test_mistakes(scene, arm, case):
    given, message = WRONG[case]
    cfg = CameraCfg(uid="eye", **{"intrinsics": LENS, **given})
    with pytest.raises(ConfigError, match=r"^eye\." + message):
        scene([], [cfg], [arm])


def test_a_name_that_is_taken_and_a_camera_that_is_not_there(scene, arm):
    with pytest.raises(ConfigError, match="the scene has a camera 'default' already"):
        _ = scene([], [camera("default")]).engine
    with pytest.raises(ConfigError, match=r"no camera is called 'arm/wrst'; .* mean 'arm/wrist'\?"):
        _ = scene([], [camera(camera="arm/wrst")], [arm]).engine


def test_the_names_of_embodichain():
    cfg = SensorCfg.from_dict({"sensor_type": "Camera", "enable_depth": True, "uid": "eye"})
    assert isinstance(cfg, CameraCfg)
    assert cfg.get_data_types() == ["color", "depth"]
    two = SensorCfg.from_dict({"sensor_type": "StereoCamera", "enable_color": False})
    assert not two.get_data_types()
    two = StereoCameraCfg(enable_mask=True, enable_disparity=True)
    assert two.get_data_types() == ["color", "color_right", "mask", "mask_right", "disparity"]


@pytest.fixture
def arm(tmp_path) -> RobotCfg:
    """One link that turns about y at z = 0.5, with a camera on it."""
    file = tmp_path / "arm.xml"
    file.write_text(
        """
        <mujoco>
          <worldbody>
            <body name="base">
              <geom type="cylinder" size=".05 .25" pos="0 0 .25"/>
              <body name="upper" pos="0 0 .5">
                <joint name="turn" axis="0 1 0"/>
                <geom type="capsule" size=".04" fromto="0 0 0 0 0 .4"/>
                <camera name="wrist" pos="0 .2 0" fovy="70"/>
              </body>
            </body>
          </worldbody>
        </mujoco>
        """
    )
    return RobotCfg(uid="arm", fpath=str(file))


def test_a_camera_of_a_file_refuses_what_it_has_already():
    cfg = CameraCfg(camera="arm/wrist", fovy=45.0, convention="ros")
    found = {problem.path: problem.message for problem in cfg.check()}
    message = "camera 'arm/wrist' has its own: leave it out"
    assert found == {"fovy": message, "convention": message}
