"""`convert` and `run --gym-config`; the smallest config also in processes of their own."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from subprocess import CompletedProcess

import pytest
import yaml

from embodichain.cli import main
from embodichain.lab.gym.utils.registration import REGISTERED_ENVS

pytestmark = pytest.mark.slow

CONFIGS = Path(__file__).parents[2] / "helpers" / "gym_configs"
Run = Callable[..., CompletedProcess[str]]
REPORT = """\
left out, or read otherwise (2):
  gym.yaml:6: rigid_object.0.attrs.restitution: MuJoCo has no restitution coefficient
  gym.yaml:8: sensor.0: contacts are declared under sensors: {NAME: {sensor_type: contact, ...}}
"""
SMALL = """\
id: EmbodiedEnv-v1
rigid_object:
  - uid: ball
    shape: {shape_type: Sphere, radius: 0.1}
    attrs:
      restitution: 0.5
sensor:
  - {sensor_type: ContactSensor, uid: touch}
env: {sim_steps_per_control: 2}
"""
TASK = """\
# Converted from gym.yaml by `embodichain convert`.
# Left out, or read otherwise:
#   rigid_object.0.attrs.restitution: MuJoCo has no restitution coefficient
#   sensor.0: contacts are declared under sensors: {NAME: {sensor_type: contact, ...}}
description: A task, converted from EmbodiChain's own form.
sim_steps_per_control: 2
objects:
  ball:
    shape: {shape_type: Sphere, radius: 0.1}
    attrs: {linear_damping: 0.7, angular_damping: 0.7}
"""


@pytest.mark.parametrize("name", ["push.yaml", "cart_pole.json", "everything.yaml"])
def test_convert_validate_run(
    name: str, embodichain: Run, capsys: pytest.CaptureFixture[str]
) -> None:
    source = Path(shutil.copy(CONFIGS / name, "."))
    shutil.copy(CONFIGS / "a_hand.urdf", ".")
    before = source.read_bytes()

    def call(*arguments: str) -> tuple[str, str]:
        if name == "cart_pole.json":
            done = embodichain(*arguments)
            assert done.returncode == 0, done.stderr
            return done.stdout, done.stderr
        assert main(list(arguments)) == 0
        said = capsys.readouterr()
        return said.out, said.err

    assert "still wrong" not in call("convert", name, "-o", "conf/task/mine.yaml")[1]
    assert main(["validate", "conf/task/mine.yaml"]) == 0
    assert capsys.readouterr().out == "conf/task/mine.yaml: ok\n"
    values = ("num_envs=2", "max_steps=5", "seed=1", "record=none", "--json")
    out, err = call("run", "--gym-config", name, *values)
    assert main(["run", "task=mine", *values]) == 0
    first, second = json.loads(out), json.loads(capsys.readouterr().out)
    assert (first["control_steps"], first["diverged"]) == (5, 0)
    for key in ("control_steps", "return", "terminated", "diverged", "rewards"):
        assert first[key] == second[key]
    assert source.read_bytes() == before
    folder = Path(first["folder"])
    assert yaml.safe_load((folder / "config.yaml").read_text())["gym_config"] == name
    assert (folder / "run.log").read_text().count("WARNING") >= err.count("warning: ") > 0


@pytest.fixture
def gym() -> Path:
    path = Path("gym.yaml")
    path.write_text(SMALL)
    return path


def test_report_and_task_file(gym: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["convert", "gym.yaml"]) == 0
    out, err = capsys.readouterr()
    assert (out, err) == (TASK, REPORT)
    assert main(["convert", "gym.yaml", "-o", "new/dir/ball.yaml"]) == 0
    out, err = capsys.readouterr()
    assert (out, err) == ("new/dir/ball.yaml: gym, from gym.yaml\n", REPORT)
    assert Path("new/dir/ball.yaml").read_text() == TASK
    assert [p.name for p in Path("new/dir").iterdir()] == ["ball.yaml"]
    assert gym.read_text() == SMALL


def test_nothing_is_replaced(gym: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path("mine.yaml").write_text("mine")
    Path("gone.yaml").symlink_to("nowhere.yaml")
    for name in ("mine.yaml", "gone.yaml", "gym.yaml"):
        assert main(["convert", "gym.yaml", "-o", name]) == 2
        assert capsys.readouterr().err == f"error: {name} exists; it is never replaced\n"
    assert Path("mine.yaml").read_text() == "mine"
    assert gym.read_text() == SMALL
    assert len(list(Path().iterdir())) == 3


def test_unknown_keys_are_mistakes_and_nothing_is_written(
    gym: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    gym.write_text(SMALL.replace("restitution", "restitutoin"))
    assert main(["convert", "gym.yaml", "-o", "out.yaml"]) == 2
    mistake = "gym.yaml:6: rigid_object.0.attrs.restitutoin: unknown key;"
    err = capsys.readouterr().err
    assert mistake in err
    assert err.endswith("Did you mean 'restitution'?\n")
    assert main(["run", "--gym-config", "gym.yaml"]) == 2
    assert mistake in capsys.readouterr().err
    assert [p.name for p in Path().iterdir()] == ["gym.yaml"]


COMPOSED = """\
id: StackBlocksTwo-v1
physics: default
environment: {component: environment.yaml}
embodiment:
  component: robot.yaml
scene: {component: scene.yaml}
"""
EMPTY = "id: PushCubeRL\nrobot: null\nenv: {rewards: {win: {func: success_reward}}}\n"


@pytest.mark.parametrize(
    ("text", "mistakes"),
    [
        (COMPOSED, ["3: environment: ", "4: embodiment: ", "6: scene: "]),
        (EMPTY, ["nothing is left to simulate"]),
    ],
    ids=["composition", "no entity"],
)
@pytest.mark.parametrize("ending", ["yaml", "json"])
def test_what_would_run_an_empty_world_is_refused_by_every_verb(
    text: str,
    mistakes: list[str],
    ending: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delitem(REGISTERED_ENVS, "PushCubeRL", raising=False)  # no class builds the scene
    name = f"task.{ending}"
    content = text if ending == "yaml" else json.dumps(yaml.safe_load(text), indent=0)
    Path(name).write_text(content)
    told = []
    for line in (
        ["convert", name, "-o", "out.yaml"],
        ["validate", name],
        ["run", "--gym-config", name, "max_steps=2"],
    ):
        assert main(line) == 2
        lines = capsys.readouterr().err.splitlines()
        told.append("\n".join(line for line in lines if not line.startswith("note: ")))
    assert told[0] == told[1] == told[2]
    if ending == "yaml":
        assert all(mistake in told[0] for mistake in mistakes)
    assert [p.name for p in Path().iterdir()] == [name]


def test_what_is_still_wrong_is_said_with_the_task(
    gym: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    gym.write_text(SMALL.replace("radius: 0.1", "radius: wide"))
    assert main(["convert", "gym.yaml", "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["task"]["objects"]["ball"]["shape"]["radius"] == "wide"
    assert [(m["source"], m["path"]) for m in data["mistakes"]] == [
        ("gym.yaml:4", "task.objects.ball.shape.radius")
    ]
    assert [n["path"] for n in data["notes"]] == ["rigid_object.0.attrs.restitution", "sensor.0"]


def test_validate_reads_it_where_it_lies(gym: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["validate", "gym.yaml"]) == 0
    out, err = capsys.readouterr()
    assert out == "gym.yaml: ok\n"
    notes = [line for line in err.splitlines() if "ball is 10 cm below the ground" not in line]
    assert notes == [f"note: {line.strip()}" for line in REPORT.splitlines()[1:]]
    assert len(notes) == len(err.splitlines()) - 1
    assert main(["validate", "gym_config=gym.yaml", "task.max_episode_steps=0"]) == 2
    assert "command line: task.max_episode_steps" in capsys.readouterr().err


def test_sweep_over_a_gym_config(gym: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["run", "-m", "--gym-config", "gym.yaml", "seed=0,1", "max_steps=2", "record=none"]
    arguments += ["hydra/launcher=basic", "--json", "--quiet"]
    assert main(arguments) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [(s["task"], s["seed"], s["control_steps"]) for s in lines] == [
        ("gym", 0, 2),
        ("gym", 1, 2),
    ]


def test_hydras_printing_is_refused(gym: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "--gym-config", "gym.yaml", "--cfg", "job"]) == 2
    assert "embodichain convert prints a gym config" in capsys.readouterr().err
