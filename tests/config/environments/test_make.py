"""`embodichain.make`, and the classes that a task names."""

import subprocess
import sys
from pathlib import Path

import pytest
import torch

import embodichain
from embodichain.config import resolve
from embodichain.config.resolved import resolve_tree, thaw
from embodichain.lab.gym.envs.base_env import BaseEnv
from embodichain.lab.gym.utils.registration import register_env
from embodichain.utils.errors import ConfigError
from tests.config.conftest import WriteTask


def test_make(write_task: WriteTask) -> None:
    write_task()
    env = embodichain.make("mine", num_envs=3, overrides=["seed=5", "task.max_episode_steps=7"])
    try:
        assert (env.num_envs, env.seed_value, env.max_episode_steps) == (3, 5, 7)
        assert list(env.sim.robots) == ["arm"]
        obs, _ = env.reset()
        assert obs.batch_size == torch.Size([3])
    finally:
        env.close()


def test_make_takes_the_environments_own_arguments(write_task: WriteTask) -> None:
    write_task()
    env = embodichain.make("mine", autoreset_mode="Disabled")
    try:
        assert env.num_envs == 2  # suggested
        assert env.metadata["autoreset_mode"].value == "Disabled"
    finally:
        env.close()


def test_make_says_what_is_wrong() -> None:
    with pytest.raises(ConfigError, match="unknown option 'raech'.*Did you mean 'reach'"):
        embodichain.make("raech")
    with pytest.raises(TypeError, match=r"overrides: a list of strings, such as \['seed=1'\]"):
        embodichain.make("reach", 1, "seed=1")


def test_a_task_may_name_a_class(write_task: WriteTask) -> None:
    @register_env("ConfigTest-v0", override=True)
    class Mine(BaseEnv):
        """One of its own."""

    write_task("description: A small task.", "id: ConfigTest-v0")
    env = embodichain.make("mine")
    try:
        assert type(env) is Mine
        assert list(env.sim.rigid_objects) == ["ball", "box"]
    finally:
        env.close()


def test_a_task_cannot_be_made_of_itself(write_task: WriteTask) -> None:
    write_task("description: A small task.", "id: embodichain/reach-v0")
    with pytest.raises(ConfigError, match="no registered class 'embodichain/reach-v0'"):
        embodichain.make("mine")


def test_a_package_brings_classes(tmp_path: Path, write_task: WriteTask) -> None:
    site = tmp_path / "site"
    info = site / "theirs-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: theirs\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[embodichain.tasks]\ntheirs = their_tasks\n")
    (site / "their_tasks.py").write_text(
        "from embodichain.lab.gym.utils.registration import register_env\n"
        "register_env('Theirs-v0')(lambda cfg: cfg)\n"
    )
    write_task("description: A small task.", "id: Theirs-v0")
    code = (
        f"import sys; sys.path.insert(0, {str(site)!r})\n"
        "import embodichain\n"
        "print(embodichain.make('mine').id)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout == "Theirs-v0\n", done.stderr


def test_an_id_may_name_the_module_that_registers_it(
    write_task: WriteTask, monkeypatch: pytest.MonkeyPatch
) -> None:
    Path("modules").mkdir()
    Path("modules/mine_only.py").write_text(
        "from embodichain.lab.gym.utils.registration import register_env\n"
        "register_env('MineOnly-v0', override=True)(lambda cfg: cfg)\n"
    )
    monkeypatch.syspath_prepend("modules")
    tree = thaw(resolve(["task=reach"], "run").tree)
    tree["task"]["id"] = "mine_only:MineOnly-v0"
    with pytest.raises(ConfigError, match="'mine_only' would be imported, which is not done"):
        resolve_tree(tree, "a log")
    assert "mine_only" not in sys.modules
    small = "description: A small task."
    write_task(small, "id: mine_only:MineOnly-v0")
    assert embodichain.make("mine").id == "mine_only:MineOnly-v0"
    write_task(small, "id: mine_onl:MineOnly-v0")
    with pytest.raises(ConfigError, match="cannot import 'mine_onl'"):
        embodichain.make("mine")
    write_task(small, "id: mine_only:MineOnly-v1")
    with pytest.raises(ConfigError, match="Did you mean 'MineOnly-v0'"):
        embodichain.make("mine")
