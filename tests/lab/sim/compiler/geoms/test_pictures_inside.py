"""Pictures inside of meshes: PostScript in them is neither drawn nor left out without a word."""

import base64
import json
from pathlib import Path

import pytest

from embodichain.lab.sim.compiler.geoms.mesh_reading import MeshError, read_mesh

POSTSCRIPT = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n%%EndComments\nshowpage\n"


def test_a_texture_of_postscript_is_left_out_with_a_note(tmp_path: Path) -> None:
    (tmp_path / "x.png").write_bytes(POSTSCRIPT)
    (tmp_path / "m.mtl").write_text("newmtl a\nmap_Kd x.png\n")
    mesh = tmp_path / "m.obj"
    mesh.write_text(
        "mtllib m.mtl\nusemtl a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n"
    )
    data = read_mesh(mesh)
    assert [part.texture for part in data.parts] == [None]
    assert any("'x.png' cannot be read (it is PostScript" in note for note in data.notes)


def test_postscript_in_a_data_uri_is_refused(tmp_path: Path) -> None:
    mesh = tmp_path / "m.gltf"
    uri = f"data:image/png;base64,{base64.b64encode(POSTSCRIPT).decode()}"
    mesh.write_text(json.dumps({"asset": {"version": "2.0"}, "images": [{"uri": uri}]}))
    with pytest.raises(MeshError, match="PostScript"):
        read_mesh(mesh)
