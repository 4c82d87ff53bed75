"""Armature that limited drives need becomes part of the config, from the config alone."""

import json

import pytest
import yaml

import embodichain
from embodichain.cli import main
from embodichain.config import dump_yaml, resolve, resolve_tree
from tests.config.conftest import WriteTask

LIMITED = "  drive_pros: {max_effort: file}\n"
INIT = "  init_qpos: [0, -1, 1, 0, 0, 0]\n"
DRAW = """events:
  gains:
    func: randomize_actuator_gains
    mode: reset
    params: {entity_cfg: {uid: arm, joint_names: Joint6}, damping_range: [1, 2], operation: scale}
"""


def armature(*overrides: str) -> dict[str, float]:
    drives = resolve(["task=mine", *overrides]).tree["task"]["robot"].get("drive_pros", {})
    return dict(drives.get("armature") or {})


def test_it_is_written_into_the_frozen_config_and_said(write_task: WriteTask) -> None:
    write_task(INIT, INIT + LIMITED)
    resolved = resolve(["task=mine"])
    found = armature()
    # By hand for the last joint, whose own inertia is small: 0.0025 x 1e3 + 0.005^2 / 4 x 1e4.
    assert found["Joint6"] == pytest.approx(2.5625, abs=0.05)
    (note,) = resolved.notes
    assert note.path == "task.robot.drive_pros.armature" and "Joint6: 2.6" in note.message
    assert armature("num_envs=64", "seed=7") == found  # never of N or seed
    again = resolve_tree(yaml.safe_load(dump_yaml(resolved.tree)), "config.yaml")
    assert again.tree == resolved.tree and not again.notes
    env = embodichain.make("mine", num_envs=2)
    model = env.sim.engine.model
    for name, value in found.items():
        assert model.dof_armature[model.joint(f"arm/{name}").dofadr[0]] == value
    env.close()


def test_only_joints_whose_armature_is_not_given_are_changed(write_task: WriteTask) -> None:
    write_task(INIT, INIT + LIMITED)
    every = armature()
    some = armature("+task.robot.drive_pros.armature={Joint1: 9.0}")
    assert some["Joint1"] == 9.0 and some["Joint6"] == every["Joint6"]
    assert armature("task.robot.drive_pros.max_effort=1e10") == {}
    assert not resolve(["task=mine", "+task.robot.drive_pros.armature=9"]).notes


def test_gains_that_events_draw_count(write_task: WriteTask) -> None:
    write_task(INIT, INIT + LIMITED)
    calm = armature()
    path = write_task(INIT, INIT + LIMITED)
    path.write_text(path.read_text().replace("events:\n", DRAW))
    drawn = armature()
    assert drawn["Joint6"] == pytest.approx(calm["Joint6"] + 2.5, abs=0.05)
    assert drawn["Joint2"] == pytest.approx(calm["Joint2"], rel=0.1)


def test_gains_drawn_by_randomize_count_too(write_task: WriteTask) -> None:
    path = write_task(INIT, INIT + LIMITED)
    text = path.read_text()
    path.write_text(text.replace("events:\n", DRAW))
    alias = armature()
    draw = DRAW.replace("randomize_actuator_gains", "randomize").replace("entity_cfg", "of")
    path.write_text(text.replace("events:\n", draw.replace("damping_range", "damping")))
    assert armature() == alias


def test_show_lists_it_with_speeds(
    write_task: WriteTask, capsys: pytest.CaptureFixture[str]
) -> None:
    write_task(INIT, INIT + LIMITED.replace("}", ", max_velocity: file}"))
    assert main(["show", "task=mine", "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert "Joint6: 2.6" in data["notes"][0]["message"]
    drives = {row["joint"]: row for row in data["drives"]}
    row = drives["arm/Joint6"]
    # I = 2.6003, effort 56, range 4 pi: sqrt(56 x 12.566 / 2.6003) = 16.45;
    # 2.6003 s^2 + 1e3 s + 1e4 = 0: s = -10.27
    assert row["top speed by effort"] == pytest.approx(16.45, abs=0.06)
    assert row["time constant s"] == pytest.approx(0.0973, abs=0.0005)
    assert row["max_velocity of targets"] == pytest.approx(3.14, abs=0.01)
    assert main(["show", "task=mine"]) == 0
    assert "note: task.robot.drive_pros.armature: raised to {" in capsys.readouterr().out
