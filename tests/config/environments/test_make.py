"""`embodichain.make`, and the classes that a task names."""

import inspect
import itertools
import subprocess
import sys
import textwrap
from contextlib import closing
from pathlib import Path
from typing import Any

import gymnasium
import pytest
import torch

import embodichain
from embodichain.config import resolve
from embodichain.config.environments.gymnasium_envs import TaskEnv, make_task_vec
from embodichain.config.resolved import resolve_tree, thaw
from embodichain.lab.gym.envs.base_env import BaseEnv
from embodichain.lab.gym.utils.registration import register_env
from embodichain.utils.errors import ConfigError
from tests.config.conftest import WriteTask
from tests.helpers.code_blocks import run_forked


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


def test_an_environment_says_what_it_is(write_task: WriteTask) -> None:
    write_task()
    env = embodichain.make("mine", num_envs=3, device="cpu", seed=2, render_mode="rgb_array")
    try:
        text = repr(env)
        assert text.startswith(
            "BaseEnv('mine', num_envs=3, device='cpu', action=(6,), observation="
        )
        assert "robot: {qf: (6,), qpos: (6,), qvel: (6,)}" in text
        assert str(env) == text and "\n" not in text
        assert (env.seed_value, env.render_mode) == (2, "rgb_array")
    finally:
        env.close()
    assert repr(env) == text
    with closing(gymnasium.make_vec("embodichain/reach-v0", num_envs=2)) as batch:
        assert "('reach', num_envs=2, autoreset_mode=NEXT_STEP, action=(6,), " in repr(batch)
    with closing(gymnasium.make("embodichain/reach-v0", seed=3, device="cpu")) as alone:
        assert "TaskEnv('reach', action=(6,), observation=(21,))" in repr(alone.unwrapped)


def test_the_signature_names_what_may_be_given() -> None:
    names = ["device", "seed", "render_mode", "autoreset_mode", "run_dir", "config_dir"]
    for function in (embodichain.make, TaskEnv.__init__, make_task_vec):
        parameters = inspect.signature(function).parameters
        expected = set(names)
        if function is TaskEnv.__init__:
            expected -= {"autoreset_mode"}
        assert expected <= set(parameters)
        # What a completion offers.
        assert parameters["render_mode"].annotation == "Literal['rgb_array'] | None"


def test_a_device_that_is_not_here_is_named() -> None:
    if torch.cuda.is_available():
        pytest.skip("there is a GPU")
    with pytest.raises(ConfigError, match="device: there is no CUDA device here"):
        embodichain.make("reach", device="cuda")
    with pytest.raises(ConfigError, match=r"unknown device 'gpu'; allowed: cpu, cuda"):
        embodichain.make("reach", device="gpu")
    with pytest.raises(ConfigError, match="device is given twice"):
        embodichain.make("reach", device="cpu", overrides=["device=cpu"])


@pytest.mark.parametrize(
    ("argument", "message"),
    [
        ({"rendermode": "rgb_array"}, "Did you mean 'render_mode'?"),
        ({"viewer": "web"}, "viewer is a key of `embodichain run`; the environment does not read"),
        ({"sim": {}}, r"set by overrides=\['sim.NAME=VALUE'\]"),
    ],
)
def test_an_argument_that_it_does_not_take(argument: dict[str, Any], message: str) -> None:
    with pytest.raises(TypeError, match=message):
        embodichain.make("reach", **argument)


@pytest.mark.parametrize("text", [embodichain.__doc__, embodichain.make.__doc__])
def test_the_help_has_a_loop_that_runs(text: str, tmp_path: Path) -> None:
    block = inspect.cleandoc(text).partition("::\n\n")[2]
    lines = itertools.takewhile(
        lambda line: not line.strip() or line.startswith("    "), block.splitlines()
    )
    folder = tmp_path / "loop"
    folder.mkdir()
    status, printed = run_forked(textwrap.dedent("\n".join(lines)), folder)
    assert status == 0, printed


def test_what_exists_is_listed_and_found() -> None:
    assert {"make", "config", "learning", "recording", "lab", "__version__"} <= set(
        dir(embodichain)
    )
    code = "import embodichain; print(embodichain.recording.open.__name__)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "open\n"


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
