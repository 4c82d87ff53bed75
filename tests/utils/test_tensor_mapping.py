"""`TensorMapping`: the access of a TensorDict on nested tensors, without its import."""

from collections.abc import Mapping

import pytest
import torch
from tensordict import TensorDict

from embodichain.utils.tensor_mapping import TensorMapping, leaves_of


@pytest.fixture
def obs():
    qpos, image = torch.arange(6.0).reshape(3, 2), torch.zeros(3, 4, 4, dtype=torch.uint8)
    return TensorMapping({"robot": {"qpos": qpos}, "camera": {"left": {"rgb": image}}})


def test_entries_by_name_and_by_path(obs):
    assert isinstance(obs, Mapping) and isinstance(obs["robot"], Mapping)
    assert obs["robot"]["qpos"] is obs["robot", "qpos"]
    assert obs["camera", "left", "rgb"].shape == (3, 4, 4)
    assert "robot" in obs and ("robot", "qpos") in obs and ("robot", "qvel") not in obs
    assert obs.get("nothing") is None and obs.get(("robot", "qpos")) is obs["robot", "qpos"]
    with pytest.raises(KeyError):
        obs["robot", "qvel"]


def test_names_of_one_level_and_of_all(obs):
    assert list(obs) == list(obs.keys()) == ["robot", "camera"] and len(obs) == 2
    leaves = [("robot", "qpos"), ("camera", "left", "rgb")]
    assert list(obs.keys(True, True)) == leaves
    assert ("camera", "left") in obs.keys(True)
    assert [key for key, _ in obs.items(True, True)] == leaves
    assert [path for path, _ in leaves_of(obs)] == leaves
    assert [tuple(leaf.shape) for leaf in obs.values(True, True)] == [(3, 2), (3, 4, 4)]


def test_the_batch_is_the_first_dimension(obs):
    assert obs.batch_size == obs.shape == (3,) and obs["robot"].batch_size == (3,)
    assert obs.device == torch.device("cpu") and TensorMapping().device is None


@pytest.mark.parametrize(
    "rows", [slice(0, 2), [0, 1], torch.tensor([0, 1]), torch.tensor([True, True, False])]
)
def test_rows_of_every_tensor(obs, rows):
    part = obs[rows]
    assert part.batch_size == (2,)
    assert part["robot", "qpos"].tolist() == [[0.0, 1.0], [2.0, 3.0]]
    assert part["camera", "left", "rgb"].shape == (2, 4, 4)
    assert obs[1]["robot", "qpos"].tolist() == [2.0, 3.0]


def test_entries_are_set_and_removed(obs):
    obs["goal"] = torch.ones(3, 1)
    obs["sensor", "feet", "force"] = torch.ones(3, 4)
    obs.set(("robot", "qvel"), torch.ones(3, 2))
    obs["other"] = {"deep": {"er": torch.zeros(3)}}
    assert obs["sensor"]["feet"]["force"].shape == (3, 4)
    assert list(obs["robot"]) == ["qpos", "qvel"] and obs["other", "deep", "er"].shape == (3,)
    del obs["robot", "qvel"]
    assert list(obs["robot"]) == ["qpos"] and obs.pop("goal").shape == (3, 1)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (torch.zeros(2, 1), r"'bad' must have shape \(3, \.\.\.\), got \(2, 1\)"),
        (1.0, "'bad' must be a tensor, got float"),
    ],
)
def test_what_does_not_fit_is_refused(obs, value, message):
    with pytest.raises(ValueError, match=message):
        obs["bad"] = value


def test_copies(obs):
    clone, shallow = obs.clone(), obs.clone(recurse=False)
    obs["robot", "qpos"][0, 0] = 9.0
    assert clone["robot", "qpos"][0, 0] == 0.0 and shallow["robot", "qpos"][0, 0] == 9.0
    shallow["robot", "more"] = torch.zeros(3)
    assert ("robot", "more") not in obs
    assert obs.to(torch.float64)["robot", "qpos"].dtype == torch.float64
    assert (
        obs.cpu()["robot", "qpos"] is not None and not obs.detach()["robot", "qpos"].requires_grad
    )


def test_a_tensordict_is_made_and_taken(obs):
    made = obs.to_tensordict()
    assert isinstance(made, TensorDict) and made.batch_size == (3,)
    assert made["robot", "qpos"] is obs["robot", "qpos"]
    back = TensorMapping(made)
    assert list(back.keys(True, True)) == list(obs.keys(True, True))
    assert obs.to_dict()["camera"]["left"]["rgb"] is obs["camera", "left", "rgb"]


def test_repr_names_shapes(obs):
    assert "robot/qpos: (3, 2) torch.float32" in repr(obs)
