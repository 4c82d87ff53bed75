"""Every robot of the catalogue becomes a scene that steps, and looks like what it collides by."""

import mujoco
import numpy as np
import pytest

from embodichain.lab.sim.cfg import RobotCfg, SimulationManagerCfg
from embodichain.lab.sim.compiler.compile_scene import compile_scene
from embodichain.lab.sim.compiler.geoms.shape_geoms import VISUAL_GROUP
from embodichain.lab.sim.compiler.robot.articulation import parse_articulation
from embodichain.lab.sim.compiler.scene_parts import SceneParts
from embodichain.utils.errors import ConfigError
from tests.data.robot_catalog import LOADABLE, NOT_LOADABLE, REPAIRED
from tests.lab.sim.compiler.helpers import start

pytestmark = pytest.mark.slow

# Its file puts the collision shape of each hand 1.57 m beside it: an angle that became a place.
OUT_OF_PLACE = "alex_description/urdf/alex_nub_hands.urdf"


@pytest.mark.unmeasured  # test_articulation.py and tests/lab/sim/compiler/geoms measure it
@pytest.mark.parametrize("name", LOADABLE)
def test_a_robot_loads_and_steps(name):
    # High above the ground and floating where it has legs: what it stands on is not the question.
    cfg = RobotCfg(fpath=name, init_pos=(0, 0, 3))
    parsed = parse_articulation("robot", cfg)
    assert len(parsed.joint_names) == LOADABLE[name]
    said = REPAIRED.get(name, ())
    notes = [note for note in parsed.notes if "collide as hulls" not in note]
    assert len(notes) == len(said)
    assert all(part in note for part, note in zip(said, notes, strict=True))
    scene = compile_scene(SceneParts(SimulationManagerCfg(), [parsed]))
    data = start(scene, {"robot": parsed.init_qpos})
    if name != OUT_OF_PLACE:
        assert_looks_like_its_collision_shapes(scene.model, data)
    for _ in range(10):
        mujoco.mj_step(scene.model, data)
    assert np.isfinite(data.qpos).all() and np.isfinite(data.qvel).all()
    assert not any(warning.number for warning in data.warning)
    index = scene.entities["robot"]
    assert len(index.body_ids) == len(parsed.link_names) == len(set(parsed.link_names))
    assert (parsed.init_qpos >= parsed.qpos_limits[:, 0] - 1e-9).all() or parsed.mimic_ids


def assert_looks_like_its_collision_shapes(model, data):
    """The boxes around both, of links that have both, differ by a sixth of a diagonal at most.

    A mesh in millimetres, or one that lies on its side, is beyond that.
    """
    mujoco.mj_kinematics(model, data)
    visual = model.geom_group == VISUAL_GROUP
    bodies = model.geom_bodyid
    both = np.intersect1d(bodies[visual], bodies[~visual & (bodies > 0)])
    if not len(both):
        return
    seen = box(model, data, np.flatnonzero(visual & np.isin(bodies, both)))
    felt = box(model, data, np.flatnonzero(~visual & np.isin(bodies, both)))
    assert np.abs(seen - felt).max() < np.linalg.norm(seen[1] - seen[0]) / 6


def box(model, data, geoms):
    """(2, 3) lowest and highest corner around some geoms, in the world."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    signs = np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T
    for geom in geoms:
        mesh = model.geom_dataid[geom]
        points = model.geom_aabb[geom, :3] + signs * model.geom_aabb[geom, 3:]
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
            first = model.mesh_vertadr[mesh]
            points = model.mesh_vert[first : first + model.mesh_vertnum[mesh]]
        world = points @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
        low, high = np.minimum(low, world.min(axis=0)), np.maximum(high, world.max(axis=0))
    return np.stack([low, high])


@pytest.mark.parametrize("name", NOT_LOADABLE)
def test_a_robot_that_cannot_be_read_is_one_clear_error(name):
    with pytest.raises(ConfigError) as raised:
        parse_articulation("robot", RobotCfg(fpath=name))
    (problem,) = raised.value.problems
    assert problem.path == "robot.fpath"
    assert name.rsplit("/", 1)[-1] in problem.message
    assert NOT_LOADABLE[name] in problem.message
