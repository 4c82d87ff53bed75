"""The bundled UR10 against its published DH table and against example-robot-data's UR10."""

import math
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import mujoco
import numpy as np
import pytest

from embodichain.data import get_data_path, resolve_package_uri

HOME = [1.57079, -1.57079, 1.57079, -1.57079, -1.57079, -3.14159]
MOVING = ["shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3"]
LINKS = ["base_link", *(f"{name}_link" for name in MOVING), "ee_link"]

# Universal Robots, "DH parameters for calculations of kinematics and dynamics": UR10
A = [0.0, -0.612, -0.5723, 0.0, 0.0, 0.0]
D = [0.1273, 0.0, 0.0, 0.163941, 0.1157, 0.0922]
ALPHA = [math.pi / 2, 0.0, 0.0, math.pi / 2, -math.pi / 2, 0.0]
MASS = [7.1, 12.7, 4.27, 2.0, 2.0, 0.365]
CENTRE = [  # in the DH frame after the joint
    (0.021, 0.0, 0.027),
    (0.38, 0.0, 0.158),
    (0.24, 0.0, 0.068),
    (0.0, 0.007, 0.018),
    (0.0, 0.007, 0.018),
    (0.0, 0.0, -0.026),
]


def compile_urdf(name, near=None):
    """Compile with every frame kept, meshes resolved, unreadable visual meshes left out."""
    path = get_data_path(name)
    root = ET.parse(path).getroot()
    mujoco_tag = ET.SubElement(root, "mujoco")
    options = {"strippath": "false", "fusestatic": "false", "discardvisual": "false"}
    ET.SubElement(mujoco_tag, "compiler", options)
    spec = mujoco.MjSpec.from_string(ET.tostring(root, encoding="unicode"))
    for mesh in list(spec.meshes):
        if mesh.file.endswith(".dae"):
            for geom in [geom for geom in spec.geoms if geom.meshname == mesh.name]:
                spec.delete(geom)
            spec.delete(mesh)
        else:
            mesh.file = resolve_package_uri(mesh.file, path)
    return spec.compile()


@pytest.fixture(scope="module")
def model():
    return compile_urdf("UniversalRobots/UR10/UR10.urdf")


@pytest.fixture(scope="module")
def reference():
    return compile_urdf("example-robot-data/robots/ur_description/urdf/ur10_robot.urdf")


def rotation(axis, angle):
    cos, sin = math.cos(angle), math.sin(angle)
    matrix = np.eye(4)
    i, j = {"x": (1, 2), "z": (0, 1)}[axis]
    matrix[[i, i, j, j], [i, j, i, j]] = cos, -sin, sin, cos
    return matrix


def translation(x, y, z):
    matrix = np.eye(4)
    matrix[:3, 3] = x, y, z
    return matrix


def dh_frames(qpos):
    """The DH frames after each joint, in base_link, which is DH's base turned by half a turn."""
    frame, frames = rotation("z", math.pi), []
    for q, a, d, alpha in zip(qpos, A, D, ALPHA, strict=True):
        frame = frame @ rotation("z", q) @ translation(a, 0, d) @ rotation("x", alpha)
        frames.append(frame)
    return frames


def frame_of(model, qpos, body):
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    matrix = np.eye(4)
    matrix[:3, :3] = data.body(body).xmat.reshape(3, 3)
    matrix[:3, 3] = data.body(body).xpos
    return matrix


def random_qpos(count):
    return np.random.default_rng(7).uniform(-math.pi, math.pi, (count, 6))


def test_names_limits_and_no_joint_damping(model):
    assert [model.body(i).name for i in range(1, model.nbody)] == LINKS
    assert [model.joint(i).name for i in range(model.njnt)] == [f"Joint{i}" for i in range(1, 7)]
    turns = np.array([2.0, 2.0, 1.0, 2.0, 2.0, 2.0]) * math.pi
    assert np.allclose(model.jnt_range, np.stack([-turns, turns], axis=1))
    assert model.jnt_limited.all()
    efforts = np.array([330.0, 330.0, 150.0, 56.0, 56.0, 56.0])
    assert np.allclose(model.jnt_actfrcrange, np.stack([-efforts, efforts], axis=1))
    assert not model.dof_damping.any()
    assert not model.dof_frictionloss.any()
    assert not model.dof_armature.any()


def test_speed_limits_of_the_file():
    root = ET.parse(get_data_path("UniversalRobots/UR10/UR10.urdf")).getroot()
    speeds = [float(limit.attrib["velocity"]) for limit in root.iter("limit")]
    assert np.allclose(np.rad2deg(speeds), [120, 120, 180, 180, 180, 180])


@pytest.mark.parametrize("qpos", [np.zeros(6), np.array(HOME), *random_qpos(20)])
def test_tool_frame_is_the_dh_table(model, qpos):
    assert np.allclose(frame_of(model, qpos, "ee_link"), dh_frames(qpos)[-1], atol=1e-6)


def test_stretched_arm_points_along_x(model):
    tool = frame_of(model, np.zeros(6), "ee_link")
    assert np.allclose(tool[:3, 3], [0.612 + 0.5723, 0.163941 + 0.0922, 0.1273 - 0.1157], atol=1e-6)
    assert np.allclose(tool[:3, 2], [0, 1, 0], atol=1e-6)  # z leaves the flange


@pytest.mark.parametrize("qpos", [np.zeros(6), np.array(HOME), *random_qpos(20)])
def test_frames_are_those_of_example_robot_data(model, reference, qpos):
    ours = frame_of(model, qpos, "ee_link")
    assert np.allclose(ours, frame_of(reference, qpos, "tool0"), atol=1e-3)
    # its ee_link has the same place and x, not z, out of the flange
    theirs = frame_of(reference, qpos, "ee_link")
    assert np.allclose(ours[:3, 3], theirs[:3, 3], atol=1e-3)
    assert np.allclose(ours[:3, 2], theirs[:3, 0], atol=1e-3)


@pytest.mark.parametrize("joint", range(6))
def test_joint_axes_are_those_of_example_robot_data(model, reference, joint):
    qpos = random_qpos(1)[0]
    axes = []
    for each in (model, reference):
        data = mujoco.MjData(each)
        data.qpos[:] = qpos
        mujoco.mj_kinematics(each, data)
        axes.append(data.xaxis[joint])
    assert np.allclose(axes[0], axes[1], atol=1e-6)


@pytest.mark.parametrize("joint", range(6))
def test_masses_and_centres_are_published(model, joint):
    body = f"{MOVING[joint]}_link"
    assert model.body(body).mass[0] == MASS[joint]
    qpos = random_qpos(1)[0]
    centre = frame_of(model, qpos, body) @ np.append(model.body(body).ipos, 1.0)
    expected = dh_frames(qpos)[joint] @ np.append(CENTRE[joint], 1.0)
    assert np.allclose(centre, expected, atol=1e-4)


def test_inertias_are_physical(model):
    for body in LINKS[:-1]:
        low, middle, high = np.sort(model.body(body).inertia)
        assert low > 0.0
        assert low + middle >= high, body


def test_inertia_axes_follow_the_links(model):
    # the long links turn with ease about their length (x), hardly across it
    for body in ("upper_arm_link", "forearm_link"):
        axes = np.zeros(9)
        mujoco.mju_quat2Mat(axes, model.body(body).iquat)
        axes = axes.reshape(3, 3)
        tensor = axes @ np.diag(model.body(body).inertia) @ axes.T
        assert tensor[0, 0] < 0.05 * tensor[1, 1]
        assert tensor[0, 0] < 0.05 * tensor[2, 2]


def contacts(model, qpos):
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    bodies = model.geom_bodyid[data.contact.geom[: data.ncon]]
    return {tuple(model.body(int(body)).name for body in pair) for pair in bodies}


@pytest.mark.parametrize("qpos", [np.zeros(6), np.array(HOME)], ids=["zero", "home"])
def test_no_self_contact_where_the_arm_is_used(model, qpos):
    assert contacts(model, qpos) == set()


def test_base_and_shoulder_never_touch(model):
    # MuJoCo excludes parent and child, but not when the parent is fixed to the world
    for angle in np.linspace(-math.pi, math.pi, 13):
        assert contacts(model, [angle, *HOME[1:]]) == set()


def test_self_contact_is_seen_when_the_arm_folds_into_itself(model):
    assert contacts(model, [0.0, -math.pi / 2, math.pi, 0.0, 0.0, 0.0])


def test_shapes_are_few_and_visuals_never_collide(model):
    colliding = (model.geom_contype | model.geom_conaffinity) != 0
    assert colliding.sum() <= 2 * 7
    assert (model.geom_type[colliding] == mujoco.mjtGeom.mjGEOM_CYLINDER).all()
    seen = {int(body) for body in model.geom_bodyid[~colliding]}
    assert seen == {model.body(name).id for name in LINKS[:-1]}
    colours = np.unique(model.geom_rgba[~colliding].round(2), axis=0)
    assert len(colours) == 3


def test_collision_shapes_lie_within_the_visual_ones(model):
    """A contact must not happen where nothing is to be seen (2 mm allowed)."""
    colliding = (model.geom_contype | model.geom_conaffinity) != 0
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    centre, half = model.geom_aabb[:, :3], model.geom_aabb[:, 3:]
    corners = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, 8).T
    points = centre[:, None] + half[:, None] * corners
    matrix = data.geom_xmat.reshape(-1, 3, 3)
    points = np.einsum("gij,gkj->gki", matrix, points) + data.geom_xpos[:, None]
    for body in range(1, model.nbody - 1):
        of_body = model.geom_bodyid == body
        shown = points[of_body & ~colliding].reshape(-1, 3)
        solid = points[of_body & colliding].reshape(-1, 3)
        assert (solid.min(0) >= shown.min(0) - 2e-3).all(), model.body(body).name
        assert (solid.max(0) <= shown.max(0) + 2e-3).all(), model.body(body).name


def test_meshes_are_what_the_script_writes(tmp_path):
    script = Path(__file__).parents[2] / "scripts" / "make_ur10_meshes.py"
    subprocess.run([sys.executable, script, tmp_path / "meshes"], check=True)
    committed = Path(get_data_path("UniversalRobots/UR10/visual"))
    names = sorted(path.name for path in committed.iterdir())
    assert sorted(path.name for path in (tmp_path / "meshes").iterdir()) == names
    for name in names:
        assert (tmp_path / "meshes" / name).read_bytes() == (committed / name).read_bytes(), name


def test_it_falls_and_stays_finite(model):
    data = mujoco.MjData(model)
    data.qpos[:] = HOME
    mujoco.mj_step(model, data, nstep=200)
    assert np.isfinite(data.qpos).all()
    assert not data.warning.number.any()
