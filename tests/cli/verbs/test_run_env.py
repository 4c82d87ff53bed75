"""`run-env`, EmbodiChain's command: its flags become keys of `run --gym-config`."""

import json
from pathlib import Path

import pytest
import yaml

from embodichain.cli import main

CONFIGS = Path(__file__).parents[2] / "helpers" / "gym_configs"
SHORT = ["max_steps=3", "--json"]


@pytest.fixture
def gym(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder to run in, with a gym config that has a light and an event which changes it."""
    data = yaml.safe_load((CONFIGS / "push.yaml").read_text(encoding="utf-8"))
    data["light"] = {"direct": [{"uid": "lamp", "light_type": "point", "init_pos": [0, 0, 2]}]}
    data["env"]["events"]["lamp"] = {
        "func": "randomize_light",
        "mode": "reset",
        "params": {"entity_cfg": {"uid": "lamp"}, "intensity_range": [10, 30]},
    }
    (tmp_path / "gym.yaml").write_text(yaml.safe_dump(data), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def _resolved(folder: Path) -> dict:
    return yaml.safe_load((folder / "outputs" / "latest" / "config.yaml").read_text())


def test_upstreams_flags_are_keys_of_a_run(gym: Path, capsys: pytest.CaptureFixture[str]) -> None:
    flags = "--num_envs 3 --device cpu --headless --max_episodes 1 --seed 5 --renderer rt"
    rest = ["--gpu_id", "0", "--filter_dataset_saving", "--filter_visual_rand"]
    assert main(["run-env", "--gym_config", "gym.yaml", *flags.split(), *rest, *SHORT]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["status"] == "max_steps"
    for flag in ("renderer", "gpu_id", "filter_dataset_saving"):
        assert err.count(f"note: --{flag} has no effect: ") == 1
    config = _resolved(gym)
    assert (config["num_envs"], config["episodes"], config["seed"]) == (3, 1, 5)
    assert sorted(config["task"]["events"]) == ["cube", "goal"], "the light's is visual"


def test_it_is_run_with_a_gym_config(gym: Path, capsys: pytest.CaptureFixture[str]) -> None:
    keys = ["task.max_episode_steps=7", "record=none"]
    assert main(["run-env", "--gym-config=gym.yaml", *keys, *SHORT]) == 0
    config = _resolved(gym)
    assert config["num_envs"] == 4, "the file's: nothing was typed"
    assert config["task"]["max_episode_steps"] == 7 and "lamp" in config["task"]["events"]
    capsys.readouterr()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "no gym config is named: embodichain run-env --gym_config FILE"),
        (["--gym_config", "none.json"], "no such file: none.json"),
        (
            ["--gym_config", "gym.yaml", "--num_evs", "2"],
            "Did you mean one of: '--num-envs', '--num_envs'?",
        ),
        (["--gym_config", "gym.yaml", "--device", "cuda"], "no CUDA device"),
        (["--gym_config", "gym.yaml", "task.max_episode_steps=0"], "max_episode_steps"),
    ],
)
def test_mistakes_are_wrong_input(
    gym: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], said: str
) -> None:
    assert main(["run-env", *arguments]) == 2
    assert said in capsys.readouterr().err
    assert not (gym / "outputs").exists()
