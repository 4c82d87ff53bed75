"""Where points of the scene land in images, by the pinhole equations worked by hand.

u = cx + fx x / z, v = cy + fy y / z with the point's x to the right, y down and z along the axis.
"""

import numpy as np
import pytest
import torch

from embodichain.lab.sim.cfg import RigidObjectCfg, RobotCfg
from embodichain.lab.sim.sensors import CameraCfg, ExtrinsicsCfg, LinksCfg, StereoCameraCfg
from embodichain.lab.sim.shapes import CubeCfg, SphereCfg

WIDTH, HEIGHT = 120, 90
AHEAD = ExtrinsicsCfg(eye=(0, 0, 1), target=(1, 0, 1))


def ball(uid, pos, radius=0.05):
    return RigidObjectCfg(
        uid=uid, shape=SphereCfg(radius=radius), body_type="kinematic", init_pos=pos
    )


def plate(uid, pos, rot=(0, 0, 0), size=(0.02, 0.4, 0.4)):
    return RigidObjectCfg(
        uid=uid, shape=CubeCfg(size=[*size]), body_type="kinematic", init_pos=pos, init_rot=rot
    )


def camera(uid="eye", **keys):
    keys = {"width": WIDTH, "height": HEIGHT, "extrinsics": AHEAD, "data_types": ["mask"], **keys}
    return CameraCfg(uid=uid, **keys)


def middle(mask, number):
    """(column, row) of the middle of an entity's pixels, whose own middles are at + 0.5."""
    rows, columns = np.nonzero(mask == number)
    assert len(rows) > 3, "it is not in the picture"
    return columns.mean() + 0.5, rows.mean() + 0.5


def number(sim, uid):
    return sim.get_asset(uid).entity.root_body_id


LENSES = {
    "fovy": ({"fovy": 60.0}, (45 * 3**0.5, 45 * 3**0.5, 60.0, 45.0)),
    "neither": ({}, (112.5, 112.5, 60.0, 45.0)),
    "intrinsics": ({"intrinsics": (100.0, 70.0, 60.0, 45.0)}, (100.0, 70.0, 60.0, 45.0)),
    "off-centre": ({"intrinsics": (90.0, 90.0, 35.0, 60.0)}, (90.0, 90.0, 35.0, 60.0)),
}
POINTS = {"level": (2.0, 0.0, 1.0), "left above": (2.5, 0.4, 1.3), "right below": (1.5, -0.3, 0.8)}


@pytest.mark.parametrize("lens", LENSES)
def test_points_land_on_their_pixels(scene, lens):
    keys, (fx, fy, cx, cy) = LENSES[lens]
    sim = scene([ball(*item) for item in POINTS.items()], [camera(**keys)], num_envs=1)
    mask = sim.get_sensor("eye").read("mask")[0]
    for uid, (x, y, z) in POINTS.items():
        # The camera looks along x: its right is -y, and down is -z.
        wanted = cx + fx * -y / x, cy + fy * -(z - 1.0) / x
        np.testing.assert_allclose(middle(mask, number(sim, uid)), wanted, atol=0.6)
    matrix = sim.get_sensor("eye").get_intrinsics()[0].numpy()
    np.testing.assert_allclose(matrix, [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], rtol=1e-5)


def test_clouds_are_where_they_should_be_by_the_formula_of_opencv(scene):
    keys = {"fovy": 50.0, "data_types": ["depth", "position"]}
    sim = scene([ball(*item) for item in POINTS.items()], [camera(**keys)], num_envs=1)
    eye = sim.get_sensor("eye")
    depth, position = (eye.read(name)[0] for name in ("depth", "position"))
    (fx, _, cx), (_, fy, cy), _ = eye.get_intrinsics("centre")[0].numpy()
    v, u = np.indices(depth.shape)
    right, down = (u - cx) / fx * depth, (v - cy) / fy * depth
    # The camera looks along x from (0, 0, 1): its right is -y, and down is -z.
    cloud = np.stack([depth, -right, 1.0 - down], axis=-1)
    seen = depth > 0
    assert seen.any()
    np.testing.assert_allclose(cloud[seen], position[seen], atol=2e-6)
    half = eye.get_intrinsics()[0, :2, 2] - eye.get_intrinsics("centre")[0, :2, 2]
    assert half.tolist() == [0.5, 0.5]
    with pytest.raises(ValueError, match="pixel_origin is 'corner' or 'centre', got 'center'"):
        eye.get_intrinsics("center")


def test_up_rolls_the_picture(scene):
    ups = {"z": None, "y": (0, 1, 0), "down": (0, 0, -1)}
    sensors = [
        camera(uid, fovy=60.0, extrinsics=ExtrinsicsCfg(eye=(0, 0, 1), target=(1, 0, 1), up=up))
        for uid, up in ups.items()
    ]
    sim = scene([ball("ball", (2.0, 0.4, 1.2))], sensors, num_envs=1)
    right, up = (f * 45 / np.tan(np.radians(30)) / 2.0 for f in (-0.4, 0.2))
    found = {uid: middle(sim.get_sensor(uid).read("mask")[0], number(sim, "ball")) for uid in ups}
    np.testing.assert_allclose(found["z"], (60 + right, 45 - up), atol=0.6)
    np.testing.assert_allclose(found["down"], (60 - right, 45 + up), atol=0.6)
    # With y up, z is on the right.
    np.testing.assert_allclose(found["y"], (60 + up, 45 + right), atol=0.6)


def test_a_pose_in_both_conventions_draws_the_same(scene):
    """Looking along x with z up: OpenGL's x axis is -y, its y axis z, its z axis -x."""
    opengl = (0.5, 0.5, -0.5, -0.5)
    ros = (0.5, -0.5, 0.5, -0.5)
    sensors = [
        camera("opengl", extrinsics=ExtrinsicsCfg(pos=(0, 0, 1), quat=opengl)),
        camera("named", extrinsics=ExtrinsicsCfg(pos=(0, 0, 1), quat=opengl), convention="opengl"),
        camera("ros", extrinsics=ExtrinsicsCfg(pos=(0, 0, 1), quat=ros), convention="ros"),
        camera("eye"),
    ]
    sim = scene([ball(*item) for item in POINTS.items()], sensors, num_envs=1)
    for uid in ("opengl", "named", "ros"):
        sensor = sim.get_sensor(uid)
        axes = sensor.get_arena_pose(to_matrix=True)[0, :3, :3].numpy()
        np.testing.assert_allclose(axes, [[0, 0, -1], [-1, 0, 0], [0, 1, 0]], atol=1e-6)
        np.testing.assert_array_equal(sensor.read("mask"), sim.get_sensor("eye").read("mask"))


def test_a_camera_on_a_link_that_moves(scene, tmp_path):
    """The link turns about z at (0, 0, 1); the camera looks along the link, 0.2 m ahead."""
    pose = ExtrinsicsCfg(eye=(0.2, 0, 0), target=(1, 0, 0))
    sensors = [
        camera(fovy=60.0, of=LinksCfg(uid="arm", link_names=["turned"]), extrinsics=pose),
        camera("fixed", fovy=60.0),
    ]
    sim = scene([ball("ball", (2.0, 0.0, 1.0))], sensors, [arm(tmp_path)])
    angles = np.array([0.0, 0.2, -0.3])
    sim.get_robot("arm").set_qpos(angles[:, None], target=False)
    focal = 45 / np.tan(np.radians(30))
    for env, angle in enumerate(angles):
        x, y = 2.0 * np.cos(angle) - 0.2, -2.0 * np.sin(angle)  # the ball in the link's frame
        found = middle(sim.get_sensor("eye").read("mask")[env], number(sim, "ball"))
        np.testing.assert_allclose(found, (60 - focal * y / x, 45), atol=0.6)
    pos = sim.get_sensor("eye").get_arena_pose()[:, :3]
    wanted = np.stack([0.2 * np.cos(angles), 0.2 * np.sin(angles), np.ones(3)], axis=1)
    np.testing.assert_allclose(pos, wanted, atol=1e-6)
    local = sim.get_sensor("eye").get_local_pose()[:, :3]
    np.testing.assert_allclose(local, [[0.2, 0, 0]] * 3, atol=1e-6)
    fixed = sim.get_sensor("fixed").read("mask")
    found = [middle(image, number(sim, "ball")) for image in fixed]
    np.testing.assert_allclose(found, [(60, 45)] * 3, atol=0.6)


def test_all_links_of_a_robot_have_one_number(scene, tmp_path):
    objects = [ball("left", (2.0, 0.7, 1.0)), ball("right", (2.0, -0.7, 1.0))]
    above = ExtrinsicsCfg(eye=(0.5, 0, 4), target=(0.5, 0, 0), up=(1, 0, 0))
    sim = scene(objects, [camera(fovy=60.0, extrinsics=above)], [arm(tmp_path)], num_envs=1)
    mask = sim.get_sensor("eye").read("mask")[0]
    assert set(np.unique(mask)) == {0, *(number(sim, uid) for uid in ("arm", "left", "right"))}
    # Upwards in the picture is x, and its left is y.
    assert middle(mask, number(sim, "left"))[0] < 60 < middle(mask, number(sim, "right"))[0]
    assert middle(mask, number(sim, "left"))[1] < middle(mask, number(sim, "arm"))[1]


def test_nothing_is_drawn_before_near_and_after_far(scene):
    walls = [plate("first", (1.01, 0, 1), size=(0.02, 9, 9))]
    walls += [plate("second", (2.01, 0, 1), size=(0.02, 9, 9))]
    sensors = [
        camera("all", data_types=["depth", "mask"]),
        camera("no first", data_types=["depth", "mask"], near=1.5),
        camera("no wall", data_types=["depth", "mask"], far=0.9, no_hit="far"),
    ]
    sim = scene(walls, sensors, num_envs=1)
    for uid, depth, seen in (("all", 1.0, "first"), ("no first", 2.0, "second")):
        data = sim.get_sensor(uid).get_data()
        torch.testing.assert_close(
            data["depth"], torch.full((1, HEIGHT, WIDTH), depth), atol=2e-3, rtol=0
        )
        assert (data["mask"] == number(sim, seen)).all()
    data = sim.get_sensor("no wall").get_data()
    assert (data["mask"] == -1).all()
    assert data["depth"].unique().tolist() == pytest.approx([0.9])


def test_normals_and_points_of_a_tilted_plate(scene):
    """Turned by 30 degrees about y, its front has the normal (-cos 30, 0, sin 30)."""
    sensors = [camera(data_types=["position", "normal", "mask", "depth", "distance"])]
    sim = scene([plate("plate", (2.0, 0.0, 1.0), rot=(0, 30, 0))], sensors, num_envs=1)
    data = {name: image[0].numpy() for name, image in sim.get_sensor("eye").get_data().items()}
    inside = data["mask"] == number(sim, "plate")
    normal = np.array([-np.cos(np.radians(30)), 0.0, np.sin(np.radians(30))])
    # Its lower side is seen, too, and at edges neighbouring pixels are of another surface.
    close = np.abs(data["normal"][inside] - normal).max(axis=1) < 0.02
    assert close.mean() > 0.8
    points = data["position"][inside] - np.array([2.0, 0.0, 1.0])
    np.testing.assert_allclose(points[close] @ normal, 0.01, atol=1e-3)  # half of its thickness
    assert np.abs(points).max() < np.hypot(0.2, 0.2) + 0.01
    # Depth, distance and points are of the same surface.
    seen = data["position"][inside] - np.array([0.0, 0.0, 1.0])
    np.testing.assert_allclose(seen[:, 0], data["depth"][inside], atol=1e-5)
    length = np.sqrt((seen * seen).sum(axis=1))
    np.testing.assert_allclose(length, data["distance"][inside], rtol=1e-5)


def test_the_size_of_one_environment(scene):
    """A face of a x a at a distance z covers (f a / z)^2 pixels."""
    sim = scene([plate("plate", (2.0, 0.0, 1.0))], [camera(intrinsics=(100, 100, 60, 45))])
    sim.get_rigid_object("plate").set_body_scale([[1.0, 2.0, 0.5]], env_ids=[1])
    sim.get_rigid_object("plate").set_local_pose([[4.0, 0, 1, 1, 0, 0, 0]], env_ids=[2])
    counts = (sim.get_sensor("eye").read("mask") == number(sim, "plate")).sum(axis=(1, 2))
    sides = [(0.4, 0.4, 1.99), (0.8, 0.2, 1.99), (0.4, 0.4, 3.99)]
    wanted = [100 * a / z * 100 * b / z for a, b, z in sides]
    np.testing.assert_allclose(counts, wanted, rtol=0.15)


def test_disparity_falls_with_depth(scene):
    balls = [ball("near", (1.0, 0.0, 1.0)), ball("far", (4.0, 1.0, 1.0), 0.2)]
    pair = StereoCameraCfg(
        uid="pair",
        width=WIDTH,
        height=HEIGHT,
        intrinsics=(100, 100, 60, 45),
        left_to_right_pos=(0.1, 0, 0),
        extrinsics=AHEAD,
        data_types=["mask", "disparity", "depth"],
    )
    sim = scene(balls, [pair], num_envs=1)
    data = {name: image[0].numpy() for name, image in sim.get_sensor("pair").get_data().items()}
    for uid, z in (("near", 1.0), ("far", 4.0)):
        left = middle(data["mask"], number(sim, uid))
        right = middle(data["mask_right"], number(sim, uid))
        assert left[0] - right[0] == pytest.approx(100 * 0.1 / z, abs=0.4)
        assert left[1] == pytest.approx(right[1], abs=0.2)
    seen = data["depth"] > 0
    np.testing.assert_allclose(data["disparity"][seen], 10.0 / data["depth"][seen], rtol=1e-4)
    assert (data["disparity"][~seen] == 0).all()


def test_a_pair_whose_right_camera_is_turned_and_has_another_lens(scene):
    pair = StereoCameraCfg(
        uid="pair",
        width=WIDTH,
        height=HEIGHT,
        intrinsics=(100, 100, 60, 45),
        intrinsics_right=(50, 50, 60, 45),
        left_to_right_pos=(0.2, 0, 0),
        left_to_right_rot=(0, 10, 0),  # about the axis that is up: to the left
        extrinsics=AHEAD,
        data_types=["mask"],
    )
    sim = scene([ball("ball", (2.0, 0.0, 1.0))], [pair], num_envs=1)
    sensor = sim.get_sensor("pair")
    data = sensor.get_data()
    found = [middle(data[name][0].numpy(), number(sim, "ball")) for name in ("mask", "mask_right")]
    # From the left camera, at y = 0.1, the ball is 0.1 m to the right.
    assert found[0][0] == pytest.approx(60 + 100 * 0.1 / 2.0, abs=0.5)
    # From the right one, 0.1 m to the left, and the camera is turned by 10 degrees after it.
    angle = np.arctan2(0.1, 2.0) - np.radians(10)
    assert found[1][0] == pytest.approx(60 - 50 * np.tan(angle), abs=0.5)
    left, right = sensor.get_intrinsics()
    assert left[0, 0, 0] == pytest.approx(100) and right[0, 0, 0] == pytest.approx(50)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda c: c.set_intrinsics([100, 100, 60]), r"eye: intrinsics"),
        (lambda c: c.set_intrinsics([-1, 100, 60, 45]), r"eye: fx and fy must be positive"),
        (lambda c: c.set_intrinsics([np.nan, 100, 60, 45]), r"eye: intrinsics"),
        (lambda c: c.set_local_pose([[0, 0, 1, 1, 0, 0]] * 3), r"eye: pose"),
        (lambda c: c.set_local_pose([[np.inf, 0, 1, 1, 0, 0, 0]] * 3), r"eye: pose"),
        (lambda c: c.look_at((0, 0, 1), (0, 0, 1)), r"the eye is at the target"),
        (lambda c: c.look_at([[0, 0, 1]] * 2, (1, 0, 1), env_ids=[0]), r"eye: eye"),
        (lambda c: c.look_at((0, 0, 1), (1, 0, 1), env_ids=[3]), r"env"),
    ],
)
def test_wrong_values_change_nothing(scene, call, message):
    eye = scene([], [camera(intrinsics=(100, 100, 60, 45))]).get_sensor("eye")
    pose, lens = eye.get_local_pose(), eye.get_intrinsics()
    with pytest.raises((ValueError, IndexError), match=message):
        call(eye)
    torch.testing.assert_close(eye.get_local_pose(), pose)
    torch.testing.assert_close(eye.get_intrinsics(), lens)


def test_an_image_that_was_not_asked_for(scene):
    eye = scene([], [camera(data_types=["mask", "depth"])]).get_sensor("eye")
    with pytest.raises(KeyError, match="no image 'color'; data_types: depth, mask"):
        eye.read("color")
    assert list(eye.get_data()) == ["depth", "mask"]  # in the documented order


def test_a_pose_of_unnormalized_rotation_is_normalized(scene):
    sim = scene([ball(*item) for item in POINTS.items()], [camera()], num_envs=1)
    eye = sim.get_sensor("eye")
    before = eye.read("mask").copy()
    eye.set_local_pose([[0, 0, 1, 1.0, 1.0, -1.0, -1.0]])
    np.testing.assert_array_equal(eye.read("mask"), before)
    assert eye.get_local_pose()[0, 3:].tolist() == pytest.approx([0.5, 0.5, -0.5, -0.5])


def arm(folder) -> RobotCfg:
    """Two links: a post, and a bar that turns about z at the height of 1 m."""
    file = folder / "arm.xml"
    file.write_text(
        """
        <mujoco>
          <worldbody>
            <body name="post">
              <geom type="cylinder" size=".05 .45" pos="0 0 .45"/>
              <body name="turned" pos="0 0 1">
                <joint name="turn" axis="0 0 1"/>
                <geom type="capsule" size=".03" fromto="0 0 0 .1 0 0"/>
              </body>
            </body>
          </worldbody>
        </mujoco>
        """
    )
    return RobotCfg(uid="arm", fpath=str(file))
