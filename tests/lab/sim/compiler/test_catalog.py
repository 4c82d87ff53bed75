"""Every robot of the catalogue becomes a scene that steps."""

import mujoco
import numpy as np
import pytest

from embodichain.lab.sim.cfg import RobotCfg, SimulationManagerCfg
from embodichain.lab.sim.compiler import compile_scene, parse_articulation
from embodichain.utils.errors import ConfigError
from tests.data.robot_catalog import LOADABLE, NOT_LOADABLE, VISUALS_UNREADABLE
from tests.lab.sim.compiler.helpers import start

# A file that holds a <robot> without links: MuJoCo makes an empty world of it, we say so.
WITHOUT_LINKS = "ur_description/urdf/ur3.urdf"


@pytest.mark.parametrize("name", [name for name in LOADABLE if name != WITHOUT_LINKS])
def test_a_robot_loads_and_steps(name):
    # High above the ground and floating where it has legs: what it stands on is not the question.
    cfg = RobotCfg(fpath=name, init_pos=(0, 0, 3))
    parsed = parse_articulation("robot", cfg)
    assert len(parsed.joint_names) == LOADABLE[name]
    assert any("visual meshes left out" in note for note in parsed.notes) == (
        name in VISUALS_UNREADABLE
    )
    scene = compile_scene(SimulationManagerCfg(), [parsed], {}, {})
    data = start(scene, {"robot": parsed.init_qpos})
    for _ in range(10):
        mujoco.mj_step(scene.model, data)
    assert np.isfinite(data.qpos).all() and np.isfinite(data.qvel).all()
    assert not any(warning.number for warning in data.warning)
    index = scene.entities["robot"]
    assert len(index.body_ids) == len(parsed.link_names) == len(set(parsed.link_names))
    assert (parsed.init_qpos >= parsed.qpos_limits[:, 0] - 1e-9).all() or parsed.mimic_ids


@pytest.mark.parametrize("name", [WITHOUT_LINKS, *NOT_LOADABLE])
def test_a_robot_that_cannot_be_read_is_one_clear_error(name):
    with pytest.raises(ConfigError) as raised:
        parse_articulation("robot", RobotCfg(fpath=name))
    for problem in raised.value.problems:
        assert problem.path == "robot.fpath"
        assert name.rsplit("/", 1)[-1] in problem.message
        assert "\n" not in problem.message
