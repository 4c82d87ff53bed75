"""Mistakes in cameras: one report with file and line of each, exit code 2."""

from pathlib import Path

import pytest

from embodichain.cli import main

TASK = """\
description: Cameras with mistakes.
robot: {uid: ur10, fpath: UniversalRobots/UR10/UR10.urdf, init_pos: [0, 0, 1]}
sensors:
  both:
    sensor_type: camera
    fovy: 45
    intrinsics: [90, 90, 32, 32]
  nowhere:
    sensor_type: camera
    entity_cfg: {uid: ur10, link_names: [ee_lnk]}
  flat:
    sensor_type: camera
    width: 0
  behind:
    sensor_type: camera
    near: 5.0
    far: 1.0
  slow:
    sensor_type: camera
    rate: 0
  huge:
    sensor_type: camera
    width: 10000
    height: 10000
"""
FOUND = (
    ":7: task.sensors.both.intrinsics: fovy is given as well: leave one of them out",
    ":10: task.sensors.nowhere.entity_cfg.link_names: no link of 'ur10' matches 'ee_lnk'",
    ":13: task.sensors.flat.width: must be within 1 and 16384 pixels, got 0",
    ":17: task.sensors.behind.far: must be greater than near, 5.0 m, got 1.0",
    ":20: task.sensors.slow.rate: must be positive and finite, Hz, got 0",
    ":23: task.sensors.huge.width: 4000 environments x 10000 x 10000 pixels of color need 1490",
)


@pytest.mark.parametrize("verb", ["validate", "run"])
def test_all_in_one_report(tmp_path, monkeypatch, capsys, verb):
    (tmp_path / "conf" / "task").mkdir(parents=True)
    (tmp_path / "conf" / "task" / "seen.yaml").write_text(TASK)
    monkeypatch.chdir(tmp_path)
    assert main([verb, "task=seen", "num_envs=4000"]) == 2
    told = capsys.readouterr().err
    for line in FOUND:
        assert f"{Path('conf/task/seen.yaml')}{line}" in told
    assert len([line for line in told.splitlines() if "task.sensors" in line]) == len(FOUND)
