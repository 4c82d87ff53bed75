"""`ObservationStore`: what it gives back, and how little it keeps."""

import numpy as np
import pytest
import torch

from embodichain.lab.gym.envs.observation import Observation, ObservationLayout
from embodichain.recording.demos.observation_store import ObservationStore
from embodichain.utils.tensor_mapping import TensorMapping

N, SIDE = 4, 200
"""Environments, and pixels of an image that is large enough for the file."""


@pytest.fixture
def make():
    """Returns observations of four environments that a number determines."""
    draw = np.random.default_rng(0)
    first = TensorMapping(
        {
            "qpos": torch.zeros(N, 3),
            "grid": torch.zeros(N, 2, 2),
            "count": torch.zeros(N, dtype=torch.int64),
            "front": torch.zeros(N, 3, SIDE, SIDE, dtype=torch.uint8),
        }
    )
    layout = ObservationLayout(first, {}, N, [("front",)])

    def build(number: int) -> Observation:
        obs = Observation(layout, layout.empty())
        obs.rows[:] = draw.normal(size=obs.rows.shape)
        obs.others["count",] = torch.full((N,), number)
        pixels = draw.integers(0, 256, (N, 3, SIDE, SIDE), np.uint8)
        obs.others["front",] = torch.from_numpy(pixels)
        return obs

    return build


def rows(observations, env):
    """What a policy in one environment saw: name to an array with time first."""
    columns = observations[0].layout.columns
    found = {
        "/".join(p): np.stack([o.rows[env, c] for o in observations]) for p, c in columns.items()
    }
    found["grid"] = found["grid"].reshape(-1, 2, 2)
    for name in ("count", "front"):
        found[name] = np.stack([o.others[name,].numpy()[env] for o in observations])
    return found


@pytest.mark.parametrize("env", [0, N - 1])
def test_an_episode_is_taken_with_its_last_observation(make, env):
    made = [make(number) for number in range(7)]
    with ObservationStore() as store:
        for number, obs in enumerate(made[:6]):
            store.add(number, obs)
        found = store.take(env, 2, 5, made[6])
    expected = rows([*made[2:5], made[6]], env)
    assert found.keys() == expected.keys()
    for name, values in expected.items():
        assert found[name].dtype == values.dtype and np.array_equal(found[name], values), name


def test_places_in_the_file_are_used_again(make):
    with ObservationStore() as store:
        seen = []
        for number in range(40):
            seen.append(make(number))
            store.add(number, seen[-1])
            store.forget(number - 3)
            first = max(0, number - 3)
            found = store.take(1, first, number, seen[-1])
            expected = rows([*seen[first:number], seen[-1]], 1)
            assert np.array_equal(found["front"], expected["front"])
            assert np.array_equal(found["qpos"], expected["qpos"])
        # It has no name in any folder.
        store._file.seek(0, 2)
        size = store._file.tell()
    image = N * 3 * SIDE * SIDE
    assert 4 * image <= size <= 6 * image


def test_what_is_taken_is_the_callers(make):
    made = make(0), make(1)
    with ObservationStore() as store:
        store.add(0, made[0])
        once = store.take(0, 0, 1, made[1])
        for values in once.values():
            values[:] = 0
        again = store.take(0, 0, 1, made[1])
    assert np.array_equal(again["qpos"][1], made[1].rows[0, made[1].layout.columns["qpos",]])
    assert again["front"].any() and again["count"].tolist() == [0, 1]
