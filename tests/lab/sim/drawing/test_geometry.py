"""Triangles of geoms: closed, outward, of the right size; simplified meshes; what is visible."""

import mujoco
import numpy as np
import pytest
import trimesh

from embodichain.lab.sim.drawing.geometry import SceneGeometry, geom_scales

PI = np.pi


def model_of(*geoms: str, assets: str = "") -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(
        f"<mujoco><asset>{assets}</asset><worldbody>"
        f"{''.join(f'<geom {geom}/>' for geom in geoms)}</worldbody></mujoco>"
    )


def mesh_asset(mesh: trimesh.Trimesh) -> str:
    vertices, faces = (" ".join(map(str, np.ravel(n))) for n in (mesh.vertices, mesh.faces))
    return f'<mesh name="m" vertex="{vertices}" face="{faces}"/>'


def placed(geometry: SceneGeometry, model: mujoco.MjModel, geom: int = 0) -> np.ndarray:
    """(T, 3, 3) corners of a geom's triangles in its own frame, m."""
    vertices = geometry.vertices[geometry.triangles[geom]]
    scale = geom_scales(model.geom_type, model.geom_size)[geom]
    points = vertices["position"] * scale[:3]
    points[..., 2] += vertices["end"] * scale[3]
    return points.astype(float)


def across(corners: np.ndarray) -> np.ndarray:
    """(T, 3) twice the area, along the outward normal of anticlockwise triangles."""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


@pytest.mark.parametrize(
    ("geom", "volume"),
    [
        ('type="box" size=".1 .2 .3"', 8 * 0.006),
        ('type="sphere" size=".4"', 4 / 3 * PI * 0.4**3),
        ('type="ellipsoid" size=".1 .2 .3"', 4 / 3 * PI * 0.006),
        ('type="cylinder" size=".2 .5"', PI * 0.04),
        ('type="capsule" size=".2 .5"', PI * 0.04 + 4 / 3 * PI * 0.008),
    ],
)
def test_solids_are_closed_and_have_their_volume(geom, volume):
    model = model_of(geom)
    geometry = SceneGeometry.of_model(model, 48)
    corners = placed(geometry, model)
    found = (corners[:, 0] * np.cross(corners[:, 1], corners[:, 2])).sum() / 6.0
    assert (
        volume * 0.98 < found < volume * 1.00001
    )  # a polyhedron in the round shape, turned outwards
    assert np.abs(across(corners).sum(axis=0)).max() < 1e-6  # closed
    normals = geometry.vertices["normal"][geometry.triangles[0]].astype(float)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=-1), 1.0, atol=1e-5)
    if "ellipsoid" not in geom:  # whose normals the shader scales
        wide = np.linalg.norm(across(corners), axis=1) > 1e-9
        assert ((normals.sum(axis=1) * across(corners)).sum(axis=1)[wide] > 0).all()


def test_a_length_leaves_the_caps_of_a_capsule_round():
    model = model_of('type="capsule" size=".1 .5"')
    corners = placed(SceneGeometry.of_model(model, 24), model).reshape(-1, 3)
    top = corners[corners[:, 2] > 0.5]
    np.testing.assert_allclose(np.linalg.norm(top - [0, 0, 0.5], axis=1), 0.1, atol=1e-6)
    assert corners[:, 2].max() == pytest.approx(0.6) and corners[:, 2].min() == pytest.approx(-0.6)


def test_planes_without_an_edge_have_no_size():
    model = model_of('type="plane" size="0 2 1"', 'type="plane" size="3 2 1"')
    scales = geom_scales(model.geom_type, model.geom_size)
    np.testing.assert_array_equal(scales[:, :3], [[0, 2, 1], [3, 2, 1]])


def test_groups_below_three_are_visible_and_planes_come_last():
    model = model_of(
        'type="plane" size="1 1 1"',
        *(f'type="sphere" size=".1" group="{group}"' for group in range(6)),
        'type="box" size=".1 .1 .1" group="1"',
    )
    geometry = SceneGeometry.of_model(model, 8)
    assert list(geometry.triangles) == [1, 2, 3, 7, 0]
    assert geometry.planes == {0} and geometry.fields == set()
    for geom, triangles in geometry.triangles.items():
        assert set(np.unique(geometry.vertices["geom"][triangles])) == {geom}


def test_a_whole_mesh_has_the_files_triangles():
    mesh = trimesh.creation.icosphere(3, 0.3)
    model = model_of('type="mesh" mesh="m"', assets=mesh_asset(mesh))
    corners = placed(SceneGeometry.of_model(model, 8), model)
    assert len(corners) == len(mesh.faces)
    theirs = model.mesh_vert[model.mesh_face].astype(float)

    def sorted_rows(triangles: np.ndarray) -> np.ndarray:
        rows = np.round(triangles.mean(axis=1), 5)
        return rows[np.lexsort(rows.T)]

    np.testing.assert_allclose(sorted_rows(corners), sorted_rows(theirs), atol=2e-5)


@pytest.mark.parametrize("most", [100, 400])
def test_a_simplified_mesh_keeps_its_size(most):
    mesh = trimesh.creation.icosphere(4, 0.3)
    model = model_of('type="mesh" mesh="m"', assets=mesh_asset(mesh))
    geometry = SceneGeometry.of_model(model, 8, most)
    corners = placed(geometry, model)
    assert 0.5 * most < len(corners) <= 1.05 * most
    radius = np.linalg.norm(corners.reshape(-1, 3), axis=1)
    np.testing.assert_allclose(radius, 0.3, atol=0.02)
    outward = geometry.vertices["normal"][geometry.triangles[0]].astype(float)
    unit = corners / np.linalg.norm(corners, axis=-1, keepdims=True)
    assert np.quantile((outward * unit).sum(axis=-1), 0.01) > 0.9


def test_a_small_mesh_is_not_simplified():
    mesh = trimesh.creation.box((0.2, 0.3, 0.4))
    model = model_of('type="mesh" mesh="m"', assets=mesh_asset(mesh))
    geometry = SceneGeometry.of_model(model, 8, 100)
    assert len(geometry.triangles[0]) == 12


def test_edges_of_a_mesh_are_sharp_where_its_faces_turn():
    """MuJoCo gives a vertex the mean normal of its faces: at 90 deg each face has its own."""
    model = model_of('type="mesh" mesh="m"', assets=mesh_asset(trimesh.creation.box((1, 1, 1))))
    assert model.mesh_normalnum[0] == 8  # one normal a corner of the cube
    geometry = SceneGeometry.of_model(model, 12)
    faces = across(placed(geometry, model))
    unit = faces / np.linalg.norm(faces, axis=1, keepdims=True)
    normals = geometry.vertices["normal"][geometry.triangles[0]]
    np.testing.assert_allclose(normals, np.repeat(unit[:, None], 3, axis=1), atol=1e-6)


def test_a_round_mesh_is_smooth():
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.5)
    model = model_of('type="mesh" mesh="m"', assets=mesh_asset(ball))
    geometry = SceneGeometry.of_model(model, 12)
    vertices = geometry.vertices[geometry.triangles[0]]
    outward = vertices["position"] / np.linalg.norm(vertices["position"], axis=-1, keepdims=True)
    assert (outward * vertices["normal"]).sum(axis=-1).min() > 0.999
