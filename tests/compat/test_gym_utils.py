import argparse

import pytest

from embodichain.lab.gym.envs import BaseEnv
from embodichain.lab.gym.utils.gym_utils import (
    add_env_launcher_args_to_parser,
    build_env_cfg_from_args,
    config_to_cfg,
)
from embodichain.utils.errors import ConfigError


def _parser():
    parser = argparse.ArgumentParser()
    add_env_launcher_args_to_parser(parser)
    return parser


def test_flags_and_defaults_of_the_launcher():
    assert vars(_parser().parse_args([])) == {
        "num_envs": 1,
        "device": "cpu",
        "headless": False,
        "renderer": "hybrid",
        "arena_space": 5.0,
        "gpu_id": 0,
        "gym_config": "",
        "action_config": None,
        "preview": False,
        "filter_visual_rand": False,
        "filter_dataset_saving": False,
    }


def test_values_are_read():
    args = _parser().parse_args(["--headless", "--num_envs", "4", "--renderer", "fast-rt"])
    assert (args.headless, args.num_envs, args.renderer) == (True, 4, "fast-rt")


def test_an_unknown_renderer_lists_the_known_ones(capsys):
    with pytest.raises(SystemExit):
        _parser().parse_args(["--renderer", "raster"])
    assert "hybrid" in capsys.readouterr().err


CONFIG = """
id: EmbodiedEnv-v1
num_envs: 3
seed: 5
headless: true
arena_space: 2.0
max_episode_steps: 7
robot: {uid: arm, fpath: UniversalRobots/UR10/UR10.urdf}
env: {sim_steps_per_control: 2, actions: {arm: {func: DeltaQposTerm, params: {scale: 0.1}}}}
"""


def _args(folder, *flags):
    (folder / "gym_config.yaml").write_text(CONFIG)
    return _parser().parse_args(["--gym_config", str(folder / "gym_config.yaml"), *flags])


def test_a_launcher_builds_its_config_from_a_file(tmp_path):
    cfg, config, action = build_env_cfg_from_args(_args(tmp_path))
    assert (cfg.num_envs, cfg.seed, cfg.max_episode_steps, cfg.sim_steps_per_control) == (
        3,
        5,
        7,
        2,
    )
    assert (cfg.sim_cfg.headless, cfg.sim_cfg.arena_space) == (True, 2.0)
    assert (config["num_envs"], action) == (3, {})
    env = BaseEnv(cfg)
    obs, _ = env.reset()
    assert env.single_action_space.shape == (6,)
    assert obs["robot", "qpos"].shape == (3, 6)
    assert env.robot.uid == "arm"
    env.close()


def test_typed_flags_and_the_modifier_beat_the_file(tmp_path):
    (tmp_path / "action.json").write_text('{"a": 1}')
    args = _args(tmp_path, "--num_envs", "2", "--action_config", str(tmp_path / "action.json"))
    cfg, _, action = build_env_cfg_from_args(args, lambda c: {**c, "max_episode_steps": 9})
    assert (cfg.num_envs, cfg.max_episode_steps, action) == (2, 9, {"a": 1})
    # A flag that equals its default was given all the same.
    cfg, _, _ = build_env_cfg_from_args(_args(tmp_path, "--num_envs", "1"))
    assert cfg.num_envs == 1


def test_mistakes_stand_at_their_path_in_the_file(tmp_path):
    def spoil(config):
        config["robot"]["fix_bas"] = True
        config["rigid_object"] = [{"uid": "cube", "attrs": {"mass": "heavy"}}]
        return config

    with pytest.raises(ConfigError, match=r"robot\.fix_bas: unknown key.*'fix_base'"):
        build_env_cfg_from_args(_args(tmp_path), spoil)
    with pytest.raises(ConfigError, match=r"^rigid_object\.0\.attrs\.mass: .*number"):
        config_to_cfg({"rigid_object": [{"uid": "cube", "attrs": {"mass": "heavy"}}]})
    with pytest.raises(ConfigError, match="--gym_config FILE"):
        build_env_cfg_from_args(_parser().parse_args([]))


def test_what_does_not_come_along_is_logged(caplog):
    group = {"uid": "heap", "folder_path": "things"}
    config = {"robot": {"fpath": "a.urdf"}, "headless": True, "rigid_object_group": [group]}
    nothing = {"soft_object": [], "cloth_object": None}
    config_to_cfg({**config, **nothing, "env": {"dataset": {"it": {}}}})
    assert [r.getMessage().split(":")[0] for r in caplog.records] == [
        "rigid_object_group",
        "env.dataset",
    ]


def test_functors_are_found_in_modules_of_the_users(tmp_path, monkeypatch):
    (tmp_path / "my_functors.py").write_text("def nudge(env, env_ids, by): pass\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    events = {"nudge": {"func": "nudge", "params": {"by": 1}}}
    cfg = config_to_cfg({"robot": {"fpath": "a"}, "env": {"events": events}}, ["my_functors"])
    assert cfg.events["nudge"].func == "my_functors:nudge"
