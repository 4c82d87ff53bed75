import argparse

import pytest

from embodichain.lab.gym.utils.gym_utils import (
    add_env_launcher_args_to_parser,
    build_env_cfg_from_args,
)


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


def test_config_files_of_others_say_what_to_use_instead():
    with pytest.raises(NotImplementedError, match="embodichain.make"):
        build_env_cfg_from_args(argparse.Namespace())
