"""`DeviceStreams` against `RandomStreams`, on a GPU or else on Warp's CPU device."""

import numpy as np
import pytest
import torch
import warp as wp

from embodichain.lab.sim.engine.device.device_array import DeviceArray, EnvMask
from embodichain.lab.sim.engine.warp.device_streams import DeviceStreams
from embodichain.utils.random import RandomStreams, constant

N = 5
DEVICE = "cuda" if torch.cuda.is_available() else "cpu"


def both(seed):
    return RandomStreams(seed, N), DeviceStreams(seed, N, DEVICE)


def captured(draw):
    """A draw, and a function that repeats it."""
    if DEVICE == "cpu":
        with wp.ScopedCapture(device="cpu") as capture:
            found = draw()
        return found, lambda: wp.capture_launch(capture.graph)
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        found = draw()
    return found, graph.replay


def mask_of(*ids):
    mask = torch.zeros(N, dtype=torch.bool, device=DEVICE)
    mask[list(ids)] = True
    return EnvMask(mask)


def same(host, device):
    assert device.shape == host.shape and device.dtype == host.dtype
    assert device.host().tobytes() == host.tobytes()


BOUNDS = {
    "numbers": ((3,), -0.1, 7.3),
    "integers": ((), 0, np.int64(4)),
    "number and list": ((3,), 0.1, [1.0, 2.0, 3.5]),
    "immutable": ((3,), constant([0.1, -2.0, 3.0]), constant([0.7, 9.0, 3.1])),
    "mutable": ((3,), np.array([0.1, -2.0, 3.0]), np.array([0.7, 9.0, 3.1])),
    "one for all": ((2, 3), constant([0.1]), constant([[0.3], [0.9]])),
    "environments": ((2,), np.arange(2.0 * N).reshape(N, 2) / 7.0, 11.1),
}


@pytest.mark.parametrize("seed", [0, 7, -3])
@pytest.mark.parametrize("bounds", BOUNDS)
def test_uniform_numbers_are_those_of_the_host_to_the_bit(bounds, seed):
    shape, low, high = BOUNDS[bounds]
    host, device = both(seed)
    for name, width in (("a", 3), ("b", 40), ("a", 1), ("a", 3)):
        same(host.uniform(name, (width,)), device.uniform(name, (width,)))
        same(host.uniform(name, shape, low, high), device.uniform(name, shape, low, high))


def test_bounds_may_be_on_the_device_and_change():
    host, device = both(1)
    low, high = np.array([0.1, 0.2]), np.array([1.0, 2.0])
    on_device = DeviceArray(torch.from_numpy(high.copy()).to(DEVICE))
    for factor in (1.0, 3.0):
        high *= factor
        on_device.tensor *= factor
        same(host.uniform("a", (2,), low, high), device.uniform("a", (2,), low, on_device))
        same(host.uniform("a", (2,), low, high), device.uniform("a", (2,), low, high))


def test_normal_numbers_are_those_of_the_host():
    host, device = both(2)
    for shape in ((), (2000,), (2, 3)):
        wanted, found = host.normal("n", shape), device.normal("n", shape)
        assert found.shape == wanted.shape
        # Logarithm and cosine of other libraries: some units in the last place.
        np.testing.assert_allclose(found.host(), wanted, rtol=2e-15, atol=1e-15)
    same(host.uniform("n"), device.uniform("n"))


def test_only_environments_of_a_mask_advance():
    host, device = both(4)
    script = np.random.default_rng(0)
    for _ in range(40):
        ids = np.flatnonzero(script.random(N) < 0.5)
        name, width = "ab"[script.integers(2)], int(script.integers(1, 4))
        found = device.uniform(name, (width,), -1.0, 2.0, mask_of(*ids))
        assert found.shape == (N, width)
        wanted = host.uniform(name, (width,), -1.0, 2.0, ids)
        np.testing.assert_array_equal(found.host()[ids], wanted)
        normal = device.normal(name, (width,), mask_of(*ids)).host()[ids]
        np.testing.assert_allclose(normal, host.normal(name, (width,), ids), rtol=2e-15, atol=1e-15)
    others = device.uniform("a", (), 0.0, 1.0, mask_of())
    same(host.uniform("a"), others)


def test_states_are_exchanged_with_the_host():
    host, device = both(5)
    for streams in (host, device):
        streams.uniform("a", (2,)), streams.normal("b")
    given, known = device.state_dict(), host.state_dict()
    assert given["seed"] == known["seed"] and given["counters"].keys() == known["counters"].keys()
    for name, counters in known["counters"].items():
        assert given["counters"][name].dtype == np.uint64
        np.testing.assert_array_equal(given["counters"][name], counters)

    device.uniform("a", env_ids=mask_of(1)), device.uniform("only here")
    device.renumber(np.array([2, 4]), np.array([70, 3]))
    other_host, other_device = both(0)
    other_host.load_state_dict(device.state_dict())
    other_device.uniform("a"), other_device.uniform("late")
    other_device.load_state_dict(other_host.state_dict())
    for name in ("a", "b", "only here", "late", "new"):
        wanted = other_host.uniform(name, (3,))
        same(wanted, device.uniform(name, (3,)))
        same(wanted, other_device.uniform(name, (3,)))


def test_a_state_is_a_copy():
    device = DeviceStreams(5, N, DEVICE)
    first, state, saved = device.uniform("a"), device.state_dict(), device.save_counters()
    device.uniform("a")
    np.testing.assert_array_equal(state["counters"]["a"], np.ones(N))
    device.rewind(saved, mask_of(*range(N)))
    np.testing.assert_array_equal(device.state_dict()["counters"]["a"], np.ones(N))
    device.load_state_dict({"seed": 5, "counters": {}})  # an older state, without numbers
    np.testing.assert_array_equal(device.uniform("a").host(), first.host())


@pytest.mark.parametrize("streams", [2, 150])
def test_environments_of_a_mask_are_rewound(streams):
    host, device = both(6)
    names = [f"stream {i}" for i in range(streams)]
    for name in names[: streams // 3 + 1]:
        host.uniform(name), device.uniform(name)
    saved = host.save_counters(), device.save_counters()
    for name in names:  # most are newer than what was saved
        host.uniform(name, (2,)), device.uniform(name, (2,))
    host.rewind(saved[0], np.array([False, True, False, True, True]))
    device.rewind(saved[1], mask_of(1, 3, 4))
    for name in names:
        same(host.uniform(name), device.uniform(name))


def test_a_seed_restarts_all_streams():
    host, device = both(0)
    device.uniform("a", (4,)), device.renumber(np.array([0]), np.array([9]))
    host.reseed(8), device.reseed(np.int64(8))
    assert device.seed == 8
    same(host.uniform("a"), device.uniform("a"))
    with pytest.raises(ValueError, match="one integer"):
        device.reseed([1, 2])


def test_a_captured_draw_continues_from_a_loaded_state():
    host, device = both(3)
    mask = mask_of(0, 2)
    ids = np.array([0, 2])
    low, high = constant([0.1, 0.2]), constant([3.0, 0.3])
    device.uniform("a", (2,), low, high, mask)
    found, repeat = captured(lambda: device.uniform("a", (2,), low, high, mask))
    device.load_state_dict(host.state_dict())
    for seed in (3, 4):
        host.reseed(seed), device.reseed(seed)
        for _ in range(3):
            repeat()
            wanted = host.uniform("a", (2,), low, high, ids)
            np.testing.assert_array_equal(found.host()[ids], wanted)
    mask.mask[1] = True  # the mask is read by the device at every launch
    repeat()
    np.testing.assert_array_equal(device.state_dict()["counters"]["a"], [8, 2, 8, 0, 0])


def test_what_cannot_be_captured_is_refused(monkeypatch):
    device = DeviceStreams(3, N, DEVICE)
    device.uniform("a", (2,), constant([0, 0]), constant([1, 1]))
    # As while a CUDA graph is captured, which needs a card.
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "is_current_stream_capturing", lambda: True)
    device.uniform("a", (2,), 0.0, 2.0)
    with pytest.raises(RuntimeError, match="keys of random stream 'new'"):
        device.uniform("new")
    with pytest.raises(RuntimeError, match="bounds of random stream 'a'"):
        device.uniform("a", (2,), np.zeros(2), 1.0)


def test_indices_are_refused():
    with pytest.raises(TypeError, match="EnvMask, got ndarray"):
        DeviceStreams(0, N, DEVICE).uniform("a", env_ids=np.array([1]))
