"""`plugins/lerobot_env_embodichain`: how LeRobot finds it, and an evaluation by LeRobot itself."""

import ast
import json
import os
import subprocess
import tomllib
from pathlib import Path

import imageio_ffmpeg
import pytest

from embodichain.cli import main

pytestmark = pytest.mark.slow

PLUGIN = Path(__file__).parents[2] / "plugins/lerobot_env_embodichain"
SMALL = {
    "policy.type": "act",
    "policy.device": "cpu",
    "policy.push_to_hub": "false",
    "policy.use_vae": "false",
    "policy.chunk_size": "4",
    "policy.n_action_steps": "4",
    "policy.dim_model": "32",
    "policy.n_heads": "2",
    "policy.dim_feedforward": "32",
    "policy.n_encoder_layers": "1",
    "batch_size": "8",
    "steps": "6",
    "save_freq": "6",
    "num_workers": "0",
    "eval.n_episodes": "3",
    "eval.batch_size": "2",
}


def test_its_name_is_one_that_lerobot_imports():
    """LeRobot imports the module with the name of each distribution that begins so."""
    project = tomllib.loads((PLUGIN / "pyproject.toml").read_text())["project"]
    assert project["name"].startswith("lerobot_env_")
    module = ast.parse((PLUGIN / project["name"] / "__init__.py").read_text())
    assert "EmbodiChainEnv" in ast.dump(module) and "install" in ast.dump(module)
    ours = tomllib.loads((PLUGIN.parents[1] / "pyproject.toml").read_text())["project"]
    torch = next(line for line in ours["dependencies"] if line.startswith("torch"))
    assert torch == "torch>=2.10,<3"  # LeRobot 0.4.4 wants one before 2.11


@pytest.mark.skipif(
    "LEROBOT_PYTHON" not in os.environ,
    reason="LEROBOT_PYTHON names no interpreter with LeRobot: `make lerobot` makes one (8 GB) and "
    "runs this",
)
def test_demonstrations_train_a_policy_that_lerobot_evaluates(tmp_path):
    task = "press_button"
    collect = ["collect", f"task={task}", "episodes=4", "num_envs=4", "seed=1", "-q"]
    assert main([*collect, f"output_dir={tmp_path}/out"]) == 0
    folder = next((tmp_path / "out").glob(f"*/*{task}*"))
    export = ["export", str(folder), "--format", "lerobot", "--observations"]
    assert main([*export, "-o", str(tmp_path / "set")]) == 0

    def lerobot(program: str, **flags: str) -> str:
        place = Path(os.environ["LEROBOT_PYTHON"]).parent / f"lerobot-{program}"
        environment = {
            "env.discover_packages_path": "lerobot_env_embodichain",
            "env.type": "embodichain",
            "env.task": task,
            "env.overrides": "[task.max_episode_steps=12]",
        }
        settings = environment | {k.replace("__", "."): v for k, v in flags.items()}
        done = subprocess.run(
            [place, *(f"--{key}={value}" for key, value in settings.items())],
            env=os.environ
            | {"HF_HUB_OFFLINE": "1", "HF_HOME": str(tmp_path), "OMP_NUM_THREADS": "1"},
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr[-3000:]
        return done.stdout + done.stderr

    # An evaluation within the training, then one of its checkpoint.
    data = {"dataset.repo_id": "local/set", "dataset.root": "set"}
    lerobot("train", **SMALL, **data, **{"eval_freq": "6", "output_dir": "trained"})
    policy = "trained/checkpoints/last/pretrained_model"
    ends = {key: value for key, value in SMALL.items() if key.startswith("eval.")}
    flags = {"policy.path": policy, "policy.device": "cpu", "output_dir": "evaluated"}
    lerobot("eval", **ends, **flags)
    found = json.loads((tmp_path / "evaluated/eval_info.json").read_text())
    assert found["overall"]["n_episodes"] == 3
    assert found["overall"]["pc_success"] in (0.0, 100 / 3, 200 / 3, 100.0)
    assert found["overall"]["avg_sum_reward"] != 0
    films = sorted((tmp_path / "evaluated/videos").glob("*/*.mp4"))
    assert len(films) >= 3 and sorted((tmp_path / "trained/eval").rglob("*.mp4"))
    about, *pictures = imageio_ffmpeg.read_frames(str(films[0]))
    assert about["size"] == (640, 480) and len(pictures) == 12
