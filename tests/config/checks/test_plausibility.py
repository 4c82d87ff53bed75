"""Values in a wrong unit are named by `validate`, and what cannot work is refused."""

from pathlib import Path

import pytest

from embodichain.cli import main
from embodichain.config import list_options, resolve
from tests.config.conftest import GOOD

PLACED = """\
  place:
    func: randomize_pose
    mode: reset
    params: {of: {uid: box}, position_range: [[-0.1, -0.1, 0], [0.1, 0.1, 0]]}
"""
WRONG_UNITS = {
    "physics.physics_dt=2": "2 s is a long physics step",
    "physics.physics_dt=0.06": "0.06 s is a long physics step",
    "objects.box.shape.size=[100,100,100]": "100 m is very large",
    "objects.box.shape.size=[0.1,0.1,0.00001]": "1e-05 m is very small",
    "objects.ball.shape.radius=20": "20 m is very large",
    "objects.box.init_pos=[500,0,50]": "500 m is far away",
    "objects.box.init_rot=[0,0,1.57]": "1.57 degrees? init_rot is in degrees: 1.57 rad are 90",
    "robot.init_rot=[3.14159,0,-0.785]": "init_rot is in degrees: 3.14159 rad are 180",
    "actions.arm.params.scale=35": "35 degrees are 0.6109 rad",
    "+events.bend={func: reset_joints, mode: reset, params: {of: {uid: arm}, "
    "position_range: [-15, 15]}}": "15 rad is more than a turn",
    "events.place.params.position_range=[[-110,-110,0],[110,110,0]]": "110 m is far away",
}


def write_task() -> None:
    folder = Path("conf/task")
    folder.mkdir(parents=True)
    (folder / "mine.yaml").write_text(GOOD.replace("rewards:", f"{PLACED}rewards:", 1))


def doubts(*lines: str) -> list[str]:
    """What is said of values that look wrong."""
    notes = resolve(
        [
            "task=mine",
            *(f"+task.{line[1:]}" if line[0] == "+" else f"++task.{line}" for line in lines),
        ]
    ).notes
    texts = [f"{note.path}: {note.message}" for note in notes]
    return [text for text in texts if text.startswith("task.")]


@pytest.mark.parametrize("line", WRONG_UNITS)
def test_a_value_in_a_wrong_unit(empty_cwd: Path, line: str) -> None:
    write_task()
    (said,) = doubts(line)
    assert WRONG_UNITS[line] in said


def test_what_is_usual_is_not_doubted(empty_cwd: Path) -> None:
    write_task()
    assert doubts() == []
    assert doubts("objects.box.init_rot=[1,90,0.5]", "actions.arm.params.scale=6.28") == []
    assert doubts("physics.physics_dt=0.05", "objects.box.shape.size=[10,10,0.0001]") == []
    building = ["objects.box.body_type=static", "objects.box.shape.size=[40,40,1]"]
    assert doubts(*building) == []


def test_every_shipped_task_is_plausible() -> None:
    for task in list_options("task"):
        assert [str(note) for note in resolve([f"task={task}"]).notes] == []


def test_what_diverges_everywhere_is_refused(
    empty_cwd: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_task()
    assert main(["validate", "task=mine", "task.physics.physics_dt=2"]) == 2
    err = capsys.readouterr().err
    assert "task.physics.physics_dt: the physics diverges in all 2 environments" in err


@pytest.mark.parametrize(
    ("height", "note"), [(0.0, "box is 5 cm below the ground"), (0.045, ""), (0.5, "")]
)
def test_what_begins_in_the_ground_is_named(
    empty_cwd: Path, capsys: pytest.CaptureFixture[str], height: float, note: str
) -> None:
    write_task()
    box = f"task.objects.box.init_pos=[0.3,0,{height}]"
    assert main(["validate", "task=mine", box, "task.objects.box.shape.size=[0.1,0.1,0.1]"]) == 0
    err = capsys.readouterr().err
    assert ("below the ground" in err) == bool(note)
    assert note in err


def test_what_a_reset_lifts_out_of_the_ground_is_not_named(
    empty_cwd: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_task()
    lifted = "task.events.place.params.position_range=[[0,0,0.2],[0,0,0.3]]"
    words = ["task.objects.box.init_pos=[0.3,0,0]", lifted]
    assert main(["validate", "task=mine", *words]) == 0
    assert "below the ground" not in capsys.readouterr().err


def test_a_success_that_is_always_true_is_named(
    empty_cwd: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_task()
    words = ["validate", "task=mine", "task.metrics.success.params.threshold=50"]
    assert main(words) == 0
    err = capsys.readouterr().err
    assert "task.metrics.success: true in the first step of all 16 episodes" in err
    assert main([*words, "task.metrics.success.reduce=all"]) == 0
    assert "task.metrics.success" not in capsys.readouterr().err
    assert main(["validate", "task=mine"]) == 0
    assert "task.metrics.success" not in capsys.readouterr().err


BAD_TERM = """\
import torch


def energy(env, obs, action, info):
    return torch.full((env.num_envs,), float("nan"))
"""


def test_a_reward_that_is_always_nan(empty_cwd: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_task()
    Path("my_terms_of_nan.py").write_text(BAD_TERM)
    reward = "+task.rewards.energy={func: 'my_terms_of_nan:energy'}"
    assert main(["validate", "task=mine", reward]) == 2
    assert "task.rewards.energy: not finite in all 2 environments" in capsys.readouterr().err
    lines = ["task=mine", reward, "episodes=1", "max_steps=3", "record=none", "scene_png=false"]
    assert main(["run", *lines]) == 0
    out, err = capsys.readouterr()
    assert "not finite: rewards.energy" in out
    assert err.count("task.rewards.energy is NaN") == 1
