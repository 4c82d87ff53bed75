"""`embodichain.make` refuses keys that only verbs read."""

import dataclasses

import gymnasium
import pytest

import embodichain
from embodichain.config.environments.unread_overrides import refuse_unread_overrides
from embodichain.config.keys.schema import RootCfg
from embodichain.utils.errors import ConfigError

READ = {"task", "sim", "num_envs", "seed", "device", "gym_config"}


@pytest.mark.parametrize(
    "line",
    [
        "viewer=web",
        "viewer.port=8090",
        "video=true",
        "record=none",
        "+record.every=2",
        "policy=zero",
    ],
)
def test_it_is_refused_by_name(line: str) -> None:
    key = line.lstrip("+").partition("=")[0]
    with pytest.raises(ConfigError, match=f"{key}: `embodichain.make` does not read it"):
        embodichain.make("cart_pole", overrides=[line])


def test_gymnasium_refuses_them_too() -> None:
    with pytest.raises(ConfigError, match=r"viewer: .* does not read it.*viewer=native"):
        gymnasium.make("embodichain/cart_pole-v0", overrides=["viewer=web"])
    with pytest.raises(ConfigError, match="episodes: `embodichain.make` does not read it"):
        gymnasium.make_vec("embodichain/cart_pole-v0", num_envs=2, overrides=["episodes=3"])


@pytest.mark.parametrize("name", [field.name for field in dataclasses.fields(RootCfg)])
def test_every_key_of_the_root_is_read_or_refused(name: str) -> None:
    if name in READ:
        refuse_unread_overrides([f"{name}=x"], "none")
        return
    with pytest.raises(ConfigError, match=f"{name}: "):
        refuse_unread_overrides([f"{name}=x"], "web")


def test_all_of_them_are_named() -> None:
    with pytest.raises(ConfigError) as raised:
        embodichain.make("cart_pole", overrides=["quiet=true", "algo.gamma=1", "max_steps=3"])
    assert [problem.path for problem in raised.value.problems] == [
        "quiet",
        "algo.gamma",
        "max_steps",
    ]


def test_what_an_environment_is_made_from_is_taken() -> None:
    lines = ["viewer=none", "sim.num_threads=1", "seed=1", "task.max_episode_steps=9"]
    with embodichain.make("cart_pole", overrides=lines) as env:
        assert env.max_episode_steps == 9
    refuse_unread_overrides(["viewer=native", "viewer.env=1"], "native")
    with pytest.raises(ConfigError, match=r"viewer\.host"):
        refuse_unread_overrides(["viewer.host=0.0.0.0"], "native")
