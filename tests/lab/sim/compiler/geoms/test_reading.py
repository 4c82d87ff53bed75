"""Mesh files that a test writes, with known sizes and colours, as parts."""

import numpy as np
import pytest
import trimesh
from PIL import Image

from embodichain.lab.sim.compiler.geoms.mesh_reading import MeshError, read_mesh
from tests.lab.sim.compiler.geoms.files import collada

RED, BLUE = (1.0, 0.0, 0.0, 1.0), (0.0, 0.0, 1.0, 1.0)


def extents(data):
    points = np.concatenate([part.vertices for part in data.parts])
    return points.max(axis=0) - points.min(axis=0)


def write(path, text):
    path.write_text(text)
    return path


@pytest.mark.parametrize("suffix", ["glb", "gltf", "obj", "off", "ply", "stl"])
def test_the_shape_survives_every_format(tmp_path, suffix):
    box = trimesh.creation.box((1, 2, 3))
    (tmp_path / "box").mkdir()
    box.export(tmp_path / f"box.{suffix}")
    data = read_mesh(tmp_path / f"box.{suffix}")
    assert extents(data) == pytest.approx([1, 2, 3])
    assert sum(len(part.faces) for part in data.parts) == 12
    (part,) = data.parts
    corners = part.vertices[part.faces].astype(np.float64)
    volume = np.einsum("ij,ij->", np.cross(corners[:, 0], corners[:, 1]), corners[:, 2]) / 6
    assert volume == pytest.approx(6)  # faces are still outside out


def test_an_ascii_stl_is_read(tmp_path):
    box = trimesh.creation.box((1, 2, 3))
    path = write(tmp_path / "box.stl", box.export(file_type="stl_ascii"))
    assert extents(read_mesh(path)) == pytest.approx([1, 2, 3])


@pytest.mark.parametrize(
    ("asset", "sizes"),
    [
        ("<up_axis>Z_UP</up_axis>", [1, 2, 3]),
        ('<unit meter="0.001"/><up_axis>Z_UP</up_axis>', [0.001, 0.002, 0.003]),
        ("<up_axis>Y_UP</up_axis>", [1, 3, 2]),
        ("<up_axis>X_UP</up_axis>", [2, 3, 1]),
        (  # MeshLab writes Y_UP whatever it holds
            "<contributor><authoring_tool>VCGLib | MeshLab</authoring_tool></contributor>"
            "<up_axis>Y_UP</up_axis>",
            [1, 2, 3],
        ),
    ],
)
def test_unit_and_up_axis_of_collada_are_followed(tmp_path, asset, sizes):
    path = write(tmp_path / "m.dae", collada(asset=asset, size=(1, 2, 3)))
    assert extents(read_mesh(path)) == pytest.approx(sizes)


def test_up_is_up(tmp_path):
    """What lies along the file's up axis lies along +z, and nothing is mirrored."""
    for axis, up in (("X_UP", 0), ("Y_UP", 1), ("Z_UP", 2)):
        size = [1.0, 1.0, 1.0]
        size[up] = 5.0
        text = collada(asset=f"<up_axis>{axis}</up_axis>", size=size)
        (part,) = read_mesh(write(tmp_path / f"{axis}.dae", text)).parts
        assert part.vertices[:, 2].max() == pytest.approx(5)
        assert part.vertices[:, 2].min() == pytest.approx(0)
        corners = part.vertices[part.faces].astype(np.float64)
        assert np.einsum("ij,ij->", np.cross(corners[:, 0], corners[:, 1]), corners[:, 2]) > 0


def test_parts_of_one_material_are_one_part(tmp_path):
    colors = [RED, BLUE, RED]
    path = write(tmp_path / "m.dae", collada(colors=colors))
    data = read_mesh(path)
    assert [part.rgba for part in data.parts] == [RED, BLUE]
    assert [len(part.faces) for part in data.parts] == [8, 4]


@pytest.mark.parametrize(
    ("transparency", "opacity"), [("1.0", 1.0), ("0.25", 0.25), ("0.0", 1.0), (None, 1.0)]
)
def test_opacity_of_collada(tmp_path, transparency, opacity):
    path = write(tmp_path / "m.dae", collada(colors=[RED], transparency=transparency))
    assert read_mesh(path).parts[0].rgba == pytest.approx((1, 0, 0, opacity))


def test_a_broken_material_costs_its_colour_only(tmp_path):
    text = collada(colors=[RED, BLUE]).replace('url="#effect1"', 'url="#nowhere"')
    data = read_mesh(write(tmp_path / "m.dae", text))
    assert [part.rgba for part in data.parts] == [RED, None]
    assert len(data.notes) == 1
    assert "nowhere" in data.notes[0]


def test_few_colours_of_faces_are_parts_and_many_their_mean(tmp_path):
    box = trimesh.creation.box()
    box.visual.face_colors = [[255, 0, 0, 255]] * 6 + [[0, 0, 255, 255]] * 6
    box.export(tmp_path / "two.ply")
    two = read_mesh(tmp_path / "two.ply")
    assert {part.rgba for part in two.parts} == {RED, BLUE}
    assert two.notes == []
    ball = trimesh.creation.icosphere()
    ball.visual.face_colors = [[i % 256, 0, 0, 255] for i in range(len(ball.faces))]
    ball.export(tmp_path / "many.ply")
    many = read_mesh(tmp_path / "many.ply")
    assert len(many.parts) == 1
    assert many.parts[0].rgba == pytest.approx((0.5, 0, 0, 1))
    assert "256 colours" in many.notes[0]


def test_a_texture_is_kept_and_made_small(tmp_path):
    Image.new("RGB", (2000, 500), (10, 200, 30)).save(tmp_path / "wood.jpg")
    (tmp_path / "m.mtl").write_text("newmtl wood\nKd 1 1 1\nmap_Kd wood.jpg\n")
    text = "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl wood\n"
    path = write(tmp_path / "m.obj", text + "f 1/1 2/2 3/3\n")
    (part,) = read_mesh(path).parts
    assert part.texture.size == (512, 128)
    assert part.uv.tolist() == [[0, 0], [0, 1], [1, 0]]


def test_a_texture_without_coordinates_is_its_mean_colour(tmp_path):
    image = Image.new("RGB", (2, 1), (255, 0, 0))
    image.putpixel((1, 0), (0, 0, 255))
    image.save(tmp_path / "t.png")
    text = collada(colors=[RED], texture="t.png")
    data = read_mesh(write(tmp_path / "m.dae", text))
    assert data.parts[0].texture is None
    assert data.parts[0].rgba == pytest.approx((0.5, 0, 0.5, 1))
    assert data.notes == ["a texture without coordinates: drawn in its mean colour"]


def test_a_missing_texture_is_said_by_name(tmp_path):
    data = read_mesh(write(tmp_path / "m.dae", collada(colors=[RED], texture="gone.png")))
    assert data.notes == ["texture 'gone.png' is missing: drawn in the material's colour"]


@pytest.mark.parametrize("name", ["m.dae", "m.glb", "m.ply", "m.stl", "m.gltf", "m.off"])
def test_a_broken_file_is_one_error_that_names_it(tmp_path, name):
    for content in (b"", b"nonsense", bytes(range(256)) * 4):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(MeshError) as raised:
            read_mesh(tmp_path / name)
        assert str(raised.value).startswith(str(tmp_path / name))


@pytest.mark.parametrize(("name", "package"), [("m.dae", "collada"), ("m.ply", "trimesh")])
def test_a_missing_library_is_one_line_that_says_what_to_install(
    tmp_path, monkeypatch, name, package
):
    monkeypatch.setitem(__import__("sys").modules, package, None)
    (tmp_path / name).write_text("")
    with pytest.raises(MeshError, match=f"needs {package}.*: pip install trimesh pycollada$"):
        read_mesh(tmp_path / name)
