"""Links that collide as primitive shapes: contacts, mass, what else is kept, and mistakes."""

import mujoco
import numpy as np
import pytest

from embodichain.lab.sim.cfg import CollisionShapeCfg, RigidBodyAttributesCfg, RobotCfg
from embodichain.lab.sim.compiler.robot.articulation import parse_articulation
from embodichain.lab.sim.shapes import CapsuleCfg, MeshCfg, PlaneCfg, SphereCfg
from embodichain.utils.errors import ConfigError
from tests.lab.sim.compiler.helpers import scene_of, start, touching, write

# A box of 0.2 m on a ball of 0.1 m, 0.3 m below it; mass comes from the geoms' density.
TOY = """<mujoco model="toy"><worldbody><body name="trunk">
  <freejoint/>
  <geom name="box" type="box" size="0.1 0.1 0.1"/>
  <body name="foot" pos="0 0 -0.3">
    <joint name="ankle" axis="0 1 0"/>
    <geom name="ball" size="0.1" friction="0.7 0.01 0.001" condim="4" solref="0.01 1"/>
  </body>
</body></worldbody></mujoco>"""


def ball(radius=0.05, **fields):
    return CollisionShapeCfg(shape=SphereCfg(radius=radius), **fields)


@pytest.fixture
def parsed(tmp_path):
    """A function that parses the toy with collision shapes by link regex."""
    path = write(tmp_path / "toy.xml", TOY)

    def parse(shapes, **fields):
        cfg = RobotCfg(fpath=path, fix_base=False, collision_shapes=shapes, **fields)
        return parse_articulation("toy", cfg)

    return parse


def test_a_shape_replaces_those_of_the_file_and_collides_as_they_did(parsed):
    plain = parsed({})
    toy = parsed({"f.*": ball(init_pos=(0.01, 0, -0.02))})
    geom, old = toy.model.geom("foot/collision/geom"), toy.model.geom("ball")
    assert geom.type[0] == mujoco.mjtGeom.mjGEOM_SPHERE
    np.testing.assert_allclose(geom.size[0], 0.05)
    np.testing.assert_allclose(geom.pos, [0.01, 0, -0.02])
    assert (old.contype[0], old.conaffinity[0]) == (0, 0)
    assert (geom.contype[0], geom.conaffinity[0]) == (1, 1)
    np.testing.assert_allclose(geom.friction, [0.7, 0.01, 0.001])
    np.testing.assert_allclose(geom.solref, [0.01, 1])
    assert geom.condim[0] == 4
    np.testing.assert_array_equal(toy.model.body_mass, plain.model.body_mass)
    np.testing.assert_array_equal(toy.model.body_inertia, plain.model.body_inertia)


def test_a_foot_stands_by_its_shape_and_a_link_without_one_touches_nothing(parsed, tmp_path):
    path = str(tmp_path / "toy.xml")
    write(tmp_path / "toy.xml", TOY)
    # The foot's centre is at 0.04 m: a ball of 0.05 m touches the ground.
    for shapes, wanted in (
        ({"foot": ball()}, {frozenset({"world", "toy/foot"})}),
        ({"foot": ball(0.03)}, set()),
        ({"foot": None}, set()),
    ):
        cfg = RobotCfg(fpath=path, fix_base=False, init_pos=(0, 0, 0.34), collision_shapes=shapes)
        scene = scene_of({"toy": cfg})
        assert touching(scene, start(scene, {})) == wanted


def test_every_mistake_is_reported_at_its_place(parsed):
    with pytest.raises(ConfigError) as caught:
        parsed(
            {
                "feet": ball(),
                "foot": CollisionShapeCfg(shape=PlaneCfg()),
                "fo.*": CollisionShapeCfg(shape=CapsuleCfg()),
                "trunk": CollisionShapeCfg(shape=MeshCfg(fpath="a.stl")),
            }
        )
    found = {p.path: f"{p.message} {p.hint}" for p in caught.value.problems}
    below = "toy.collision_shapes"
    assert set(found) == {
        f"{below}.feet",
        f"{below}.foot.shape.shape_type",
        f"{below}.fo.*",
        f"{below}.trunk.shape.shape_type",
    }
    assert "foot" in found[f"{below}.feet"]
    assert "'foot' matches link 'foot' too" in found[f"{below}.fo.*"]
    with pytest.raises(ConfigError, match=r"collision_shapes: attrs.enable_collision is false"):
        parsed({"foot": ball()}, attrs=RigidBodyAttributesCfg(enable_collision=False))
