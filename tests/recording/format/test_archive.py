import io
import zipfile

import mujoco
import numpy as np
import pytest

from embodichain.recording.format.container.archive import load_mjz, scene_archive

TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"


@pytest.mark.parametrize("kind", ["absolute", "meshdir", "memory"])
def test_an_archive_holds_the_files_it_names(tmp_path, kind):
    folder = tmp_path / "robot" / "parts"
    folder.mkdir(parents=True)
    (folder / "a.obj").write_text(TETRAHEDRON)
    name = folder / "a.obj" if kind == "absolute" else "a.obj"
    compiler = '<compiler meshdir="parts"/>' if kind == "meshdir" else ""
    xml = f"""<mujoco>{compiler}<asset><mesh name="m" file="{name}"/></asset>
      <worldbody><geom type="mesh" mesh="m"/></worldbody></mujoco>"""
    if kind == "memory":
        spec = mujoco.MjSpec.from_string(xml, assets={"a.obj": TETRAHEDRON.encode()})
    else:
        (tmp_path / "robot" / "scene.xml").write_text(xml)
        spec = mujoco.MjSpec.from_file(str(tmp_path / "robot" / "scene.xml"))
    model = spec.compile()
    data = scene_archive(spec)
    (folder / "a.obj").unlink()
    loaded = load_mjz(data)
    assert np.array_equal(loaded.mesh_vert, model.mesh_vert)
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        assert archive.namelist() == ["model.xml", "assets/000_a.obj"]
        assert str(tmp_path) not in archive.read("model.xml").decode()


@pytest.mark.parametrize("data", [b"", b"no archive"])
def test_other_bytes_are_refused(data):
    with pytest.raises(ValueError, match="not an MJZ archive"):
        load_mjz(data)
