"""Meshes in a scene: what is drawn, collides and weighs; and cameras that a file defines."""

import mujoco
import numpy as np
import pytest
import trimesh
from PIL import Image

from embodichain.lab.sim.cfg import AttachmentCfg, RigidObjectCfg, RobotCfg, SimulationManagerCfg
from embodichain.lab.sim.compiler.compile_scene import compile_scene
from embodichain.lab.sim.compiler.robot.articulation import parse_articulation
from embodichain.lab.sim.compiler.scene_parts import SceneParts
from embodichain.lab.sim.drawing.views import Viewpoint
from embodichain.lab.sim.shapes import MeshCfg, VisualMaterialCfg
from embodichain.lab.sim.sim_manager import SimulationManager
from embodichain.utils.errors import ConfigError
from tests.lab.sim.compiler.geoms.files import collada
from tests.lab.sim.compiler.helpers import INERTIAL

RED, BLUE = (1, 0, 0, 1), (0, 0, 1, 1)


@pytest.fixture(scope="module")
def cache_folder(tmp_path_factory):
    """Shared by the tests, since to split a mesh takes seconds; `test_store` tests the cache."""
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(autouse=True)
def cache(cache_folder, monkeypatch):
    monkeypatch.setenv("EMBODICHAIN_CACHE", str(cache_folder))


def compiled(objects=None, robots=()):
    parsed = [parse_articulation(uid, cfg) for uid, cfg in robots]
    return compile_scene(SceneParts(SimulationManagerCfg(), parsed, objects or {})).model


def write(path, text):
    path.write_text(text)
    return str(path)


def two_colors(tmp_path):
    return write(tmp_path / "two.dae", collada(colors=[RED, BLUE], size=(0.2, 0.2, 0.2)))


def corner(tmp_path):
    boxes = [([0, 0, 0], [3, 1, 1]), ([0, 1, 0], [1, 3, 1])]
    whole = trimesh.util.concatenate([trimesh.creation.box(bounds=b) for b in boxes])
    whole.export(tmp_path / "corner.obj")
    return str(tmp_path / "corner.obj")


def robot(tmp_path, visual, collision, material=""):
    return write(
        tmp_path / "r.urdf",
        f"""<robot name="r"><link name="base">{INERTIAL}
        <visual><geometry><mesh filename="{visual}"/></geometry>{material}</visual>
        <collision><geometry><mesh filename="{collision}" scale="2 2 2"/></geometry></collision>
        </link></robot>""",
    )


def test_a_robots_visual_mesh_is_drawn_part_by_part_in_its_own_colours(tmp_path):
    mesh = two_colors(tmp_path)
    green = '<material name="g"><color rgba="0 1 0 1"/></material>'
    model = compiled(robots=[("r", RobotCfg(fpath=robot(tmp_path, mesh, mesh, green)))])
    (body,) = {int(b) for b in model.geom_bodyid if b}
    drawn = [g for g in range(model.ngeom) if model.geom_bodyid[g] == body]
    visual = [g for g in drawn if model.geom_group[g] == 2]
    assert [tuple(model.geom_rgba[g]) for g in visual] == [RED, BLUE]
    assert not model.geom_contype[visual].any()
    (felt,) = set(drawn) - set(visual)
    assert model.geom_contype[felt] and model.geom_group[felt] == 3
    assert model.geom_aabb[felt, 3:] == pytest.approx([0.2] * 3)  # scaled by 2, half sizes
    assert model.body_mass[body] == 1


def test_a_urdfs_colour_is_drawn_where_the_mesh_has_none(tmp_path):
    box = trimesh.creation.box((0.1, 0.1, 0.1))
    mesh = write(tmp_path / "b.stl", box.export(file_type="stl_ascii"))
    green = '<material name="g"><color rgba="0 1 0 1"/></material>'
    model = compiled(robots=[("r", RobotCfg(fpath=robot(tmp_path, mesh, mesh, green)))])
    assert (0, 1, 0, 1) in [tuple(rgba) for rgba in model.geom_rgba]


def test_materials_of_an_obj_are_not_lost(tmp_path):
    (tmp_path / "m.mtl").write_text("newmtl a\nKd 1 0 0\nnewmtl b\nKd 0 0 1\n")
    text = "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nusemtl a\nf 1 3 2\nf 1 2 4\n"
    mesh = write(tmp_path / "m.obj", text + "usemtl b\nf 1 4 3\nf 2 3 4\n")
    model = compiled(robots=[("r", RobotCfg(fpath=robot(tmp_path, mesh, mesh)))])
    rgba = {tuple(model.geom_rgba[g]) for g in range(model.ngeom) if model.geom_group[g] == 2}
    assert rgba == {RED, BLUE}


def test_an_object_of_several_colours_weighs_and_collides_once(tmp_path):
    cfg = RigidObjectCfg(shape=MeshCfg(fpath=two_colors(tmp_path)))
    cfg.attrs.mass = 0.7
    model = compiled({"box": cfg})
    geoms = np.flatnonzero(model.geom_bodyid == model.body("box").id)
    assert [model.geom(g).name for g in geoms] == ["box/geom", "box/visual_0", "box/visual_1"]
    assert model.geom_contype[geoms].tolist() == [1, 0, 0]
    assert model.geom_group[geoms].tolist() == [3, 2, 2]
    assert [tuple(model.mat_rgba[model.geom_matid[g]]) for g in geoms[1:]] == [RED, BLUE]
    assert model.body("box").mass[0] == pytest.approx(0.7)
    solid = RigidObjectCfg(shape=MeshCfg(fpath=two_colors(tmp_path)))
    solid.attrs.mass, solid.attrs.density = 0, 500
    assert compiled({"box": solid}).body("box").mass[0] == pytest.approx(500 * 0.2**3, rel=1e-3)


def test_a_given_material_wins_over_the_files(tmp_path):
    look = VisualMaterialCfg(base_color=[0, 1, 0, 1])
    shape = MeshCfg(fpath=two_colors(tmp_path), visual_material=look)
    model = compiled({"box": RigidObjectCfg(shape=shape)})
    (geom,) = np.flatnonzero(model.geom_bodyid == model.body("box").id)
    assert tuple(model.mat_rgba[model.geom_matid[geom]]) == (0, 1, 0, 1)


@pytest.mark.parametrize("config", [{"collision": "decompose"}, {"max_convex_hull_num": 8}])
def test_an_object_split_into_convex_parts_leaves_its_hollow_free(tmp_path, config):
    """A ball in the corner that the hull fills touches the one, and not the other."""
    fixed = {"body_type": "static", "shape": MeshCfg(fpath=corner(tmp_path))}

    def contacts(**given):
        ball = RigidObjectCfg(init_pos=(1.6, 1.6, 0.5))
        ball.shape = type(ball.shape).from_dict({"shape_type": "Sphere", "radius": 0.3})
        model = compiled({"corner": RigidObjectCfg(**fixed, **given), "ball": ball})
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        pairs = [{int(model.geom_bodyid[g]) for g in c.geom} for c in data.contact]
        return sum(pair == {model.body("corner").id, model.body("ball").id} for pair in pairs)

    assert contacts() > 0
    assert contacts(**config) == 0


def test_collision_meshes_of_a_urdf_and_of_an_mjcf_can_be_split(tmp_path):
    """A ball in the corner that the hull fills, where the mesh is turned, moved and scaled."""
    mesh = corner(tmp_path)
    cfg = RobotCfg(fpath=robot(tmp_path, mesh, mesh), collision="decompose")
    model = compiled(robots=[("r", cfg)])
    assert (model.geom_contype[model.geom_bodyid > 0] != 0).sum() >= 2
    mjcf = write(
        tmp_path / "m.xml",
        f"""<mujoco><compiler angle="degree"/><asset>
        <mesh name="corner" file="{mesh}" scale="0.1 0.1 0.1"/></asset>
        <worldbody><body name="base"><geom name="wall" type="mesh" mesh="corner" pos="0.5 0 0"
          euler="0 0 90" mass="2" friction="0.7 0.01 0.001" rgba="0 1 0 1"/></body></worldbody>
        </mujoco>""",
    )
    ball = RigidObjectCfg(init_pos=(0.5 - 0.16, 0.16, 0.05))
    ball.shape = type(ball.shape).from_dict({"shape_type": "Sphere", "radius": 0.03})
    found = {}
    for kind in ("hull", "decompose"):
        cfg = RobotCfg(fpath=mjcf, collision=kind)
        model = compiled({"ball": ball}, robots=[("r", cfg)])
        data = mujoco.MjData(model)
        data.qpos[:3] = ball.init_pos
        mujoco.mj_forward(model, data)
        of_ball = model.body("ball").id
        pairs = [model.geom_bodyid[c.geom] for c in data.contact]
        found[kind] = sum(of_ball in pair for pair in pairs)
        touching = np.flatnonzero((model.geom_contype != 0) & (model.geom_bodyid == of_ball - 1))
        assert (model.geom_friction[touching] == [0.7, 0.01, 0.001]).all()
        assert model.body("r/base").mass == 2
        assert model.geom_group[model.geom("r/wall").id] == 0  # is drawn
    assert found["hull"] > 0 and found["decompose"] == 0 and len(touching) >= 2
    with pytest.raises(ConfigError, match=r"collision: only a Mesh is split"):
        compiled({"cube": RigidObjectCfg(collision="decompose")})


def test_an_attachment_takes_any_mesh(tmp_path):
    mesh = two_colors(tmp_path)
    tool = AttachmentCfg(link="base", shape=MeshCfg(fpath=mesh), mass=0.3)
    cfg = RobotCfg(fpath=robot(tmp_path, mesh, mesh), attachments={"tool": tool})
    model = compiled(robots=[("r", cfg)])
    assert model.body("r/tool").mass[0] == pytest.approx(0.3)
    assert model.geom("r/tool/visual_1").contype[0] == 0


def test_a_texture_is_drawn_the_right_way_up(tmp_path):
    """A square in the xz plane: its texture is red above and blue below."""
    image = Image.new("RGB", (8, 8), (0, 0, 255))
    image.paste((255, 0, 0), (0, 0, 8, 4))
    image.save(tmp_path / "t.png")
    (tmp_path / "m.mtl").write_text("newmtl a\nKd 1 1 1\nmap_Kd t.png\n")
    corners = "v 0 0 0\nv 1 0 0\nv 1 0 1\nv 0 0 1\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
    faces = "f 1/1 2/2 3/3\nf 1/1 3/3 4/4\n"
    back = "v 0.5 0.5 0.5\nf 2/1 1/1 5/1\nf 3/1 2/1 5/1\nf 4/1 3/1 5/1\nf 1/1 4/1 5/1\n"
    mesh = write(tmp_path / "m.obj", f"mtllib m.mtl\n{corners}usemtl a\n{faces}{back}")
    sim = SimulationManager(SimulationManagerCfg(headless=True, ground_plane=False))
    square = RigidObjectCfg(uid="square", shape=MeshCfg(fpath=mesh), body_type="static")
    sim.add_rigid_object(square)
    view = Viewpoint.look_at((0.5, -3.0, 0.5), (0.5, 0.0, 0.5), (0.0, 0.0, 1.0), fovy=25.0)
    picture = sim.render(camera=view, width=64, height=64).astype(int)
    above, below = picture[22, 32], picture[42, 32]
    assert above[0] > 2 * above[2], above
    assert below[2] > 2 * below[0], below


CAMERAS = """<mujoco><worldbody><body name="arm"><geom size="0.1"/>
<joint name="j" type="hinge" axis="0 0 1"/>
<camera name="wrist" pos="0 -1 0" xyaxes="1 0 0 0 0 1" fovy="30"/><camera pos="0 0 3"/>
</body></worldbody></mujoco>"""


def test_cameras_of_a_file_are_named_after_its_entity(tmp_path):
    name = write(tmp_path / "arm.xml", CAMERAS)
    sim = SimulationManager(SimulationManagerCfg(headless=True))
    sim.add_robot(RobotCfg(uid="panda", fpath=name, init_pos=(0, 0, 1)))
    wrist = sim.render(camera="panda/wrist", width=32, height=32)
    other = sim.render(camera="panda/camera_1", width=32, height=32)
    assert (wrist != other).any()
    with pytest.raises(ValueError, match=r"default, panda/wrist, panda/camera_1.*panda/wrist"):
        sim.render(camera="panda/wrists")


def test_an_ascii_stl_in_an_mjcf_is_converted_and_said(tmp_path):
    box = trimesh.creation.box((0.1, 0.2, 0.3))
    write(tmp_path / "b.stl", box.export(file_type="stl_ascii"))
    name = write(
        tmp_path / "m.xml",
        "<mujoco><asset><mesh name='b' file='b.stl'/></asset><worldbody><body name='l'>"
        "<geom type='mesh' mesh='b'/></body></worldbody></mujoco>",
    )
    parsed = parse_articulation("r", RobotCfg(fpath=name))
    assert sorted(parsed.model.geom_aabb[0, 3:]) == pytest.approx([0.05, 0.1, 0.15])
    assert any("b.stl: not a mesh that MuJoCo reads" in note for note in parsed.notes)
