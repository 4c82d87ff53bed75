"""Gymnasium's ids of YAML tasks: when they exist, what `make` and `make_vec` give, wrong calls."""

import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from stable_baselines3 import PPO
from stable_baselines3.common.env_checker import check_env as check_env_sb3

import embodichain
from embodichain.config.gymnasium_ids import register_task_ids
from embodichain.lab.gym.envs.base_env import BaseEnv
from embodichain.lab.gym.utils.registration import REGISTERED_ENVS, build_env, register_env
from embodichain.lab.gym.vector import NumpyVectorEnv
from embodichain.learning import SB3VecEnv, evaluate
from embodichain.utils.errors import ConfigError
from tests.config.conftest import WriteTask

pytestmark = pytest.mark.slow

REACH = "embodichain/reach-v0"


def python(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


# -- when the ids exist ----------------------------------------------------------------------------


@pytest.mark.unmeasured
@pytest.mark.parametrize(
    "imports",
    [
        "import embodichain, gymnasium",
        "import gymnasium, embodichain",
        # Whether Gymnasium is installed is asked first, and it is imported later.
        "import embodichain, importlib.util as u; u.find_spec('gymnasium'); import gymnasium",
    ],
)
def test_ids_exist_once_both_are_imported_and_nothing_heavy_is(imports: str) -> None:
    heavy = {"torch", "mujoco", "hydra", "omegaconf", "pydantic", "tensordict"}
    code = f"""{imports}
import sys
found = [key for key in gymnasium.registry if key.startswith("embodichain/")]
print("{REACH}" in found, len(found) >= 10, sorted({heavy} & set(sys.modules)))
print(type(gymnasium.__loader__).__name__, gymnasium.__spec__.loader is gymnasium.__loader__)
print([type(f).__module__ for f in sys.meta_path if "embodichain.config" in type(f).__module__])
"""
    assert python(code).splitlines() == ["True True []", "SourceFileLoader True", "[]"]


def test_an_id_may_name_the_package_instead_of_an_import() -> None:
    code = f"import gymnasium; print(gymnasium.make('embodichain:{REACH}').action_space.shape)"
    assert python(code) == "(6,)"


def test_tasks_of_packages_and_of_the_working_directory_have_ids(write_task: WriteTask) -> None:
    write_task()
    write_task(name="no id")
    site = Path("site")
    package = site / "theirs" / "conf" / "task"
    package.mkdir(parents=True)
    (site / "theirs" / "__init__.py").write_text("raise RuntimeError('imported')\n")
    (package / "stack.yaml").write_text("description: A stack.\n")
    for name, value in (("theirs", "theirs.conf"), ("gone", "gone.conf")):
        info = site / f"{name}-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(f"[embodichain.conf]\n{name} = {value}\n")
    code = """
import sys; sys.path.insert(0, "site")
import embodichain, gymnasium
for name in ("stack", "mine", "no id"):
    print(f"embodichain/{name}-v0" in gymnasium.registry, end=" ")
"""
    assert python(code) == "True True False"


# -- one environment -------------------------------------------------------------------------------


def test_make_is_one_environment_in_numpy() -> None:
    env = gym.make(REACH, seed=3, overrides=["task.max_episode_steps=7"], render_mode="rgb_array")
    try:
        assert env.observation_space == gym.spaces.Box(-np.inf, np.inf, (21,), np.float32)
        assert env.action_space.shape == (6,) and env.spec is not None and env.spec.id == REACH
        obs, info = env.reset()
        assert isinstance(obs, np.ndarray) and obs.dtype == np.float32 and obs.shape == (21,)
        obs, reward, terminated, truncated, info = env.step(env.action_space.sample())
        assert (type(reward), type(terminated), type(truncated)) == (float, bool, bool)
        assert info["elapsed_steps"] == 1 and info["diverged"] is False
        ends = [env.step(env.action_space.sample())[3] for _ in range(6)]
        assert ends == [False] * 5 + [True]
        base = env.unwrapped.env  # type: ignore[attr-defined]
        assert (base.num_envs, base.seed_value) == (1, 3)
        picture = env.render()
        assert isinstance(picture, np.ndarray) and picture.shape == (480, 640, 3)
    finally:
        env.close()


def test_gymnasiums_limit_shortens_the_episode_and_render_lists_work() -> None:
    env = gym.make(REACH, max_episode_steps=2, render_mode="rgb_array_list")
    try:
        env.reset()
        assert [env.step(env.action_space.sample())[3] for _ in range(2)] == [False, True]
        pictures = env.render()
        assert isinstance(pictures, list) and len(pictures) == 3
    finally:
        env.close()


def test_the_nested_observation_on_request() -> None:
    env = gym.make(REACH, flatten=False)
    try:
        obs, _ = env.reset(seed=0)
        assert isinstance(obs, dict) and obs["robot"]["qpos"].shape == (6,)
        assert env.observation_space.contains(obs)
    finally:
        env.close()


def test_plain_stable_baselines_learns_on_it() -> None:
    env = gym.make(REACH)
    try:
        model = PPO("MlpPolicy", env, n_steps=64, batch_size=32, n_epochs=1, device="cpu", seed=0)
        before = [p.detach().clone() for p in model.policy.parameters()]
        model.learn(192)
        assert model.num_timesteps == 192 and len(model.ep_info_buffer or ()) == 1
        after = list(model.policy.parameters())
        assert any(not torch.equal(a, b) for a, b in zip(after, before, strict=True))
    finally:
        env.close()


def test_without_declared_observations_the_vector_is_every_number(write_task: WriteTask) -> None:
    write_task()
    register_task_ids()
    env = gym.make("embodichain/mine-v0")
    try:
        assert env.reset(seed=1)[0].shape == (18,)  # qpos, qvel, qf of six joints
    finally:
        env.close()


PICTURES = """
observations:
  picture: {func: "pictures:picture"}
  qpos: {func: joint_position_relative, params: {entity_cfg: {uid: arm}}}
  other: {func: joint_velocity, group: critic, params: {entity_cfg: {uid: arm}}}
rewards:"""


@pytest.fixture
def pictured(write_task: WriteTask, monkeypatch: pytest.MonkeyPatch) -> str:
    """Writes a task whose policy group has an image (a gradient that moves with the arm)."""
    Path("pictures.py").write_text(
        "import torch\n\n\n"
        "def picture(env, obs):\n"
        "    ramp = torch.arange(40 * 48 * 3).reshape(1, 40, 48, 3)\n"
        "    moved = ramp + (100 * obs['robot']['qpos'][:, 1]).long()[:, None, None, None]\n"
        "    return (moved % 256).to(torch.uint8)\n"
    )
    monkeypatch.syspath_prepend(".")
    write_task("rewards:", PICTURES.strip())
    register_task_ids()
    return "embodichain/mine-v0"


def test_images_make_it_a_dict_of_boxes(pictured: str) -> None:
    env = gym.make(pictured)
    batch = gym.make_vec(pictured, num_envs=2)
    try:
        space = env.observation_space
        assert isinstance(space, gym.spaces.Dict) and list(space) == ["picture", "qpos"]
        assert space["picture"] == gym.spaces.Box(0, 255, (40, 48, 3), np.uint8)
        assert space["qpos"].shape == (6,) and batch.single_observation_space == space
        obs, _ = env.reset(seed=1)
        assert space.contains(obs) and batch.observation_space.contains(batch.reset(seed=1)[0])
        check_env(env.unwrapped, skip_render_check=True)
        check_env_sb3(env, skip_render_check=True)
        model = PPO("MultiInputPolicy", env, n_steps=8, batch_size=8, n_epochs=1, device="cpu")
        model.learn(8)
    finally:
        env.close()
        batch.close()


# -- a batch ---------------------------------------------------------------------------------------


def test_make_vec_is_the_numpy_batch_with_next_step() -> None:
    env = gym.make_vec(REACH, num_envs=3, seed=5, max_episode_steps=2)
    try:
        assert isinstance(env, NumpyVectorEnv) and env.num_envs == 3 and env.spec.id == REACH
        assert env.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
        assert env.observation_space.shape == (3, 21) and env.action_space.shape == (3, 6)
        env.reset()
        zero = np.zeros((3, 6), np.float32)
        ends = [env.step(zero)[3].tolist() for _ in range(4)]
        assert ends == [[False] * 3, [True] * 3, [False] * 3, [False] * 3]  # the third step resets
    finally:
        env.close()


@pytest.mark.parametrize("mode", ["SAME_STEP", AutoresetMode.DISABLED, "NextStep"])
def test_make_vec_takes_the_other_modes(mode: str | AutoresetMode) -> None:
    env = gym.make_vec(REACH, num_envs=2, autoreset_mode=mode, flatten=False, max_episode_steps=1)
    wanted = mode if isinstance(mode, AutoresetMode) else None
    try:
        assert wanted in (None, env.metadata["autoreset_mode"])
        env.reset(seed=0)
        obs, _, _, truncated, info = env.step(np.zeros((2, 6), np.float32))
        assert truncated.all() and obs["robot"]["qpos"].shape == (2, 6)
        assert ("final_obs" in info) is (mode == "SAME_STEP")
    finally:
        env.close()


def test_all_three_ways_give_the_same_numbers() -> None:
    one, batch = gym.make(REACH), gym.make_vec(REACH, num_envs=3)
    tensors = embodichain.make("reach", num_envs=3)
    assert tensors.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    try:
        rows = [one.reset(seed=7)[0]], [batch.reset(seed=7)[0]]
        torch_rows = [tensors.observation_manager.flatten(tensors.reset(seed=7)[0])]
        for step in range(5):
            action = np.full((3, 6), 0.2 * step - 0.3, np.float32)
            rows[0].append(one.step(action[0])[0])
            rows[1].append(batch.step(action)[0])
            torch_rows.append(
                tensors.observation_manager.flatten(tensors.step(torch.from_numpy(action))[0])
            )
        for single, many, wanted in zip(*rows, torch_rows, strict=True):
            np.testing.assert_array_equal(many, wanted.numpy())
            np.testing.assert_array_equal(single, many[0])
    finally:
        one.close()
        batch.close()
        tensors.close()


# -- the wrong call names the right one ------------------------------------------------------------

BATCHES = r"gymnasium.make_vec\('embodichain/reach-v0', num_envs=N\).*embodichain.make\('reach', "


@pytest.mark.parametrize(
    "kwargs",
    [
        {"num_envs": 64},
        {"num_envs": 1},
        {"autoreset_mode": "SAME_STEP"},
        {"overrides": ["num_envs=64"]},
    ],
)
def test_make_of_a_batch_names_make_vec_and_ours(kwargs: dict[str, object]) -> None:
    with pytest.raises(ConfigError, match=BATCHES):
        gym.make(REACH, **kwargs)


def test_an_id_is_no_name_and_a_class_no_task() -> None:
    with pytest.raises(ConfigError, match=r"embodichain\.make\('reach'\)"):
        embodichain.make(REACH)
    with pytest.raises(ConfigError, match=r"made by gymnasium\.make, gymnasium\.make_vec"):
        build_env(REACH, None)  # type: ignore[arg-type]
    register_env("Door-v0")(BaseEnv)
    try:
        with pytest.raises(ConfigError, match=r"gymnasium\.make\('Door-v0', num_envs=N\)"):
            embodichain.make("Door-v0")
    finally:
        REGISTERED_ENVS.pop("Door-v0")
        gym.registry.pop("Door-v0")


@pytest.mark.parametrize("build", [gym.make, gym.make_vec])
def test_learning_takes_the_batch_of_tensors(build: object) -> None:
    env = build(REACH)  # type: ignore[operator]
    try:
        with pytest.raises(
            TypeError, match=r"batch of tensors, embodichain\.make\(NAME, num_envs=N\)"
        ):
            SB3VecEnv(env)
        with pytest.raises(TypeError, match="evaluate takes the batch of tensors"):
            evaluate(env, "zero", 1)
    finally:
        env.close()


def test_nothing_that_is_given_is_dropped() -> None:
    with pytest.raises(ConfigError, match="num_envs is given twice: 3 as argument, and num_envs=4"):
        gym.make_vec(REACH, num_envs=3, overrides=["num_envs=4"])
    with pytest.raises(ConfigError, match="seed is given twice"):
        embodichain.make("reach", seed=1, overrides=["seed=2"])
    with pytest.raises(TypeError, match="unknown argument 'overides'.*Did you mean 'overrides'"):
        gym.make(REACH, overides=["seed=1"])
    with pytest.raises(ValueError, match="unknown autoreset_mode 'SAMESTEP'"):
        gym.make_vec(REACH, autoreset_mode="SAMESTEP")


def test_the_spec_has_the_tasks_limit_without_a_wrapper() -> None:
    env = gym.make(REACH, overrides=["task.max_episode_steps=5"])
    assert env.spec.max_episode_steps == env.unwrapped.spec.max_episode_steps == 5
    assert "TimeLimit" not in str(env)
    timed = gym.wrappers.TimeAwareObservation(env)
    timed.reset(seed=0)
    counts = [timed.step(env.action_space.sample())[0][-1] for _ in range(5)]
    assert counts == [1, 2, 3, 4, 5]
    env.close()
    vector = gym.make_vec(REACH, num_envs=2, max_episode_steps=7)
    assert vector.spec.max_episode_steps == 7
    vector.close()
