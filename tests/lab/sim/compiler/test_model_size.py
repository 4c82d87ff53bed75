"""Models and batches that are too large are refused at once; long work is reported."""

import logging
import time

import pytest

from embodichain.lab.sim.cfg import RobotCfg, SimulationManagerCfg
from embodichain.lab.sim.compiler import model_size
from embodichain.lab.sim.compiler.robot.articulation import parse_articulation
from embodichain.lab.sim.sim_manager import SimulationManager
from embodichain.utils.errors import ConfigError
from embodichain.utils.system import memory
from tests.lab.sim.compiler.helpers import INERTIAL, UR10, write


def chain(count: int) -> str:
    links = "".join(f'<link name="l{i}">{INERTIAL}</link>' for i in range(count))
    joints = "".join(
        f'<joint name="j{i}" type="fixed"><parent link="l{i - 1}"/><child link="l{i}"/></joint>'
        for i in range(1, count)
    )
    return f'<robot name="r">{joints}{links}</robot>'


def test_a_chain_deeper_than_mujoco_allows_is_refused_at_once(tmp_path):
    path = write(tmp_path / "long.urdf", chain(2000))
    with pytest.raises(ConfigError) as raised:
        parse_articulation("r", RobotCfg(fpath=path))
    message = "link 'l1999' is at the end of a chain of 2,000 links; MuJoCo allows 1,024"
    assert f"{path}: {message}" in str(raised.value)
    assert (
        len(parse_articulation("r", RobotCfg(fpath=write(path_of(tmp_path), chain(200)))).notes)
        == 0
    )


def path_of(folder):
    return folder / "short.urdf"


COPIES = """<mujoco><worldbody><body name="base"><geom size=".1"/>
<replicate count="{outer}" offset="1 0 0">
  <replicate count="{inner}" offset="0 1 0"><geom size=".1"/></replicate>
</replicate></body></worldbody></mujoco>"""


@pytest.mark.parametrize(("outer", "inner"), [(10**8, 1), (1000, 1000)])
def test_copies_that_take_mujoco_hours_are_refused_at_once(tmp_path, outer, inner):
    path = write(tmp_path / "many.xml", COPIES.format(outer=outer, inner=inner))
    with pytest.raises(ConfigError) as raised:
        parse_articulation("r", RobotCfg(fpath=path))
    assert f"{path}:2: <replicate> makes {outer * inner:,} copies; at most 100,000" in str(
        raised.value
    )


def test_copies_in_an_included_file_count(tmp_path):
    write(tmp_path / "part.xml", COPIES.format(outer=10**6, inner=10))
    path = write(tmp_path / "whole.xml", '<mujoco><include file="part.xml"/></mujoco>')
    with pytest.raises(ConfigError, match="part.xml: <replicate> makes 10,000,000 copies"):
        parse_articulation("r", RobotCfg(fpath=path))
    path = write(tmp_path / "few.xml", COPIES.format(outer=3, inner=4))
    assert len(parse_articulation("r", RobotCfg(fpath=path)).spec.geoms) == 13


def test_long_work_is_reported_while_it_goes_on(monkeypatch, caplog):
    # It is said after seconds, of files that tests have no time for.
    monkeypatch.setattr(model_size, "_FIRST", 0.02)
    with caplog.at_level(logging.WARNING), model_size.reported("r: reading big.urdf"):
        time.sleep(0.3)
    assert "r: reading big.urdf: not done after" in caplog.text
    assert 2 <= len(caplog.records) <= 5  # after 0.02, 0.04, 0.08, ... s


def test_environments_that_do_not_fit_into_memory_are_refused_with_the_number_that_does(
    monkeypatch,
):
    # A machine with 1 MB left.
    monkeypatch.setattr(memory, "available_memory", lambda: 10**6)
    with pytest.raises(ConfigError) as raised:
        SimulationManager(SimulationManagerCfg(headless=True, num_envs=10**9))
    message = "1,000,000,000 environments need at least 512 GB of memory, and 0.001 GB are free"
    assert f"num_envs: {message}: at most 1,953 fit" in str(raised.value)
    manager = SimulationManager(SimulationManagerCfg(headless=True, num_envs=1000))
    with pytest.raises(ConfigError, match="1,000 environments with this robot need"):
        manager.add_robot(RobotCfg(uid="arm", fpath=UR10))


def test_free_memory_is_what_the_system_says():
    free = memory.available_memory()
    assert free is not None and free > 10**6
