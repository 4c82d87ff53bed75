"""The cache: named by content, whole or not there, safe to fill by several processes at once."""

import multiprocessing
import os
import subprocess
import sys
from pathlib import Path

import pytest
import trimesh

from embodichain.lab.sim.compiler.geoms.mesh_conversion import (
    cache_folder,
    convert_collision,
    convert_visual,
    decompose,
    entry,
    reads,
)
from embodichain.lab.sim.compiler.geoms.mesh_reading import MeshError
from tests.lab.sim.compiler.geoms.files import collada


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("EMBODICHAIN_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache" / "meshes"


def test_where_it_is(monkeypatch, cache):
    assert cache_folder() == cache
    monkeypatch.delenv("EMBODICHAIN_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", "/somewhere")
    assert cache_folder() == Path("/somewhere/embodichain/meshes")
    monkeypatch.delenv("XDG_CACHE_HOME")
    assert cache_folder() == Path.home() / ".cache/embodichain/meshes"


def test_the_same_content_is_made_once_and_other_content_anew(tmp_path):
    path = tmp_path / "m.dae"
    path.write_text(collada(size=(1, 1, 1)))
    first = convert_visual(path).parts[0].mesh
    written = first.stat().st_mtime_ns
    os.utime(path)
    (tmp_path / "elsewhere").mkdir()
    copy = tmp_path / "elsewhere" / "m.dae"
    copy.write_bytes(path.read_bytes())
    assert convert_visual(path).parts[0].mesh == convert_visual(copy).parts[0].mesh == first
    assert first.stat().st_mtime_ns == written
    path.write_text(collada(size=(2, 1, 1)))
    assert convert_visual(path).parts[0].mesh != first


def test_another_material_file_is_other_content(tmp_path):
    path = tmp_path / "m.obj"
    path.write_text("mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl a\nf 1 2 3\n")
    colors = []
    for color in ("1 0 0", "0 0 1"):
        (tmp_path / "m.mtl").write_text(f"newmtl a\nKd {color}\n")
        colors.append(convert_visual(path).parts[0].rgba[:3])
    assert colors == [(1, 0, 0), (0, 0, 1)]


def test_a_failure_leaves_nothing_behind(tmp_path, cache):
    (tmp_path / "m.ply").write_text("nonsense")
    with pytest.raises(MeshError):
        convert_collision(tmp_path / "m.ply")
    assert list(cache.iterdir()) == []


def test_processes_that_make_the_same_at_once_get_the_same(tmp_path, cache):
    (tmp_path / "m.dae").write_text(collada(colors=[(1, 0, 0, 1), (0, 0, 1, 1)]))
    with multiprocessing.get_context("spawn").Pool(3) as pool:
        made = pool.map(convert_visual, [tmp_path / "m.dae"] * 6)
    assert all(one == made[0] for one in made)
    assert all(part.mesh.is_file() for part in made[0].parts)
    assert len(list(cache.iterdir())) == 1  # and no folder of a loser


def test_an_entry_that_appears_meanwhile_is_taken(cache):
    def make(folder):
        folder.joinpath("late").write_text("")
        entry("name", lambda early: early.joinpath("early").write_text("") and {} or {})
        return {}

    place, _ = entry("name", make)
    assert [p.name for p in sorted(place.iterdir())] == ["early", "manifest.json"]


def test_which_files_mujoco_reads(tmp_path):
    box = trimesh.creation.box()
    for name, kind, expected in (
        ("binary.stl", "stl", True),
        ("ascii.stl", "stl_ascii", False),
        ("box.obj", "obj", True),
        ("box.ply", "ply", False),
    ):
        content = box.export(file_type=kind)
        content = content.encode() if isinstance(content, str) else content
        (tmp_path / name).write_bytes(content)
        assert reads(tmp_path / name) == expected
    (tmp_path / "many.stl").write_bytes(bytes(80) + (200_001).to_bytes(4, "little"))
    assert not reads(tmp_path / "many.stl")


def test_a_concave_mesh_becomes_convex_parts_the_same_ones_each_time(tmp_path, monkeypatch):
    corner = trimesh.util.concatenate(
        [
            trimesh.creation.box(bounds=[[0, 0, 0], [3, 1, 1]]),
            trimesh.creation.box(bounds=[[0, 1, 0], [1, 3, 1]]),
        ]
    )
    corner.export(tmp_path / "corner.ply")
    parts = decompose(tmp_path / "corner.ply")
    assert len(parts) >= 2
    volume = sum(trimesh.load_mesh(part).convex_hull.volume for part in parts)
    assert volume == pytest.approx(5, rel=0.1)  # the hull of the whole has 7
    monkeypatch.setenv("EMBODICHAIN_CACHE", str(tmp_path / "other"))
    again = decompose(tmp_path / "corner.ply")
    assert [p.read_bytes() for p in again] == [p.read_bytes() for p in parts]
    assert len(decompose(tmp_path / "corner.ply", max_parts=1)) == 1


SPLIT_AND_MOVE = """
from pathlib import Path
from embodichain.lab.sim.compiler.geoms.mesh_conversion import decompose
assert decompose(Path("box.ply"))
import ruckig
given = ruckig.InputParameter(1)
given.current_position, given.target_position = [0.0], [1.0]
given.max_velocity, given.max_acceleration, given.max_jerk = [1.0], [1.0], [1.0]
assert ruckig.Ruckig(1).calculate(given, ruckig.Trajectory(1)) == ruckig.Result.Working
"""


def test_a_process_that_split_a_mesh_can_plan_the_motions_of_an_expert(tmp_path):
    """Ruckig loaded after coacd ends the process with a segmentation fault."""
    trimesh.creation.box().export(tmp_path / "box.ply")
    done = subprocess.run([sys.executable, "-c", SPLIT_AND_MOVE], cwd=tmp_path, check=False)
    assert done.returncode == 0


def test_without_coacd_one_line_says_what_to_install(tmp_path, monkeypatch):
    from importlib import metadata

    def missing(name):
        raise metadata.PackageNotFoundError(name)

    # As if the extra were not installed.
    monkeypatch.setattr(metadata, "version", missing)
    with pytest.raises(MeshError, match=r"pip install 'embodichain\[decompose\]'$"):
        decompose(tmp_path / "m.ply")
