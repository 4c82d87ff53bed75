"""Verbs that build an environment, called in this process: torch is imported once for them all."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from embodichain.cli import main

pytestmark = pytest.mark.slow


def told(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, object]:
    assert main([*arguments, "--json"]) == 0, capsys.readouterr().err
    data: dict[str, object] = json.loads(capsys.readouterr().out)
    return data


def test_show_tells_what_is_built(capsys: pytest.CaptureFixture[str]) -> None:
    data = told(capsys, "show", "task=reach", "num_envs=5", "task.rewards.near.weight=2")
    assert data["task"] == "reach"
    assert data["config"]["task"]["rewards"]["near"]["weight"] == 2
    assert data["timing"]["environments"] == 5
    assert data["timing"]["control step"] == "0.02 s (4 physics steps)"
    bodies = {row["body"]: row for row in data["bodies"]}
    assert bodies["robot/shoulder_link"]["parent"] == "robot/base_link"
    assert bodies["goal"]["moved by"] == "code (mocap)"
    joints = {row["joint"]: row for row in data["joints"]}
    assert joints["robot/Joint3"]["range"] == pytest.approx([-3.14159, 3.14159], abs=1e-4)
    actuators = {row["actuator"]: row for row in data["actuators"]}
    assert actuators["robot/Joint1"]["stiffness"] == 500
    assert actuators["robot/Joint1"]["force range"] == [-330, 330]
    assert [row["camera"] for row in data["cameras"]] == ["default"]
    spaces = {row["space"]: row for row in data["spaces"]}
    assert (spaces["action"]["shape"], spaces["action"]["low"]) == ("(6,)", -1.0)
    assert spaces["observation/to_goal"]["shape"] == "(3,)"
    start = {row["joint"]: row for row in data["initial qpos"]}
    assert start["Joint6"]["qpos"] == pytest.approx(-3.14159)
    assert start["Joint3"]["upper"] == pytest.approx(3.14159, abs=1e-4)
    poses = {row["entity"]: row for row in data["initial poses"]}
    assert poses["robot"]["position m"] == [0, 0, 1]
    assert poses["goal"]["quaternion wxyz"] == [1, 0, 0, 0]
    terms = {row["term"]: row for row in data["observations"]}
    assert (terms["to_goal"]["shape"], terms["qvel"]["scale"]) == ("(3,)", 0.1)
    assert data["actions"][0]["shape"] == "(6,)"
    assert data["actions"][0]["params"] == (
        "{of: {uid: robot, control_parts: arm}, centre: home, scale: 0.6, clip: [-1, 1]}"
    )
    first, second = data["action vector"][:2]
    assert (first["joint"], second["joint"]) == ("arm/Joint1", "arm/Joint2")
    assert (first["scale"], first["clip"]) == (0.6, [-1.0, 1.0])
    assert first["centre"] == start["Joint1"]["qpos"]  # centre: home
    assert second["centre"] == start["Joint2"]["qpos"]
    assert [row["term"] for row in data["rewards"]] == ["distance", "near"]
    columns = data["observation vector"]
    assert [row["columns"] for row in columns] == [str(i) for i in range(21)]
    terms = ["qpos"] * 6 + ["qvel"] * 6 + ["to_goal"] * 3 + ["action"] * 6
    assert [row["term"] for row in columns] == terms
    assert [row["scale"] for row in columns] == [1.0] * 6 + [0.1] * 6 + [1.0] * 9
    links = [row["link or joint"] for row in columns]
    assert (links[0], links[11], links[12], links[15]) == (
        "Joint1",
        "Joint6",
        "ee_link to goal",
        "arm/Joint1",
    )


def test_tables_of_terms_fit_80_columns(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert main(["new", "task", "mine"]) == 0
    assert main(["show", "task=mine"]) == 0
    text = capsys.readouterr().out.partition("\nspaces\n")[2]
    assert [line for line in text.splitlines() if len(line) > 80] == []
    rewards = text.partition("\nrewards\n")[2].partition("\nterminations")[0].splitlines()
    assert rewards[1].split() == ["term", "func", "weight", "params"]  # `mode` is the default's
    words = " ".join(rewards).split()
    for word in ("distance_between_objects", "within_distance", "to:", "0.05}"):
        assert word in words


def test_show_tells_sensors_commands_and_curriculum(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    change = "{func: modify_reward_weight, params: {term_name: rate, weight: -1, num_steps: 9}}"
    words = ("task=quadruped_velocity", f"+task.curriculum.later={change}")
    data = told(capsys, "show", *words)
    (command,) = data["commands"]
    assert (command["term"], command["shape"]) == ("velocity", "(3,)")
    assert command["columns"] == ["lin_vel_x", "lin_vel_y", "ang_vel_z"]
    assert [row["func"] for row in data["curriculum"]] == ["modify_reward_weight"]
    sensors = {row["sensor"]: row for row in data["sensors"]}
    assert (sensors["feet"]["type"], sensors["feet"]["params"]) == (
        "contact",
        "{of: {uid: robot, link_names: [feet]}}",
    )
    assert sensors["feet"]["reads"] == "found, force"
    noise = {row["term"]: row.get("noise") for row in data["observations"]}
    assert noise["gravity"] == "{type: uniform, operation: add, low: -0.05, high: 0.05}"
    assert noise["action"] is None
    monkeypatch.setenv("COLUMNS", "60")
    assert main(["show", *words]) == 0
    text = capsys.readouterr().out.partition("\nspaces\n")[2]
    assert [line for line in text.splitlines() if len(line) > 60] == []
    assert "{type:" in text.split()


def test_show_prints_tables_and_the_config_alone(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["show", "task=push_cube"]) == 0
    text = capsys.readouterr().out
    titles = re.findall(r"^[a-z][a-z -]+$", text.replace(": none", ""), re.MULTILINE)
    assert titles[:6] == [
        "timing",
        "spaces",
        "action vector",
        "observation vector",
        "rewards",
        "terminations",
    ]
    for title in ("bodies", "joints", "actuators", "actions", "cameras", "initial poses"):
        assert titles.index(title) > titles.index("terminations"), title
    assert not re.search(r" $", text, re.MULTILINE)
    first_lines = text.splitlines()[:2]
    assert first_lines[0] == "task: push_cube"
    assert first_lines[1].startswith("description: ")
    assert "num_envs: " not in text  # the config is what --config prints
    assert "same command with --config" in text.splitlines()[-1]
    assert re.search(r"^without: .*\bcommands\b", text, re.MULTILINE)
    assert re.search(r"^ policy +\d+ to \d+ ", text, re.MULTILINE)  # columns of one link
    assert main(["show", "task=push_cube", "--config", "seed=7"]) == 0
    assert yaml.safe_load(capsys.readouterr().out)["seed"] == 7


@pytest.mark.parametrize("task", ["random_reach", "push_cube"])
def test_bench_measures_both_arms(task: str, capsys: pytest.CaptureFixture[str]) -> None:
    data = told(capsys, "bench", f"task={task}", "num_envs=1,3", "--rounds", "2")
    assert (data["task"], data["rounds"]) == (task, 2)
    assert [row["num_envs"] for row in data["results"]] == [1, 3]
    for row in data["results"]:
        assert 0 < row["slowest"] <= row["steps_per_s"] <= row["fastest"]
        assert row["bare_steps_per_s"] > 0
        assert row["ratio"] > 0
    assert list(Path().iterdir()) == []  # measuring leaves no run behind


def test_doctor_looks_at_everything(capsys: pytest.CaptureFixture[str]) -> None:
    checks = {check["part"]: check for check in told(capsys, "doctor")["checks"]}
    assert {"mujoco", "torch", "threads", "rendering", "display", "disk", "CUDA"} <= set(checks)
    assert checks["mujoco"]["found"].startswith("4.")
    assert checks["disk"]["found"].endswith(str(Path("outputs").resolve()))


def test_without_a_driver_warp_says_nothing() -> None:
    """Warp's library writes a warning to the descriptor itself, which Python does not see."""
    pytest.importorskip("warp")
    code = (
        "from embodichain.lab.sim.engine.warp.warp_support import cuda_devices, why_missing\n"
        "print(cuda_devices(), why_missing('cuda'))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    if "[]" in done.stdout:
        assert "there is no CUDA device here" in done.stdout
    assert done.stderr == ""


def test_doctor_begins_with_what_does_not_work(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from importlib import metadata

    versions = metadata.version

    def without(*absent: str) -> None:
        def version(name: str) -> str:
            if name in absent:
                raise metadata.PackageNotFoundError(name)
            return versions(name)

        # An environment without the packages would have to be installed.
        monkeypatch.setattr(metadata, "version", version)

    def first_rows() -> list[list[str]]:
        return [line.split() for line in capsys.readouterr().out.splitlines()[4:6]]

    without("onnxruntime", "matplotlib", "pyarrow")
    assert main(["doctor"]) == 0
    out = capsys.readouterr().out
    assert out.startswith("this machine: ready\n")
    assert "missing" not in out and "pip install" not in out
    (absent,) = [line for line in out.splitlines() if line.startswith("optional, not installed:")]
    assert absent == "optional, not installed: plot, study, export, parquet, lerobot"
    assert main(["doctor", "--extras"]) == 0
    words = capsys.readouterr().out.split()
    assert "'embodichain[plot]'" in words
    assert {"pandas", "ros2", "frames"} <= set(words)  # what is installed has its purpose too

    without("mcap")
    monkeypatch.setenv("MUJOCO_GL", "disable")
    assert main(["doctor"]) == 1
    assert [row[:2] for row in first_rows()] == [["mcap", "failed"], ["rendering", "limited"]]


def test_doctor_warns_about_global_random_numbers(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    import torch

    from embodichain.lab.gym.utils import registration

    class Dicing:
        def step(self, action: object) -> torch.Tensor:
            return torch.rand(1)

    spec = registration.EnvSpec("Dicing-v0", Dicing)
    monkeypatch.setitem(registration.REGISTERED_ENVS, "Dicing-v0", spec)
    checks = told(capsys, "doctor")["checks"]
    found = [check for check in checks if check["part"] == "Dicing-v0"]
    assert [check["state"] for check in found] == ["warn"]
    assert "torch.rand (line" in found[0]["found"]
    assert "env.rand" in found[0]["advice"]


def test_train_writes_a_policy_that_run_plays(capsys: pytest.CaptureFixture[str]) -> None:
    small = ("num_envs=4", "total_timesteps=64", "algo.n_steps=8", "algo.batch_size=16")
    trained = told(capsys, "train", "task=reach", *small, "seed=1", "eval.episodes=0")
    assert (trained["status"], trained["env_steps"], trained["seed"]) == ("finished", 64, 1)
    folder = Path(str(trained["folder"]))
    assert (folder / str(trained["checkpoint"])).is_file()
    short = ("num_envs=2", "task.max_episode_steps=5", "allow_changed=true", "record=none")
    played = told(capsys, "run", "task=reach", "policy=last", *short)
    assert played["status"] == "finished"
    assert played["success_rate"] is not None
    config = yaml.safe_load((Path(str(played["folder"])) / "config.yaml").read_text())
    assert config["policy"] == str(folder.resolve())  # not `last`, which may be another by then
    again = told(capsys, "run", "task=reach", "policy=last", *short)
    assert again["policy"] == str(folder.resolve())  # not the run in between
    assert main(["run", "task=push_cube", f"policy={folder}", "num_envs=1"]) == 2
    assert "this task has" in capsys.readouterr().err
    assert list(Path("outputs").rglob("*.mcap")) == []  # it was seen before the log began


def test_max_steps_ends_a_run(capsys: pytest.CaptureFixture[str]) -> None:
    data = told(capsys, "run", "task=push_cube", "num_envs=3", "max_steps=4", "record=none")
    assert (data["status"], data["control_steps"], data["episodes"]) == ("max_steps", 4, 0)
    assert data["return"] is None


def test_without_opengl_a_run_only_warns(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    import mujoco.egl

    def missing(*args: object, **kwargs: object) -> None:
        raise ImportError("libEGL.so.1: cannot open shared object file")

    # libEGL is installed here.
    monkeypatch.setattr(mujoco.egl, "GLContext", missing)
    short = ("num_envs=1", "max_steps=2", "record=none", "--json")
    assert main(["run", "task=random_reach", *short]) == 0
    out, err = capsys.readouterr()
    assert err.startswith("warning: no scene.png: ")
    assert "apt-get install libegl1" in err
    assert not (Path(json.loads(out)["folder"]) / "scene.png").exists()


def test_without_a_display_the_viewer_only_warns(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    short = ("num_envs=1", "max_steps=2", "record=none", "--json")
    assert main(["run", "task=random_reach", "viewer=native", *short]) == 0
    assert "warning: " in (err := capsys.readouterr().err)
    assert "no display" in err


_TWO = """
robot: {uid: ur10, fpath: UniversalRobots/UR10/UR10.urdf, init_pos: [0, 0, 1]}
sensors:
  touch: {sensor_type: contact, entity_cfg: {uid: ur10, link_names: [ee_link, forearm_link]}}
actions:
  swapped:
    func: joint_action
    params: {of: {uid: ur10, joint_names: [Joint2, Joint1]}, scale: [0.3, 0.1], offset: [0.0, 0.5],
             clip: [[-1, 1], [-2, 2]]}
  relative:
    func: joint_action
    params: {of: {uid: ur10, joint_names: [Joint3]}, centre: target, scale: 0.2, offset: 0.1}
  limits: {func: joint_action, params: {of: {uid: ur10, joint_names: [Joint4]}, centre: limits}}
observations:
  q:
    func: joint_position
    history_length: 2
    scale: [2, 3]
    params: {of: {uid: ur10, joint_names: [Joint2, Joint1]}}
  touch: {func: contact_found, params: {sensor: touch}}
  force: {func: contact_force, params: {sensor: touch}}
"""


def test_show_tells_the_order_of_columns(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "conf" / "task").mkdir(parents=True)
    (tmp_path / "conf" / "task" / "two.yaml").write_text(f"description: Two.\n{_TWO}")
    monkeypatch.chdir(tmp_path)
    assert main(["show", "task=two", "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    limits = {row["joint"]: (row["lower"], row["upper"]) for row in data["initial qpos"]}
    low, high = limits["Joint4"]
    rows = [tuple(row.values())[1:] for row in data["action vector"]]
    assert rows[:3] == [
        ("swapped/Joint1", 0.5, 0.1, [-2.0, 2.0]),
        ("swapped/Joint2", 0.0, 0.3, [-1.0, 1.0]),
        ("relative/Joint3", "target + 0.1", 0.2, [-1.0, 1.0]),
    ]
    name, centre, scale, clip = rows[3]
    assert (name, clip) == ("limits/Joint4", [-1.0, 1.0])
    assert (centre, scale) == pytest.approx(((low + high) / 2, (high - low) / 2))
    columns = [
        (row["term"], row["link or joint"], row["scale"]) for row in data["observation vector"]
    ]
    assert columns == [
        ("q", "Joint1 (1 before)", 3.0),
        ("q", "Joint2 (1 before)", 2.0),
        ("q", "Joint1", 3.0),
        ("q", "Joint2", 2.0),
        ("touch", "forearm_link", 1.0),
        ("touch", "ee_link", 1.0),
        *[("force", "forearm_link", 1.0)] * 3,
        *[("force", "ee_link", 1.0)] * 3,
    ]


def test_show_tells_the_joints_of_a_task_without_action_terms(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "conf" / "task").mkdir(parents=True)
    text = "description: A robot.\nrobot: {uid: ur10, fpath: UniversalRobots/UR10/UR10.urdf}\n"
    (tmp_path / "conf" / "task" / "bare.yaml").write_text(text)
    monkeypatch.chdir(tmp_path)
    assert main(["show", "task=bare", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["action vector"]
    found = [(row["joint"], row["centre"], row["scale"]) for row in rows]
    assert found == [(f"Joint{i}", 0.0, 1.0) for i in range(1, 7)]
