import copy
from collections.abc import Mapping

import gymnasium as gym
import numpy as np
import pytest
import torch
from tensordict import TensorDict

from embodichain.lab.gym.envs import BaseEnv, EmbodiedEnv, EnvCfg
from embodichain.lab.gym.envs.cfg import (
    ActionTermCfg,
    EventCfg,
    MetricCfg,
    ObservationCfg,
    PhysicsTaskCfg,
    RewardCfg,
    TerminationCfg,
)
from embodichain.lab.sim.cfg import RigidObjectCfg, RobotCfg, SimulationManagerCfg
from embodichain.utils.errors import ConfigError, DeviceError, RenderError
from tests.lab.gym.conftest import HOME, UR10, flat, home, jumping, marker, targets, task


def test_what_reset_and_step_return(make_env):
    env = make_env()
    obs, info = env.reset()
    assert isinstance(obs, Mapping) and obs.batch_size == (3,)
    for name in ("qpos", "qvel", "qf"):
        assert obs["robot", name].shape == (3, 6) and obs["robot", name].dtype == torch.float32
    np.testing.assert_allclose(obs["robot", "qpos"][1], HOME, atol=1e-6)
    assert type(info) is dict and info["elapsed_steps"].tolist() == [0, 0, 0]
    obs, reward, terminated, truncated, info = env.step(home(env))
    assert reward.shape == (3,) and reward.dtype == torch.float32 and not reward.any()
    for flags in (terminated, truncated, info["success"], info["fail"], info["diverged"]):
        assert flags.shape == (3,) and flags.dtype == torch.bool and not flags.any()
    assert type(info) is dict and info["elapsed_steps"].dtype == torch.int32
    assert info["elapsed_steps"].tolist() == [1, 1, 1]
    assert info["rewards"] == {} and info["episode_sums"] == {} and info["metrics"] == {}
    assert env.observation_space.contains(
        {"robot": {k: v.numpy() for k, v in obs["robot"].items()}}
    )
    assert env.action_space.shape == (3, 6) and env.action_space.sample().dtype == np.float32
    assert env.step_dt == pytest.approx(0.04) and env.metadata["render_fps"] == pytest.approx(25)
    assert EmbodiedEnv is BaseEnv


def test_bounds_of_the_default_action_are_the_joint_limits(make_env):
    env = make_env()
    limits = env.robot.body_data.qpos_limits[0].numpy()
    np.testing.assert_array_equal(env.single_action_space.low, limits[:, 0])
    np.testing.assert_array_equal(env.single_action_space.high, limits[:, 1])
    assert np.isfinite(limits).all()


def test_a_declared_robot_follows_joint_targets(make_env):
    env = make_env(num_envs=2)
    env.reset()
    goal = home(env) + torch.tensor([[0.2], [-0.2]])
    for _ in range(60):
        obs, *_ = env.step(goal)
    np.testing.assert_allclose(obs["robot", "qpos"], goal, atol=0.02)


def test_a_tensordict_drives_the_declared_robot(make_env):
    env, plain = make_env(), make_env()
    env.reset(), plain.reset()
    action = targets(env, 1)
    obs, *_ = env.step(TensorDict({"qpos": action}, batch_size=[3]))
    expected, *_ = plain.step(action)
    np.testing.assert_array_equal(flat(obs), flat(expected))
    with pytest.raises(ValueError, match="qpos, qvel, qf"):
        env.step(TensorDict({"torque": action}, batch_size=[3]))


@pytest.mark.parametrize(
    ("action", "error", "message"),
    [
        (torch.zeros(3, 5), ValueError, r"\(3, 6\), got \(3, 5\)"),
        (torch.zeros(6), ValueError, r"\(3, 6\), got \(6,\)"),
        (torch.zeros(1, 6), ValueError, r"\(3, 6\), got \(1, 6\)"),
        (torch.zeros(3, 6, dtype=torch.int64), TypeError, r"\(3, 6\), got torch.int64"),
        (np.zeros((3, 6), np.int64), TypeError, "int64"),
        (np.zeros((2, 6)), ValueError, r"\(3, 6\), got \(2, 6\)"),
        ([[0.0] * 6] * 3, TypeError, r"\(3, 6\), got list"),
        (torch.zeros(3, 6, device="meta"), ValueError, "meta"),
        (torch.full((3, 6), torch.nan), ValueError, r"not finite in environments \[0, 1, 2\]"),
        (torch.tensor([[0.0] * 6, [torch.inf] * 6, [0.0] * 6]), ValueError, r"\[1\]"),
        (np.array([[0.0] * 6, [0.0] * 6, [np.nan] * 6]), ValueError, r"\[2\]"),
    ],
)
def test_a_wrong_action_raises_before_anything_changes(make_env, action, error, message):
    env = make_env()
    env.reset()
    env.step(targets(env, 0))
    rows, step = env.sim.engine.rows.copy(), env.control_step
    with pytest.raises(error, match=message):
        env.step(action)
    np.testing.assert_array_equal(env.sim.engine.rows, rows)
    assert env.control_step == step and env.elapsed_steps.tolist() == [1, 1, 1]
    assert env.read_elapsed_steps().tolist() == [1, 1, 1]


def test_huge_finite_actions_are_not_mistaken_for_nan(make_env):
    env = make_env()
    env.reset()
    env.step(torch.full((3, 6), 3e38))


def test_numpy_actions_act_as_tensors_do(make_env):
    env, other = make_env(), make_env()
    env.reset(), other.reset()
    action = targets(env, 2)
    np.testing.assert_array_equal(
        flat(env.step(action)[0]), flat(other.step(action.numpy().astype(np.float64))[0])
    )


def test_step_needs_a_reset_first(make_env):
    env = make_env()
    with pytest.raises(gym.error.ResetNeeded):
        env.step(home(env))


class Ordered(BaseEnv):
    """Writes down what is called; calls no super()."""

    def __init__(self, *args, **kwargs):
        self.calls = []
        super().__init__(*args, **kwargs)

    def _setup_robot(self, **kwargs):
        self.calls.append("_setup_robot")

    def _prepare_scene(self, **kwargs):
        self.calls.append("_prepare_scene")

    def _setup_sensors(self, **kwargs):
        self.calls.append("_setup_sensors")
        return {}

    def _init_sim_state(self, **kwargs):
        self.calls.append("_init_sim_state")

    def _initialize_episode(self, env_ids, **kwargs):
        self.calls.append(f"_initialize_episode {env_ids.tolist()} {kwargs}")

    def is_task_success(self, **kwargs):
        self.calls.append("is_task_success")
        return torch.zeros(self.num_envs, dtype=torch.bool)

    def _preprocess_action(self, action):
        self.calls.append("_preprocess_action")
        return action

    def _step_action(self, action):
        self.calls.append("_step_action")

    def _postprocess_action(self, action):
        self.calls.append("_postprocess_action")
        return action

    def _update_sim_state(self, **kwargs):
        self.calls.append("_update_sim_state")

    def _extend_obs(self, obs, **kwargs):
        self.calls.append("_extend_obs")
        return obs

    def evaluate(self, **kwargs):
        self.calls.append("evaluate")
        return {"height": torch.ones(self.num_envs)}

    def get_reward(self, obs, action, info):
        self.calls.append(f"get_reward {action.shape[1]}")
        return torch.full((self.num_envs,), 2.0)

    def _extend_reward(self, rewards, obs, action, info):
        self.calls.append(f"_extend_reward {rewards[0]}")
        return rewards + 1

    def check_truncated(self, obs, info):
        self.calls.append(f"check_truncated {info['elapsed_steps'][0]}")
        return torch.tensor([False, True, False])

    def _hook_after_sim_step(self, obs, action, rewards, dones, info, **kwargs):
        self.calls.append(f"_hook_after_sim_step {dones.tolist()} {sorted(kwargs)}")


def _terms(log):
    """One term of every kind that writes its name down."""

    def event(name):
        return lambda env, env_ids: log.append(name)

    def judge(name, value):
        return lambda env, obs, action, info: (log.append(name), value)[1]

    ones = torch.ones(3)
    return {
        "events": {
            "s": EventCfg(func=event("event startup"), mode="startup"),
            "r": EventCfg(func=event("event reset"), mode="reset"),
            "i": EventCfg(func=event("event interval"), mode="interval", interval_step=1),
        },
        "observations": {
            "o": ObservationCfg(func=lambda env, obs: (log.append("observation"), ones)[1])
        },
        "rewards": {"w": RewardCfg(func=judge("reward", ones), weight=3.0)},
        "terminations": {"t": TerminationCfg(func=judge("termination", ones < 0))},
        "metrics": {"m": MetricCfg(func=judge("metric", ones))},
        "actions": {"a": ActionTermCfg("joint_position", {"entity_cfg": {"uid": "ur10"}})},
    }


def test_the_order_of_hooks_and_terms(make_env):
    log = []
    env = make_env(cls=Ordered, **_terms(log))
    log_all = env.calls = log  # one list for hooks and terms
    env.reset()
    log.clear()
    env.reset(options={"reset_ids": [0, 2], "why": 1})
    assert log_all == [
        "is_task_success",
        "_initialize_episode [0, 2] {'why': 1}",
        "event reset",
        "_extend_obs",
        "observation",
        "evaluate",
    ]
    env.reset()
    log_all.clear()
    env.step(home(env), extra=1)
    assert log_all == [
        "_preprocess_action",
        "_step_action",
        "_update_sim_state",
        "_extend_obs",
        "observation",
        "evaluate",
        "termination",
        "metric",
        "get_reward 6",
        "reward",
        "_extend_reward 5.0",
        "_postprocess_action",
        "check_truncated 1",
        "event interval",
        "_extend_obs",  # once more: the event may have changed something
        "observation",
        "_hook_after_sim_step [False, True, False] ['extra', 'terminateds', 'truncateds']",
        "is_task_success",
        "_initialize_episode [1] {}",
        "event reset",
        "_extend_obs",
        "observation",
    ]


def test_hooks_at_construction_come_in_order(make_env):
    log = []
    env = make_env(cls=Ordered, **_terms(log))
    assert env.calls == [
        "_setup_robot",
        "_prepare_scene",
        "_setup_sensors",
        "_init_sim_state",
        "_extend_obs",
    ]
    assert log == ["event startup", "observation"]


def test_overriding_hooks_without_super_loses_nothing(make_env):
    env = make_env(cls=Ordered, **_terms([]))
    obs, _ = env.reset()
    assert env.robot is env.sim.get_robot("ur10") and env.sim.get_rigid_object("cube") is not None
    assert obs["o"].tolist() == [1.0, 1.0, 1.0]
    before = env.robot.get_qpos(target=True)
    _, reward, _, truncated, info = env.step(targets(env, 3))
    assert reward.tolist() == [6.0, 6.0, 6.0]  # 2 + 3 x 1 + 1
    assert info["height"].tolist() == [1.0, 1.0, 1.0] and info["metrics"]["m"][0] == 1.0
    assert truncated.tolist() == [False, True, False]
    after = env.robot.get_qpos(target=True)
    assert (after[0] != before[0]).any()  # the action term acted


class OwnObservation(BaseEnv):
    def get_obs(self, **kwargs):
        return TensorDict({"own": torch.zeros(self.num_envs, 1)}, batch_size=[self.num_envs])


class WiderObservation(BaseEnv):
    def get_obs(self, **kwargs):
        obs = super().get_obs(**kwargs)
        obs["own"] = torch.zeros(self.num_envs, 1)
        return obs


@pytest.mark.parametrize("cls", [OwnObservation, WiderObservation])
def test_overriding_get_obs_keeps_declared_observations_once(make_env, cls):
    calls = []

    def count(env, obs):
        calls.append(1)
        return torch.ones(env.num_envs, 1)

    env = make_env(cls=cls, observations={"o": ObservationCfg(func=count)})
    obs, _ = env.reset()
    assert {"own", "o"} <= set(obs.keys())
    calls.clear()
    env.step(home(env))
    assert calls == [1]
    assert "o" in env.observation_space.spaces


def test_evaluate_ends_episodes(make_env):
    class Judged(BaseEnv):
        def evaluate(self, **kwargs):
            return {"success": torch.tensor([True, False, False]), "fail": self.fails}

        fails = torch.tensor([False, True, False])

    env = make_env(cls=Judged)
    env.reset()
    _, _, terminated, truncated, info = env.step(home(env))
    assert terminated.tolist() == [True, True, False] and not truncated.any()
    assert info["success"].tolist() == [True, False, False]
    assert info["fail"].tolist() == [False, True, False]


def test_ignore_terminations_keeps_the_flags_in_info(make_env):
    class Judged(BaseEnv):
        def evaluate(self, **kwargs):
            return {"fail": torch.ones(3, dtype=torch.bool)}

    env = make_env(cls=Judged, ignore_terminations=True)
    env.reset()
    _, _, terminated, _, info = env.step(home(env))
    assert not terminated.any() and info["fail"].all()


@pytest.mark.parametrize("shape", [(3, 1), (1,), ()])
def test_a_reward_of_another_shape_is_refused(make_env, shape):
    class Paid(BaseEnv):
        def get_reward(self, obs, action, info):
            return torch.zeros(shape)

    env = make_env(cls=Paid)
    env.reset()
    with pytest.raises(ValueError, match=r"get_reward must return a tensor of shape \(3,\)"):
        env.step(home(env))


@pytest.mark.parametrize("hook", ["evaluate", "check_truncated"])
def test_flags_of_another_shape_are_refused(make_env, hook):
    mask = torch.zeros(3, 1, dtype=torch.bool)
    result = {"success": mask} if hook == "evaluate" else mask
    cls = type("Wrong", (BaseEnv,), {hook: lambda self, *args, **kwargs: result})
    env = make_env(cls=cls)
    with pytest.raises(ValueError, match=r"must have shape \(3,\), got \(3, 1\)"):
        env.reset()
        env.step(home(env))


def test_without_a_robot(make_env):
    env = make_env(robot=None)
    obs, _ = env.reset()
    assert env.robot is None and obs.get("robot") is None
    assert env.single_action_space.shape == (0,)
    env.step(torch.zeros(3, 0))


# -- config ----------------------------------------------------------------------------------------


def test_the_config_is_copied_and_filled_in(make_env):
    cfg = task(
        physics=PhysicsTaskCfg(physics_dt=0.005, gravity=[0.0, 0.0, -1.0], iterations=7),
        decimation=2,
        episode_length_s=0.095,
    )
    before = copy.deepcopy(cfg)
    env = make_env(cfg)
    assert cfg == before
    assert env.physics_dt == 0.005 and env.sim_steps_per_control == 2
    assert env.max_episode_steps == 10  # rounded up
    model = env.sim.scene.model
    assert model.opt.timestep == 0.005 and model.opt.gravity[2] == -1.0
    assert model.opt.iterations == 7
    env.reset()
    for step in range(1, 11):
        _, _, _, truncated, _ = env.step(home(env))
        assert bool(truncated.all()) is (step == 10)


def test_no_time_limit(make_env):
    env = make_env(max_episode_steps=-1)
    assert env.max_episode_steps == 2**31 - 1
    env.max_episode_steps = 1
    env.reset()
    assert env.step(home(env))[3].all()
    with pytest.raises(ValueError, match="at least 1"):
        env.max_episode_steps = 0


def test_every_mistake_of_a_config_is_reported(make_env):
    with pytest.raises(ConfigError) as caught:
        make_env(
            num_envs=0,
            max_episode_steps=0,
            sim_steps_per_control=0,
            seed="one",
        )
    paths = {problem.path for problem in caught.value.problems}
    assert paths == {"num_envs", "max_episode_steps", "sim_steps_per_control", "seed"}


def test_scene_and_terms_are_checked_together(make_env):
    with pytest.raises(ConfigError) as caught:
        make_env(
            robot=RobotCfg(uid="ur10", fpath=UR10, init_qpos={"Joint9": 0.0}),
            rewards={"near": RewardCfg("within_distanze")},
        )
    text = str(caught.value)
    assert "Joint9" in text and "within_distanze" in text and "Did you mean" in text


def test_a_robot_of_a_wrong_file_names_its_key(make_env):
    with pytest.raises(ConfigError, match="robot.fpath"):
        make_env(robot=RobotCfg(uid="arm", fpath="nowhere/arm.urdf"))


def test_several_robots_and_extensions(make_env):
    robots = {
        "left": RobotCfg(fpath=UR10, init_pos=(0.0, 1.0, 1.0)),
        "right": RobotCfg(fpath=UR10, init_pos=(0.0, -1.0, 1.0)),
    }
    env = make_env(robot=None, robots=robots, extensions={"threshold": 0.1})
    assert env.robot.uid == "left" and env.threshold == 0.1
    assert env.sim.get_robot_uid_list() == ["left", "right"]
    with pytest.raises(ConfigError, match="extensions.reset"):
        make_env(extensions={"reset": 1})


def test_cuda_says_that_it_is_not_there_yet(make_env):
    with pytest.raises(DeviceError, match="there is no CUDA device here"):
        make_env(sim_cfg=SimulationManagerCfg(headless=True, sim_device="cuda"))


def test_no_display_means_headless_with_a_warning(make_env, monkeypatch, caplog):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    # macOS has a display without these variables.
    monkeypatch.setattr("sys.platform", "linux")
    env = make_env(sim_cfg=SimulationManagerCfg(headless=False, num_threads=1))
    assert env.cfg.sim_cfg.headless and not env.sim.is_window_open
    assert "no display" in caplog.text


def test_render_modes(make_env):
    env = make_env()
    with pytest.warns(UserWarning, match='render_mode="rgb_array"') as warned:
        assert env.render() is None
    assert warned[0].filename == __file__
    with pytest.raises(ValueError, match="rgb_array"):
        make_env(env_kwargs={"render_mode": "human"})


def test_rgb_array_gives_a_picture_and_changes_nothing(make_env):
    env = make_env(env_kwargs={"render_mode": "rgb_array"})
    env.reset()
    rows = env.sim.engine.rows.copy()
    try:
        picture = env.render()
    except RenderError as error:
        pytest.skip(str(error))
    assert picture.shape == (480, 640, 3) and picture.dtype == np.uint8 and picture.std() > 1
    np.testing.assert_array_equal(env.sim.engine.rows, rows)


def test_a_failed_build_leaves_nothing_behind(make_env):
    from embodichain.lab.sim import SimulationManager

    alive = SimulationManager.get_instance_num()

    class Broken(BaseEnv):
        def _init_sim_state(self, **kwargs):
            raise RuntimeError("on purpose")

    with pytest.raises(RuntimeError, match="on purpose"):
        make_env(cls=Broken)
    assert SimulationManager.get_instance_num() == alive


# -- seeds -----------------------------------------------------------------------------------------


def _rollout(env, seed=None, steps=5):
    obs, _ = env.reset(seed=seed)
    rows = [flat(obs)]
    for step in range(steps):
        rows.append(flat(env.step(targets(env, step))[0]))
    return np.stack(rows)


def test_the_same_seed_gives_the_same_bytes(make_env):
    env, other = make_env(**jumping()), make_env(**jumping(), seed=5)
    first = _rollout(env, 5)
    np.testing.assert_array_equal(first, _rollout(env, 5))
    np.testing.assert_array_equal(first, _rollout(other))
    assert (first != _rollout(env, 6)).any()


def test_an_environment_does_not_depend_on_how_many_there_are(make_env):
    many = _rollout(make_env(**jumping(), num_envs=3), 1)
    one = _rollout(make_env(**jumping(), num_envs=1), 1)
    np.testing.assert_array_equal(many[:, :1], one)
    assert (many[:, 0] != many[:, 1]).any()


def test_a_seed_reaches_every_generator(make_env):
    env = make_env()
    assert env.seed_value == 0
    env.reset(seed=11)
    numbers = env.np_random.random(), torch.rand(1).item(), env.rand("x")[0].item()
    assert env.np_random_seed == 11 and env.seed_value == 11
    env.reset(seed=11)
    assert numbers == (env.np_random.random(), torch.rand(1).item(), env.rand("x")[0].item())
    with pytest.raises(ValueError, match="one integer"):
        env.reset(seed=[1, 2, 3])
    assert make_env(seed=-1).seed_value != make_env(seed=-1).seed_value


# -- resets ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "options",
    [
        {"reset_ids": torch.tensor([1])},
        {"env_ids": [1]},
        {"reset_mask": np.array([False, True, False])},
        {"reset_ids": torch.tensor([False, True, False])},
    ],
)
def test_a_partial_reset_leaves_the_others_to_the_bit(make_env, options):
    env = make_env(**jumping())
    env.reset(seed=3)
    for step in range(3):
        before, *_ = env.step(targets(env, step))
    rows = env.sim.engine.rows.copy()
    obs, info = env.reset(options=options)
    keep = [0, 2]
    np.testing.assert_array_equal(env.sim.engine.rows[keep], rows[keep])
    np.testing.assert_array_equal(flat(obs)[keep], flat(before)[keep])
    np.testing.assert_allclose(obs["robot", "qpos"][1], HOME, atol=1e-6)
    assert info["elapsed_steps"].tolist() == [3, 0, 3]
    assert env.episode_ids.tolist() == [0, 1, 0]
    assert env.last_action[1].tolist() == [0.0] * 6 and env.last_action[0].any()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"reset_ids": [3]}, r"\[0, 3\)"),
        ({"reset_ids": [1, 0]}, "sorted"),
        ({"reset_ids": [0, 0]}, "unique"),
        ({"env_ids": torch.tensor([[0]])}, "one-dimensional"),
        ({"reset_mask": np.zeros(2, bool)}, r"\(3,\)"),
        ({"reset_ids": [0], "env_ids": [0]}, "one of"),
    ],
)
def test_wrong_reset_ids_raise(make_env, options, message):
    env = make_env()
    env.reset()
    with pytest.raises(ValueError, match=message):
        env.reset(options=options)
    assert env.episode_ids.tolist() == [0, 0, 0]


def test_a_reset_of_nobody_changes_nothing(make_env):
    env = make_env(**jumping())
    env.reset()
    before, *_ = env.step(targets(env, 0))
    rows, streams = env.sim.engine.rows.copy(), env.streams.state_dict()
    obs, _ = env.reset(options={"reset_ids": []})
    np.testing.assert_array_equal(env.sim.engine.rows, rows)
    np.testing.assert_array_equal(flat(obs), flat(before))
    assert env.episode_ids.tolist() == [0, 0, 0]
    np.testing.assert_array_equal(
        streams["counters"]["noise"], env.streams.state_dict()["counters"]["noise"]
    )


def test_detached_entities_stay_at_a_reset(make_env):
    env = make_env()
    env.reset()
    cube = env.sim.get_rigid_object("cube")
    pose = torch.tensor([[0.3, 0.2, 0.9, 1.0, 0.0, 0.0, 0.0]]).repeat(3, 1)
    cube.set_local_pose(pose)
    env.add_detached_uids_for_reset(["cube"])
    env.step(targets(env, 0))
    obs, _ = env.reset()
    np.testing.assert_array_equal(cube.get_local_pose(), pose)
    np.testing.assert_allclose(obs["robot", "qpos"][0], HOME, atol=1e-6)
    with pytest.raises(ValueError, match="cube"):
        env.add_detached_uids_for_reset(["cub"])


# -- what is handed out belongs to the caller ------------------------------------------------------


def test_changing_what_was_handed_out_changes_nothing(make_env):
    rewards = {"near": RewardCfg(func=lambda env, obs, action, info: obs["cube"][:, 0])}
    metrics = {"x": MetricCfg(func=lambda env, obs, action, info: obs["cube"][:, 0], reduce="sum")}
    sections = {**jumping(), "rewards": rewards, "metrics": metrics, "max_episode_steps": 4}
    env, twin = make_env(**sections), make_env(**sections)
    for one in (env, twin):
        one.reset(seed=2)
    for step in range(10):
        got = env.step(targets(env, step))
        expected = twin.step(targets(twin, step))
        np.testing.assert_array_equal(flat(got[0]), flat(expected[0]))
        for name in ("rewards", "episode_sums", "metrics"):
            for key, value in expected[4][name].items():
                np.testing.assert_array_equal(got[4][name][key], value)
        for tensor in (got[1], got[2], got[3], got[4]["elapsed_steps"], env.elapsed_steps):
            tensor.fill_(1)
        for _, leaf in got[0].items(True, True):
            leaf.fill_(1e6)
        for name in ("rewards", "episode_sums", "metrics"):
            for value in got[4][name].values():
                value.fill_(1e6)
        env.last_action.fill_(1e6), env.episode_ids.fill_(9)


def test_what_was_handed_out_stays_as_it_is(make_env):
    env = make_env(**jumping(), max_episode_steps=3)
    obs, _ = env.reset(seed=1)
    kept = [(obs, flat(obs), {})]
    for step in range(7):
        obs, reward, terminated, truncated, info = env.step(targets(env, step))
        kept.append((obs, flat(obs), {**info, "t": truncated, "copy": truncated.clone()}))
    for obs, numbers, info in kept:
        np.testing.assert_array_equal(flat(obs), numbers)
        if info:
            assert torch.equal(info["t"], info["copy"])


# -- state -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", ["SAME_STEP", "NEXT_STEP"])
def test_a_restored_environment_continues_to_the_bit(make_env, mode):
    sections = {
        **jumping(),
        "max_episode_steps": 4,
        "rewards": {"x": RewardCfg(func=lambda env, obs, action, info: obs["cube"][:, 0])},
        "metrics": {
            "x": MetricCfg(func=lambda env, obs, action, info: obs["cube"][:, 0], reduce="max")
        },
    }
    env = make_env(**sections, env_kwargs={"autoreset_mode": mode})
    env.reset(seed=4)
    for step in range(4):
        env.step(targets(env, step))
    saved = env.state_dict()

    def onwards(one):
        found = []
        for step in range(4, 10):
            obs, reward, _, truncated, info = one.step(targets(one, step))
            sums = info["episode_sums"]["x"].numpy().copy()
            found.append(np.concatenate([flat(obs), reward[:, None], sums[:, None]], axis=1))
            assert one.control_step == step + 1
        return np.stack(found)

    expected = onwards(env)
    env.load_state_dict(saved)
    np.testing.assert_array_equal(onwards(env), expected)
    fresh = make_env(**sections, env_kwargs={"autoreset_mode": mode})
    fresh.load_state_dict(saved)
    np.testing.assert_array_equal(onwards(fresh), expected)
    with pytest.raises(ValueError, match="3 environments, the environment has 2"):
        make_env(**sections, num_envs=2).load_state_dict(saved)


def test_marker_is_observed_where_it_was_put(make_env):
    """Writes after physics are in that step's observation."""

    class Moving(BaseEnv):
        def _update_sim_state(self, **kwargs):
            pose = torch.zeros(self.num_envs, 7)
            pose[:, 3], pose[:, 0] = 1.0, float(self.control_step + 1)
            self.sim.get_rigid_object("cube").set_local_pose(pose)

    env = make_env(cls=Moving, observations={"cube": ObservationCfg(func=marker)})
    env.reset()
    for step in range(1, 4):
        assert env.step(home(env))[0]["cube"][0, 0] == step


def test_an_object_declared_twice_is_one(make_env):
    class Adds(BaseEnv):
        def _prepare_scene(self, **kwargs):
            self.own = self.sim.add_rigid_object(RigidObjectCfg(uid="cube", init_pos=(0, 0, 2)))

    env = make_env(cls=Adds)
    assert env.sim.get_rigid_object("cube") is env.own


def test_float64_observations_are_handed_out_in_float32(make_env):
    wide = ObservationCfg(func=lambda env, obs: torch.ones(3, 2, dtype=torch.float64))

    class Extended(BaseEnv):
        def _extend_obs(self, obs, **kwargs):
            obs["more"] = torch.ones(3, 1, dtype=torch.float64)
            obs["count"] = torch.ones(3, dtype=torch.int64)
            return obs

    env = make_env(cls=Extended, observations={"wide": wide})
    obs, _ = env.reset()
    assert obs["wide"].dtype == obs["more"].dtype == torch.float32
    assert obs["count"].dtype == torch.int64
    assert env.single_observation_space["more"].shape == (1,)
    assert env.single_observation_space["count"].dtype == np.int64


def test_close_can_be_called_twice(make_env):
    env = make_env()
    env.close()
    env.close()


def test_default_config_has_default_values():
    env = BaseEnv(EnvCfg(sim_cfg=SimulationManagerCfg(headless=True)))
    env.reset()
    env.step(torch.zeros(1, 0))
    env.close()


@pytest.mark.parametrize("looks", ["nobody", "get_info", "get_reward", "check_truncated", "a term"])
def test_terms_count_the_present_step_and_hooks_do_not(make_env, looks):
    seen = []

    class Looking(BaseEnv):
        pass

    def get_info(self, **kwargs):
        info = BaseEnv.get_info(self, **kwargs)
        seen.append(info["elapsed_steps"].tolist())
        return info

    def get_reward(self, obs, action, info):
        seen.append(info["elapsed_steps"].tolist())
        return torch.zeros(self.num_envs)

    def check_truncated(self, obs, info):
        seen.append((info["elapsed_steps"] - 1).tolist())  # asked after the step was counted
        return torch.zeros(self.num_envs, dtype=torch.bool)

    def term(env, obs, action, info):
        assert torch.equal(info["elapsed_steps"], env.elapsed_steps)
        seen.append((info["elapsed_steps"] - 1).tolist())
        return torch.zeros(env.num_envs)

    hooks = {f.__name__: f for f in (get_info, get_reward, check_truncated)}
    if looks in hooks:
        setattr(Looking, looks, hooks[looks])
    env = make_env(cls=Looking, rewards={"r": RewardCfg(func=term)} if looks == "a term" else {})
    env.reset()
    seen.clear()
    found = [env.step(home(env))[4] for _ in range(2)]
    assert [info["elapsed_steps"].tolist() for info in found] == [[1] * 3, [2] * 3]
    assert next(iter(found[0])) == "elapsed_steps"
    assert seen == ([] if looks == "nobody" else [[0] * 3, [1] * 3])
