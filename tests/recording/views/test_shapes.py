"""Shapes against MuJoCo's own rays: what is drawn lies where what is hit lies."""

import mujoco
import numpy as np
import pytest

from embodichain.recording.views.shapes import PLANE_SIZE, mesh_of, shapes

XML = """
<mujoco>
  <asset>
    <hfield name="hills" nrow="3" ncol="4" size="2 1 .5 .1"
            elevation="0 1 2 3  1 3 2 0  2 2 1 4"/>
    <mesh name="wedge" vertex="0 0 0  .1 0 0  0 .1 0  0 0 .1"/>
    <texture name="half" type="2d" builtin="flat" rgb1=".2 .4 .6" width="4" height="4"/>
    <material name="painted" texture="half" rgba="1 .5 1 .5"/>
  </asset>
  <worldbody>
    <geom name="floor" type="plane" size="0 3 .1" pos="0 0 -1"/>
    <geom name="hills" type="hfield" hfield="hills" pos="5 0 0"/>
    <body name="b" pos="0 0 1" euler="10 20 30">
      <freejoint/>
      <geom name="box" type="box" size=".1 .2 .3" pos=".4 0 0" euler="0 0 20"/>
      <geom name="ball" size=".15" pos="-.4 0 0" material="painted"/>
      <geom name="egg" type="ellipsoid" size=".1 .15 .2" pos="0 .6 0"/>
      <geom name="can" type="cylinder" size=".1 .2" pos="0 -.6 0"/>
      <geom name="pill" type="capsule" size=".1 .2" pos="0 0 .8" euler="40 0 0"/>
      <geom name="wedge" type="mesh" mesh="wedge" pos="0 0 -.5"/>
      <geom name="collision" type="box" size="1 1 1" group="3" rgba="1 0 0 1"/>
      <geom name="glass" type="box" size="1 1 1" rgba="1 0 0 0"/>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.fixture(scope="module")
def model():
    return mujoco.MjModel.from_xml_string(XML)


@pytest.fixture(scope="module")
def found(model):
    return {model.geom(shape.geom).name: shape for shape in shapes(model)}


def test_what_is_hidden_is_left_out(model, found):
    everything = {model.geom(i).name for i in range(model.ngeom)}
    assert everything - set(found) == {"collision", "glass"}
    assert found["can"].kind == "cylinder" and found["can"].body == model.body("b").id


def test_colours_are_those_of_materials_and_their_textures(found):
    assert found["ball"].rgba == pytest.approx([0.2, 0.2, 0.6, 0.5], abs=0.01)
    assert found["box"].rgba == pytest.approx([0.5, 0.5, 0.5, 1])


def test_planes_are_thin_boxes_below_their_surface(found):
    floor = found["floor"]
    assert floor.kind == "box" and floor.half[:2].tolist() == [PLANE_SIZE / 2, 3]
    assert floor.pos[2] + floor.half[2] == pytest.approx(-1)


@pytest.mark.parametrize("name", ["box", "ball", "egg", "can", "pill"])
def test_half_sizes_are_where_rays_hit(model, found, name):
    """A ray from outside along an axis of the shape meets its surface."""
    shape, data = found[name], mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    turn = np.empty(4)
    mujoco.mju_mulQuat(turn, data.xquat[shape.body], shape.quat)
    centre = np.empty(3)
    mujoco.mju_rotVecQuat(centre, shape.pos, data.xquat[shape.body])
    centre += data.xpos[shape.body]
    extent = shape.half + np.array([0, 0, shape.half[0]]) * (shape.kind == "capsule")
    for axis in range(3):
        direction = np.empty(3)
        mujoco.mju_rotVecQuat(direction, np.eye(3)[axis], turn)
        start = centre + 2.0 * direction
        geom = shape.geom
        distance = mujoco.mju_rayGeom(
            data.geom_xpos[geom], data.geom_xmat[geom], model.geom_size[geom],
            start, -direction, model.geom_type[geom], None,
        )  # fmt: skip
        assert distance == pytest.approx(2.0 - extent[axis], abs=1e-9)


def test_meshes_are_where_rays_hit(model, found):
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    hills = found["hills"]
    mesh = mesh_of(model, hills.geom)
    assert len(mesh.vertices) == 12 and len(mesh.faces) == 2 * 2 * 3
    tops = mesh.vertices[mesh.faces].mean(axis=1)  # the middle of each triangle lies on it
    for top in tops.astype(np.float64) + hills.pos:
        start = top + np.array([0, 0, 3.0])
        down = np.array([0, 0, -1.0])
        hit = mujoco.mj_rayHfield(model, data, hills.geom, start, down, None)
        assert hit == pytest.approx(3.0, abs=1e-6)
    edges = mesh.vertices[mesh.faces]
    normals = np.cross(edges[:, 1] - edges[:, 0], edges[:, 2] - edges[:, 0])
    assert (normals[:, 2] > 0).all()
    wedge = mesh_of(model, found["wedge"].geom)
    edges = wedge.vertices[wedge.faces]
    outward = np.cross(edges[:, 1] - edges[:, 0], edges[:, 2] - edges[:, 0])
    middle = wedge.vertices.mean(axis=0)
    assert (((edges.mean(axis=1) - middle) * outward).sum(axis=1) > 0).all()


def test_cells_of_a_height_field_in_one_plane_are_two_triangles():
    """Along x a step of one cell between two planes, one inclined; one height is higher."""
    field = '<hfield name="f" nrow="4" ncol="7" size="3 2 1 .1" elevation="{}"/>'
    flat, bump = "0 0 0 4 5 6 7", "0 0 0 4 5 6 8"
    heights = "  ".join([flat, flat, flat, bump])
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><asset>{field.format(heights)}</asset><worldbody>"
        '<geom name="f" type="hfield" hfield="f"/></worldbody></mujoco>'
    )
    mesh = mesh_of(model, 0)
    # Cells 0 and 1, the step, cells 3 to 5; in the last row cell 5 is apart.
    assert len(mesh.faces) == 2 * (3 + 3 + 4)
    corners = mesh.vertices[mesh.faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert across[:, 2].sum() / 2 == pytest.approx(6 * 4, rel=1e-6)  # all of the field, once
    np.testing.assert_allclose(corners[:2, :, 0].ravel(), [-3, -1, -1, -3, -1, -3])
