"""Mistakes with grippers and their objects: one report with file and line of each, exit code 2."""

from pathlib import Path

import pytest

import embodichain
from embodichain.cli import main

CONF = Path(embodichain.__file__).parent / "conf"
TASK = (CONF / "task" / "pick_place.yaml").read_text().replace(": ur10_gripper", ": hand")
HAND = (CONF / "embodiment" / "ur10_gripper.yaml").read_text()
GRIPPER = "gripper: {fpath: ParallelGripper/parallel_gripper.xml, to: ee_link}"
CUBE = "shape_type: Cube\n      size: [0.05, 0.05, 0.05]"
MESHED = """<mujoco>
  <asset>
    <mesh name="finger" file="meshes/fnger.stl"/>
  </asset>
  <worldbody><body name="palm"><geom type="mesh" mesh="finger"/></body></worldbody>
</mujoco>
"""
CASES = {
    "no gripper": (
        f"  attach:\n    {GRIPPER}\n",
        "",
        "hand.yaml:26: task.robot.solver_cfg.arm.end_link_name: no link is called "
        "'gripper/tcp'; there are: "
        "base_link, shoulder_link",
        "Nothing is attached as 'gripper'.",
    ),
    "a link that is not there": (
        "to: ee_link}",
        "to: ee_lnk}",
        "hand.yaml:26: task.robot.attach.gripper.to: no link is called 'ee_lnk'; there are: "
        "base_link",
        "Did you mean 'ee_link'?",
    ),
    "a gripper's mesh that is missing": (
        "ParallelGripper/parallel_gripper.xml",
        "meshed.xml",
        "hand.yaml:26: task.robot.attach.gripper.fpath: {cwd}/meshed.xml:3: mesh 'finger': no file "
        "'fnger.stl' in {cwd}/meshes; there are: finger.stl, palm.stl.",
        "Did you mean 'finger.stl'?",
    ),
    "two of one name": (
        GRIPPER,
        f"{GRIPPER}\n    {GRIPPER}",
        "hand.yaml:27: malformed YAML: found duplicate key gripper",
        "",
    ),
    "an unknown tool": (
        "end_link_name: gripper/tcp",
        "end_link_name: gripper/tpc",
        "hand.yaml:28: task.robot.solver_cfg.arm.end_link_name: no link is called 'gripper/tpc'",
        "Did you mean 'gripper/tcp'?",
    ),
    "an unknown finger": (
        "right_finger]}\n    against",
        "rite_finger]}\n    against",
        "mine.yaml:39: task.sensors.fingers.of.link_names: no link of 'robot' matches "
        "'rite_finger'",
        "Did you mean 'right_finger'?",
    ),
    "an unknown actuator": (
        "actuators: gripper/grip}",
        "actuators: gripper/grp}",
        "hand.yaml:19: task.robot.grippers.gripper.actuators: no actuator matches 'gripper/grp'; "
        "there are: gripper/grip, Joint1",
        "Did you mean 'gripper/grip'?",
    ),
    "joints that a tendon moves": (
        ", actuators: gripper/grip}",
        "}",
        "mine.yaml:49: task.actions.gripper.params.of: joints ['gripper/left'] have no drive",
        "Its file's actuators move them: gripper/grip",
    ),
    "a mesh that is missing": (
        CUBE,
        "shape_type: Mesh\n      fpath: mug.obj",
        "mine.yaml:24: task.objects.cube.shape.fpath: no file or folder for 'mug.obj'. Searched",
        "",
    ),
}


def write(name: str, task: str, hand: str, folder: Path) -> None:
    """Write a task and its embodiment `hand` into ``conf`` of a folder."""
    for group, option, text in (("task", name, task), ("embodiment", "hand", hand)):
        path = folder / "conf" / group / f"{option}.yaml"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)


@pytest.mark.parametrize("name", CASES)
def test_a_report_of_a_mistake(tmp_path, monkeypatch, capsys, name):
    old, new, *told = CASES[name]
    assert (old in TASK) != (old in HAND)
    write("mine", TASK.replace(old, new, 1), HAND.replace(old, new, 1), tmp_path)
    (tmp_path / "meshed.xml").write_text(MESHED)
    (tmp_path / "meshes").mkdir()
    for file in ("finger.stl", "palm.stl"):
        (tmp_path / "meshes" / file).write_text("")
    monkeypatch.chdir(tmp_path)
    assert main(["validate", "task=mine"]) == 2
    report = " ".join(capsys.readouterr().err.split())
    assert told[0].format(cwd=tmp_path) in report
    assert told[1] in report


def test_a_tool_that_is_too_heavy_is_a_warning(tmp_path, monkeypatch, capsys):
    heavy = "attachments: {weight: {link: ee_link, mass: 60, shape: {shape_type: Sphere}}}"
    write("mine", TASK, HAND.replace("  gravcomp: 1\n", f"  {heavy}\n"), tmp_path)
    monkeypatch.chdir(tmp_path)
    assert main(["validate", "task=mine"]) == 0
    told = capsys.readouterr()
    assert "its weight at the initial position is more than drives bear (Joint2 " in told.err
    write("mine", TASK, HAND.replace("gravcomp: 1", f"{heavy}\n  gravcomp: 1"), tmp_path)
    assert main(["validate", "task=mine"]) == 0
    assert "more than drives bear" not in capsys.readouterr().err
