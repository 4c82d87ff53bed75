"""Tasks whose robots are MJCF files with actuators, as people run them: show, run, verify."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

import embodichain.recording as recording
from embodichain.cli import main
from tests.helpers.mjcf_robots import HAND, UR5E, ZOO


@pytest.fixture
def task(tmp_path, monkeypatch):
    """``task(text, **sections)``: a task ``mine`` with that robot; returns its config folder."""
    monkeypatch.chdir(tmp_path)

    def write(text: str, **sections) -> str:
        folder = tmp_path / "conf" / "task"
        folder.mkdir(parents=True)
        (folder / "robot.xml").write_text(text)
        robot = {"uid": "r", "fpath": str(folder / "robot.xml"), "init_pos": [0, 0, 1]}
        tree = {
            "robot": {**robot, **sections.pop("robot", {})},
            "max_episode_steps": 20,
            **sections,
        }
        (folder / "mine.yaml").write_text(yaml.safe_dump(tree))
        return str(folder.parent)

    return write


def test_show_lists_every_actuator(task, capsys):
    folder = task(ZOO, actions={})
    action = "{func: actuator_ctrl, params: {entity_cfg: {uid: r}, clip: 1.0}}"
    words = ["task=mine", "--config-dir", folder, f"+task.actions.all={action}"]
    assert main(["show", *words, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    rows = {row["actuator"]: row for row in told["actuators"]}
    assert len(rows) == 16 and len(told["action vector"]) == 20
    assert rows["r/geared_servo"] == {
        "actuator": "r/geared_servo",
        "kind": "position",
        "on": "joint r/geared",
        "gear": 3.0,
        "gain": 7.0,
        "stiffness": 7.0,
        "damping": 0.5,
        "ctrl range": "no limit",
        "force range": "no limit",
    }
    kinds = {name: (row["kind"], row["on"]) for name, row in rows.items()}
    assert kinds["r/pull"] == ("motor", "tendon r/sum")
    assert kinds["r/lag"] == ("filterexact position", "joint r/lagging")
    assert kinds["r/grip"] == ("adhesion", "body r/e")
    assert kinds["r/wrist"] == ("so3", "ball joint r/socket")
    assert rows["r/servo"]["force range"] == [-9.0, 11.0]
    assert rows["r/wheel"]["ctrl range"] == [-5.0, 5.0]
    assert main(["show", *words]) == 0
    assert "r/geared_servo" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("text", "sections", "names"),
    [
        (UR5E, {}, ["r/shoulder_pan", "r/shoulder_lift", "r/elbow", "r/wrist_1"]),
        (HAND, {}, ["r/fingers"]),
        (
            ZOO,
            {
                "actions": {
                    "all": {
                        "func": "actuator_ctrl",
                        "params": {"entity_cfg": {"uid": "r"}, "clip": 0.5},
                    }
                },
                "events": {
                    "weak": {
                        "func": "randomize_actuator_strength",
                        "mode": "reset",
                        "params": {
                            "entity_cfg": {"uid": "r", "joint_names": ["servoed", "geared"]},
                            "strength_range": [0.5, 1.5],
                        },
                    }
                },
            },
            ["r/servo", "r/geared_servo", "r/wheel", "r/wrist.qw"],
        ),
    ],
    ids=["ur5e", "hand", "zoo"],
)
def test_rollouts_of_its_own_actuators_verify_to_the_bit(task, text, sections, names, capfd):
    folder = task(text, **sections)
    words = ["task=mine", "num_envs=2", "max_steps=45", "episodes=99", "seed=3", "--quiet"]
    assert main(["run", *words, "--config-dir", folder]) == 0
    capfd.readouterr()
    assert main(["replay", "last", "--verify", "--json"]) == 0
    assert json.loads(capfd.readouterr().out)["steps"] == 45
    (path,) = Path("outputs").rglob("*.mcap")
    with recording.open(path) as log:
        controls = log.read("ctrl")
        assert [c.name for c in log.columns["ctrl"]][: len(names)] == names
        assert np.ptp(controls["ctrl"][..., 0]) > 0.1


def test_drives_under_a_files_effort_limits_get_the_armature_that_they_need(task, capsys):
    gains = {"stiffness": {"wrist_3_joint": 1e4}, "damping": {"wrist_3_joint": 1e3}}
    folder = task(UR5E, robot={"drive_pros": gains})
    assert main(["show", "task=mine", "--config-dir", folder, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    # The drive alone needs 0.005 x 1e3 + 0.25 x 0.01^2 x 1e4 = 5.25; the servos are left alone.
    armature = told["config"]["task"]["robot"]["drive_pros"]["armature"]
    assert list(armature) == ["wrist_3_joint"] and 5.0 < armature["wrist_3_joint"] < 5.5


FOLDED = """<robot name="f">{links}{joints}</robot>""".format(
    links="".join(
        f'<link name="{name}"><inertial><mass value="1"/><inertia ixx="0.1" iyy="0.1" izz="0.1" '
        'ixy="0" ixz="0" iyz="0"/></inertial><collision><geometry><sphere radius="0.05"/>'
        "</geometry></collision></link>"
        for name in ("base", "upper", "left_tip", "right_tip")
    ),
    joints="".join(
        f'<joint name="{child}_joint" type="revolute"><parent link="{parent}"/>'
        f'<child link="{child}"/><origin xyz="0 0 {z}"/><axis xyz="0 0 1"/>'
        '<limit lower="-1" upper="1" effort="9" velocity="1"/></joint>'
        for parent, child, z in (
            ("base", "upper", 0.2),
            ("upper", "left_tip", -0.15),
            ("upper", "right_tip", 0.2),
        )
    ),
)


def test_self_collision_is_said_by_run_validate_and_show(task, capsys):
    # left_tip is 0.05 m from the base, whose radius is that of the tip: 0.05 m deep.
    folder = task(FOLDED, robot={"drive_pros": {"stiffness": 10}})
    words = ["task=mine", "--config-dir", folder]
    told = "base and left_tip (50 mm); those named like pairs that are: base and right_tip"
    for verb in (["run", "max_steps=2", "episodes=1", "--quiet"], ["validate"]):
        assert main([*verb, *words]) == 0
        assert told in capsys.readouterr().err
    assert main(["show", *words, "--json"]) == 0
    tables = json.loads(capsys.readouterr().out)
    assert any(told in row["note"] for row in tables["notes on files"])
    (row,) = tables["self-collision"]
    assert row["overlap at the start"] == "base - left_tip, base - right_tip"
    include = "+task.robot.self_collision.include=[[base, .*_tip]]"
    assert main(["show", *words, "--json", include]) == 0
    (row,) = json.loads(capsys.readouterr().out)["self-collision"]
    assert (row["overlap at the start"], row["included"]) == (
        "",
        "base - left_tip, base - right_tip",
    )
    assert main(["validate", *words, "+task.robot.self_collision.exclude=[[base, left_tp]]"]) == 2
    said = capsys.readouterr().err
    assert "self_collision.exclude.0.1: no link matches 'left_tp'" in said
    assert "Did you mean 'left_tip'?" in said


def test_validate_names_links_that_overlap_in_many_postures(task, capsys):
    # With the joint at 0.2 m instead of 0.05, left_tip is in the base in no posture at the start.
    away = FOLDED.replace('xyz="0 0 -0.15"', 'xyz="0.2 0 -0.2"').replace('lower="-1"', 'lower="-3"')
    robot = {"init_qpos": {"left_tip_joint": 0.5}}
    folder = task(away.replace('<axis xyz="0 0 1"/>', '<axis xyz="0 1 0"/>'), robot=robot)
    assert main(["validate", "task=mine", "--config-dir", folder, "--json"]) == 0
    notes = json.loads(capsys.readouterr().out).get("notes", [])
    assert len([n for n in notes if "in many of 200 postures: " in n["message"]]) == 1


def test_one_writes_over_a_files_gains_in_yaml(task, capsys):
    folder = task(UR5E, robot={"drive_pros": {"stiffness": {"elbow_joint": 900}}})
    words = ["show", "task=mine", "--config-dir", folder, "--json"]
    assert main(words) == 0
    told = json.loads(capsys.readouterr().out)
    rows = {r["actuator"]: r for r in told["actuators"]}
    assert rows["r/elbow_joint"]["stiffness"] == 900.0 and "r/elbow" not in rows
    (note,) = [n["note"] for n in told["notes on files"] if "drive_pros" in n["note"]]
    assert note.endswith("drives (drive_pros) replace its actuators: 'elbow' on 'elbow_joint'")
    assert main([*words, "task.robot.drive_pros.stiffness=file"]) == 0
    rows = {r["actuator"]: r for r in json.loads(capsys.readouterr().out)["actuators"]}
    assert rows["r/elbow"]["stiffness"] == 2000.0


def test_an_attached_gripper_is_shown_runs_and_verifies_to_the_bit(task, capfd):
    gripper = {"fpath": "ParallelGripper/parallel_gripper.xml", "to": "wrist_3_link"}
    folder = task(UR5E, robot={"attach": {"gripper": gripper}})
    assert main(["show", "task=mine", "--config-dir", folder, "--json"]) == 0
    (row,) = json.loads(capfd.readouterr().out)["attached files"]
    assert row == {
        "attached": "r/gripper",
        "on": "r/wrist_3_link",
        "file": gripper["fpath"],
        "joints": "gripper/left, gripper/right",
        "controls": "gripper/grip",
    }
    words = ["task=mine", "num_envs=2", "max_steps=30", "episodes=99", "seed=3", "--quiet"]
    assert main(["run", *words, "--config-dir", folder]) == 0
    capfd.readouterr()
    assert main(["replay", "last", "--verify", "--json"]) == 0
    assert json.loads(capfd.readouterr().out)["steps"] == 30
    wrong = "task.robot.attach.gripper.to=wrist_3_lnk"
    assert main(["validate", "task=mine", "--config-dir", folder, wrong]) == 2
    error = capfd.readouterr().err
    assert "command line: task.robot.attach.gripper.to: no link is called 'wrist_3_lnk'" in error
    assert "Did you mean 'wrist_3_link'?" in error
