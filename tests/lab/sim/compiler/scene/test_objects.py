import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from embodichain.lab.sim.cfg import (
    LightCfg,
    RigidBodyAttributesCfg,
    RigidObjectCfg,
    SimulationManagerCfg,
)
from embodichain.lab.sim.compiler.compile_scene import compile_scene
from embodichain.lab.sim.compiler.scene_parts import SceneParts
from embodichain.lab.sim.shapes import (
    CapsuleCfg,
    CubeCfg,
    CylinderCfg,
    MeshCfg,
    PlaneCfg,
    SphereCfg,
    VisualMaterialCfg,
)
from embodichain.utils.errors import ConfigError
from tests.lab.sim.compiler.helpers import scene_of, start, write

CUBE_OBJ = "".join(f"v {x} {y} {z}\n" for x in (0, 1) for y in (0, 1) for z in (0, 1)) + (
    "f 1 2 4 3\nf 5 7 8 6\nf 1 5 6 2\nf 3 4 8 7\nf 1 3 7 5\nf 2 6 8 4\n"
)


def only(cfg, **sim):
    return scene_of({}, {"thing": cfg}, SimulationManagerCfg(**sim))


@pytest.mark.parametrize(
    ("shape", "kind", "size"),
    [
        (CubeCfg(size=[0.2, 0.4, 0.6]), "BOX", [0.1, 0.2, 0.3]),
        (SphereCfg(radius=0.3), "SPHERE", [0.3, 0, 0]),
        (CylinderCfg(radius=0.1, height=0.4), "CYLINDER", [0.1, 0.2, 0]),
        (CapsuleCfg(radius=0.1, height=0.4), "CAPSULE", [0.1, 0.2, 0]),
    ],
)
def test_shapes_are_given_in_full_sizes(shape, kind, size):
    scene = only(RigidObjectCfg(shape=shape))
    geom = scene.model.geom("thing/geom")
    assert geom.type[0] == getattr(mujoco.mjtGeom, f"mjGEOM_{kind}")
    assert geom.size.tolist() == size


def test_a_scale_multiplies_the_size_and_turns_a_sphere_into_an_ellipsoid():
    geom = only(RigidObjectCfg(shape=SphereCfg(radius=0.1), body_scale=(1, 2, 3))).model.geom(1)
    assert geom.type[0] == mujoco.mjtGeom.mjGEOM_ELLIPSOID
    np.testing.assert_allclose(geom.size, [0.1, 0.2, 0.3])


@pytest.mark.parametrize(
    ("body_type", "free", "mocap"), [("dynamic", 0, -1), ("kinematic", -1, 0), ("static", -1, -1)]
)
def test_a_body_type_decides_how_it_moves(body_type, free, mocap):
    cfg = RigidObjectCfg(shape=CubeCfg(size=[0.1] * 3), body_type=body_type, init_pos=(1, 2, 3))
    scene = only(cfg)
    index = scene.entities["thing"]
    assert (index.free_qpos_adr, index.free_qvel_adr, index.mocap_id) == (free, free, mocap)
    data = start(scene, {})
    assert data.body("thing").xpos.tolist() == [1, 2, 3]
    for _ in range(20):
        mujoco.mj_step(scene.model, data)
    assert (data.body("thing").xpos[2] < 2.9) == (body_type == "dynamic")


def test_mass_is_taken_as_given_or_from_the_density():
    heavy = RigidBodyAttributesCfg(mass=3.0)
    assert only(RigidObjectCfg(shape=CubeCfg(), attrs=heavy)).model.body("thing").mass[0] == 3.0
    dense = RigidBodyAttributesCfg(mass=0.0, density=500.0)
    cube = RigidObjectCfg(shape=CubeCfg(size=[0.1, 0.2, 0.3]), attrs=dense)
    assert only(cube).model.body("thing").mass[0] == pytest.approx(3.0)


def test_velocities_of_a_free_body_decay_at_the_damping_rates():
    attrs = RigidBodyAttributesCfg(mass=2.0, linear_damping=0.5, angular_damping=0.9)
    cfg = RigidObjectCfg(shape=CubeCfg(size=[0.2] * 3), attrs=attrs, init_pos=(0, 0, 50))
    sim = SimulationManagerCfg(physics_dt=0.001)
    sim.physics_config.gravity = [0.0, 0.0, 0.0]
    scene = scene_of({}, {"thing": cfg}, sim)
    data = start(scene, {})
    data.qvel[:] = [1, 0, -2, 0.3, 0, 0]
    for _ in range(1000):
        mujoco.mj_step(scene.model, data)
    np.testing.assert_allclose(data.qvel[[0, 2]], np.exp(-0.5) * np.array([1, -2]), rtol=1e-3)
    assert data.qvel[3] == pytest.approx(0.3 * np.exp(-0.9), rel=1e-3)


def test_angular_damping_follows_the_inertia_of_each_axis():
    attrs = RigidBodyAttributesCfg(mass=2.0, linear_damping=0.25, angular_damping=0.5)
    model = only(RigidObjectCfg(shape=CubeCfg(size=[0.2, 0.4, 0.6]), attrs=attrs)).model
    inertia = 2.0 / 12 * np.array([0.4**2 + 0.6**2, 0.2**2 + 0.6**2, 0.2**2 + 0.4**2])
    np.testing.assert_allclose(model.dof_damping, [0.5] * 3 + list(0.5 * inertia), rtol=1e-9)


def test_collision_can_be_switched_off():
    attrs = RigidBodyAttributesCfg(enable_collision=False)
    cfg = RigidObjectCfg(shape=CubeCfg(size=[0.1] * 3), attrs=attrs)
    scene = only(cfg)
    assert start(scene, {}).ncon == 0
    assert only(RigidObjectCfg(shape=CubeCfg(size=[0.1] * 3))).model.geom(1).contype[0] == 1


def test_a_mesh_object_is_read_scaled_and_stands_on_the_ground(tmp_path):
    shape = MeshCfg(fpath=write(tmp_path / "cube.obj", CUBE_OBJ))
    cfg = RigidObjectCfg(shape=shape, body_scale=(0.1, 0.1, 0.2), init_pos=(0, 0, 0.001))
    scene = only(cfg)
    data = start(scene, {})
    for _ in range(100):
        mujoco.mj_step(scene.model, data)
    assert data.qpos[2] == pytest.approx(0.0, abs=2e-3)
    assert scene.model.geom("thing/geom").size.tolist() == pytest.approx([0.05, 0.05, 0.1])


def test_poses_can_be_said_in_three_ways():
    angles = (30.0, -40.0, 50.0)
    rotation = Rotation.from_euler("XYZ", angles, degrees=True)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation.as_matrix(), [1, 2, 3]
    quat = rotation.as_quat()[[3, 0, 1, 2]]
    ways = [
        RigidObjectCfg(init_pos=(1, 2, 3), init_rot=angles),
        RigidObjectCfg(init_pos=(1, 2, 3), init_quat=2 * quat, init_rot=(9, 9, 9)),
        RigidObjectCfg(init_pos=(9, 9, 9), init_local_pose=matrix),
    ]
    for cfg in ways:
        index = only(cfg).entities["thing"]
        np.testing.assert_allclose(index.pos0, [1, 2, 3])
        np.testing.assert_allclose(index.quat0 * np.sign(index.quat0[0]), quat, atol=1e-12)


@pytest.mark.parametrize(
    ("cfg", "message"),
    [
        (
            RigidObjectCfg(shape=CubeCfg(size=[0.0, 1, 1])),
            "thing.shape.size: must be positive metres, got [0.0, 1.0, 1.0]",
        ),
        (
            RigidObjectCfg(shape=SphereCfg(radius=-1.0)),
            "thing.shape.radius: must be positive metres, got -1.0",
        ),
        (
            RigidObjectCfg(shape=PlaneCfg()),
            "thing.body_type: a Plane must be static, got 'dynamic'",
        ),
        (
            RigidObjectCfg(attrs=RigidBodyAttributesCfg(mass=-2.0)),
            "thing.attrs.mass: must be finite and not negative, got -2.0",
        ),
        (
            RigidObjectCfg(shape=CylinderCfg(), body_scale=(1, 2, 1)),
            "thing.body_scale: a Cylinder scales equally along x and y, got [1.0, 2.0, 1.0]",
        ),
        (
            RigidObjectCfg(init_quat=(0, 0, 0, 0)),
            "thing.init_quat: a quaternion is zero or not finite; wxyz with unit length is wanted, "
            "got [0.0, 0.0, 0.0, 0.0]",
        ),
        (
            RigidObjectCfg(init_local_pose=np.zeros((4, 4))),
            "thing.init_local_pose: must be a 4x4 rigid transform: a rotation, a translation, "
            "last row 0 0 0 1",
        ),
        (
            RigidObjectCfg(max_convex_hull_num=4),
            "thing.max_convex_hull_num: only a Mesh is split into convex parts, this is a Cube",
        ),
        (RigidObjectCfg(shape=MeshCfg()), "thing.shape.fpath: a Mesh needs a file"),
    ],
)
def test_an_object_that_cannot_be_built_is_named(cfg, message):
    with pytest.raises(ConfigError) as raised:
        only(cfg)
    assert str(raised.value) == message


def test_a_mesh_in_another_format_is_named(tmp_path):
    shape = MeshCfg(fpath=write(tmp_path / "part.step", "<x/>"))
    with pytest.raises(ConfigError, match=r"part\.step: format \.step is not one of \.dae, \.glb"):
        only(RigidObjectCfg(shape=shape))


@pytest.mark.parametrize(
    ("uid", "message"),
    [
        ("a/b", "must not contain '/'"),
        ("", "needs a name"),
        ("default_plane", "taken by the ground plane"),
    ],
)
def test_a_name_that_cannot_be_used_is_refused(uid, message):
    with pytest.raises(ConfigError, match=message):
        compile_scene(SceneParts(SimulationManagerCfg(), objects={uid: RigidObjectCfg()}))


def test_lights_and_objects_share_their_names():
    with pytest.raises(ConfigError, match="uid 'x' is taken"):
        parts = SceneParts(
            SimulationManagerCfg(), objects={"x": RigidObjectCfg()}, lights={"x": LightCfg()}
        )
        compile_scene(parts)


# -- the scene around them -------------------------------------------------------------------------


def test_the_ground_can_be_left_out():
    assert only(RigidObjectCfg()).model.geom("default_plane").pos[2] == 0.0
    without = only(RigidObjectCfg(), ground_plane=False).model
    assert [without.geom(i).name for i in range(without.ngeom)] == ["thing/geom"]


def test_lights_are_as_declared():
    lights = {
        "lamp": LightCfg(init_pos=(1, 2, 3), color=(1, 0.5, 0), intensity=15),
        "sun": LightCfg(light_type="sun", direction=(0, 1, -1)),
    }
    model = compile_scene(SceneParts(SimulationManagerCfg(), lights=lights)).model
    lamp, sun = model.light("lamp"), model.light("sun")
    assert model.nlight == 2
    assert lamp.pos.tolist() == [1, 2, 3]
    np.testing.assert_allclose(lamp.diffuse, [0.5, 0.25, 0])
    assert sun.type[0] == mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    np.testing.assert_allclose(sun.dir, np.array([0, 1, -1]) / np.sqrt(2))


def test_a_material_colours_an_object():
    shape = CubeCfg(visual_material=VisualMaterialCfg(base_color=[0.1, 0.2, 0.3, 0.4]))
    model = only(RigidObjectCfg(shape=shape)).model
    np.testing.assert_allclose(model.material("thing/material").rgba, [0.1, 0.2, 0.3, 0.4])


@pytest.mark.parametrize("where", [(0, 0, 0.5), (20, -7, 3)])
def test_the_default_camera_has_the_scene_in_its_picture(where):
    scene = only(RigidObjectCfg(shape=CubeCfg(size=[1, 1, 1]), init_pos=where))
    data = start(scene, {})
    camera = scene.model.camera("default").id
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    local = (corners + where - data.cam_xpos[camera]) @ data.cam_xmat[camera].reshape(3, 3)
    half = np.tan(np.radians(scene.model.cam_fovy[camera] / 2))
    assert (local[:, 2] < 0).all()  # a camera looks along -z
    assert (np.abs(local[:, :2]) < half * -local[:, 2:]).all()


def test_the_scene_can_be_saved_and_compiled_again():
    scene = only(RigidObjectCfg(shape=CubeCfg(size=[0.1] * 3)))
    again = mujoco.MjModel.from_xml_string(scene.spec.to_xml())
    assert (again.nq, again.nbody) == (scene.model.nq, scene.model.nbody)
    np.testing.assert_allclose(
        again.camera("default").pos, scene.model.camera("default").pos, rtol=1e-4
    )


def test_a_mesh_that_mujoco_refuses_is_at_its_key(tmp_path):
    flat = write(tmp_path / "flat.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 3\nf 2 4 3\n")
    with pytest.raises(ConfigError) as raised:
        only(RigidObjectCfg(shape=MeshCfg(fpath=str(flat))))
    (problem,) = raised.value.problems
    assert problem.path == "thing.shape.fpath"
    assert problem.message.startswith(f"{flat}: MuJoCo cannot compile it: mesh 'thing/mesh' has")


def test_no_texture_is_none_and_not_an_empty_list():
    look = VisualMaterialCfg(textures=[])
    with pytest.raises(
        ConfigError, match=r"thing\.shape\.visual_material\.textures: names no image"
    ):
        only(RigidObjectCfg(shape=CubeCfg(visual_material=look)))
