"""Observations: declared order, nesting, clip then scale, groups, and shapes that are refused."""

import pytest
import torch

from embodichain.lab.gym.envs.cfg import ObservationCfg
from embodichain.lab.gym.envs.managers.term import Term
from embodichain.utils.errors import ConfigError


def constant(env, obs, value: float, width: int = 2):
    return torch.full((env.num_envs, width), value)


def term(value: float, **fields) -> ObservationCfg:
    width = fields.pop("width", 2)
    return ObservationCfg(func=constant, params={"value": value, "width": width}, **fields)


def test_entries_nest_and_keep_their_order(make) -> None:
    env = make(
        observations={"b": term(1.0, name="x/y/z"), "a": term(2.0), "c": term(3.0, name="x/w")}
    )
    obs, _ = env.reset()
    assert obs["x", "y", "z"].tolist() == [[1.0, 1.0]] * 3
    manager = env.observation_manager
    assert manager.group_terms() == ("x/y/z", "a", "x/w")
    assert manager.flatten(obs).tolist() == [[1.0, 1.0, 2.0, 2.0, 3.0, 3.0]] * 3
    assert env.observation_space["x"]["y"]["z"].shape == (3, 2)


def test_clip_comes_before_scale(make) -> None:
    env = make(
        observations={
            "a": term(5.0, clip=[-1, 2], scale=10.0),
            "b": term(1.0, scale=[2.0, 3.0]),
        }
    )
    obs, _ = env.reset()
    assert obs["a"][0].tolist() == [20.0, 20.0]
    assert obs["b"][0].tolist() == [2.0, 3.0]


def test_groups_hold_exactly_their_terms(make) -> None:
    env = make(
        observations={"a": term(1.0), "b": term(2.0, group="critic", width=1), "c": term(3.0)}
    )
    obs, _ = env.reset()
    manager = env.observation_manager
    assert manager.groups == ("policy", "critic")
    assert manager.flatten(obs, "critic").tolist() == [[2.0]] * 3
    assert manager.flatten(obs).shape == (3, 4)
    with pytest.raises(ValueError, match="there are: policy, critic. Did you mean 'critic'?"):
        manager.flatten(obs, "critics")


def test_modify_replaces_an_entry_and_stands_once_in_the_vector(make) -> None:
    def double(env, data):
        return 2.0 * data

    env = make(
        observations={
            "a": term(1.5),
            "more": ObservationCfg(func=double, mode="modify", name="a"),
            "q": ObservationCfg(func=double, mode="modify", name="robot/qpos"),
        }
    )
    obs, _ = env.reset()
    assert obs["a"][0].tolist() == [3.0, 3.0]
    assert torch.equal(obs["robot", "qpos"], 2.0 * env.robot.get_qpos())
    assert env.observation_manager.group_terms() == ("a", "robot/qpos")
    assert env.observation_manager.flatten(obs).shape == (3, 8)


def test_matrices_and_other_types_are_flattened(make) -> None:
    env = make(
        observations={
            "pose": ObservationCfg(func="get_object_pose", params={"entity_cfg": {"uid": "goal"}}),
            "flag": ObservationCfg(func=lambda env, obs: torch.ones(3, dtype=torch.bool)),
            "wide": ObservationCfg(func=lambda env, obs: torch.ones(3, 1, dtype=torch.float64)),
        }
    )
    obs, _ = env.reset()
    assert obs["pose"].shape == (3, 4, 4)
    assert obs["wide"].dtype == torch.float32
    flat = env.observation_manager.flatten(obs)
    assert (flat.shape, flat.dtype) == ((3, 18), torch.float32)


@pytest.mark.parametrize(
    ("func", "part"),
    [
        (lambda env, obs: torch.zeros(2, 3), "'bad' must return a tensor of shape (3, ...)"),
        (lambda env, obs: torch.tensor(1.0), "got ()"),
        (lambda env, obs: None, "got NoneType"),
    ],
)
def test_wrong_shapes_name_the_term(make, func, part) -> None:
    with pytest.raises(ValueError) as caught:
        make(observations={"bad": ObservationCfg(func=func)})
    assert part in str(caught.value)


def test_a_scale_of_another_width_names_the_term(make) -> None:
    with pytest.raises(ConfigError, match=r"observations\.a\.scale: has 3 values"):
        make(observations={"a": term(1.0, scale=[1.0, 2.0, 3.0])})


class HeatImage(Term):
    """Float32 pixels, which only the mark makes an image."""

    reads_images = True

    def __init__(self, env) -> None:
        self._shape = (env.num_envs, 1, 4, 5)

    def __call__(self, env, obs) -> torch.Tensor:
        return torch.full(self._shape, 20.0)


def test_images_are_what_a_term_marks_and_what_has_pixels(make) -> None:
    def pixels(env, obs) -> torch.Tensor:
        return torch.zeros(env.num_envs, 3, 4, 5, dtype=torch.uint8)

    def matrices(env, obs) -> torch.Tensor:
        return torch.zeros(env.num_envs, 3, 4, 5)

    env = make(
        observations={
            "marked": ObservationCfg(func=HeatImage, group="images"),
            "pixels": ObservationCfg(func=pixels, group="images"),
            "matrices": ObservationCfg(func=matrices),
        }
    )
    obs, _ = env.reset()
    manager = env.observation_manager
    assert manager.image_terms("images") == ("marked", "pixels")
    assert manager.image_terms() == ()
    assert manager.flatten(obs).shape == (3, 60)
    assert obs["marked"].shape == (3, 1, 4, 5)
    with pytest.raises(ValueError, match="'images' is not a flat vector: marked, pixels are"):
        manager.flatten(obs, "images")


def test_classes_are_reset(make) -> None:
    log = []

    class Count:
        def __init__(self, env) -> None:
            pass

        def __call__(self, env, obs):
            return torch.zeros(env.num_envs, 1)

        def reset(self, env_ids) -> None:
            log.append(None if env_ids is None else env_ids.tolist())

    env = make(observations={"a": ObservationCfg(func=Count)})
    env.reset()
    env.reset(options={"reset_ids": [2]})
    assert log == [None, [2]]


def test_an_unknown_term_is_an_error_at_build(make) -> None:
    with pytest.raises(ConfigError, match="Did you mean 'last_action'?"):
        make(observations={"a": ObservationCfg(func="last_actions")})


def test_modifying_what_is_not_there_is_an_error_at_build(make) -> None:
    with pytest.raises(ConfigError) as caught:
        make(
            observations={
                "a": term(1.0),
                "b": ObservationCfg(func=lambda env, data: data, mode="modify", name="robot/qpoz"),
            }
        )
    assert caught.value.problems[0].path == "observations.b.name"
    assert "Did you mean 'robot/qpos'?" in str(caught.value)
