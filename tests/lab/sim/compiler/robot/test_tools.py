"""Tool points of control parts: links of their own, where `solver_cfg` puts them."""

import numpy as np
import pytest

from embodichain.lab.sim.cfg import RobotCfg, SolverCfg
from embodichain.lab.sim.compiler.robot.articulation import parse_articulation
from embodichain.utils.errors import ConfigError
from embodichain.utils.fields.type_errors import from_dict
from tests.lab.sim.compiler.helpers import HOME, UR10

TCP = np.array([[0, -1, 0, 0.1], [1, 0, 0, 0.0], [0, 0, 1, 0.16], [0, 0, 0, 1]], float)
PARTS = {"arm": ["Joint[1-6]"]}


def parse(**values):
    return parse_articulation("ur10", RobotCfg(fpath=UR10, control_parts=PARTS, **values))


def test_a_tool_point_is_a_massless_link():
    solver = SolverCfg(end_link_name="ee_link", root_link_name="base_link", tcp=TCP)
    parsed = parse(solver_cfg={"arm": solver})
    assert parsed.tools == {"arm": "arm_tcp"}
    body = parsed.model.body("arm_tcp")
    assert parsed.model.body(int(body.parentid[0])).name == "ee_link"
    np.testing.assert_allclose(body.pos, [0.1, 0, 0.16])
    np.testing.assert_allclose(body.quat, [np.sqrt(0.5), 0, 0, np.sqrt(0.5)])
    plain = parse()
    assert plain.tools == {}
    assert parsed.model.body_mass.sum() == plain.model.body_mass.sum()
    assert parsed.link_names == (*plain.link_names, "arm_tcp")


def test_the_end_link_alone_is_the_tool():
    for tcp in (None, np.eye(4)):
        parsed = parse(solver_cfg={"arm": SolverCfg(end_link_name="wrist_3_link", tcp=tcp)})
        assert parsed.tools == {"arm": "wrist_3_link"}
        assert "arm_tcp" not in parsed.link_names


def test_one_solver_is_the_whole_robots():
    solver = SolverCfg(end_link_name="ee_link", tcp=TCP)
    assert parse(solver_cfg=solver).tools == {"default": "tcp"}
    flat = {"class_type": "PytorchSolver", "end_link_name": "ee_link", "tcp": TCP.tolist()}
    cfg = from_dict(RobotCfg, {"fpath": UR10, "init_qpos": HOME, "solver_cfg": flat})
    assert parse_articulation("ur10", cfg).tools == {"default": "tcp"}


@pytest.mark.parametrize(
    ("part", "solver", "message"),
    [
        ("amr", {"end_link_name": "ee_link"}, "solver_cfg.amr: no control part .*: arm, default"),
        ("arm", {"end_link_name": "ee_lnk"}, "solver_cfg.arm.end_link_name: no link .*'ee_link'"),
        ("arm", {"root_link_name": "base"}, "solver_cfg.arm.root_link_name: no link"),
        ("arm", {"tcp": TCP}, "solver_cfg.arm.end_link_name: missing value"),
        ("arm", {"end_link_name": "ee_link", "tcp": 2 * TCP}, "solver_cfg.arm.tcp: must be a 4x4"),
    ],
)
def test_mistakes_name_their_key(part, solver, message):
    with pytest.raises(ConfigError, match=f"ur10.{message}"):
        parse(solver_cfg={part: SolverCfg(**solver)})
