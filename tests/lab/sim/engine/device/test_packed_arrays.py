"""Arrays of a device in one copy to the host."""

import numpy as np
import pytest
import torch

from embodichain.lab.sim.engine.device.packed_arrays import ArrayPacker, HostBuffers
from tests.helpers.warp_scene import DEVICE

HERE = torch.device(DEVICE)
TYPES = [torch.float32, torch.float64, torch.int32, torch.int64, torch.uint8, torch.bool]


def arrays():
    """One of each type, an empty one, and one whose numbers are not in order."""
    rng = np.random.default_rng(0)
    numbers = torch.from_numpy(rng.uniform(-3, 3, (5, 4)) * 1e3).to(HERE)
    found = [numbers.to(dtype) if dtype != torch.bool else numbers > 0 for dtype in TYPES]
    found[0][0, 0], found[1][0, 0], found[3][0, 0] = float("nan"), 1 / 3, 2**62 + 1
    return [*found, torch.zeros(5, 0, device=HERE), found[1].T[::2], found[5][:, 1]]


def received(buffers, slots, wait=True):
    return buffers.receive(slots, wait=wait)


def test_every_type_arrives_to_the_bit():
    packer, buffers = ArrayPacker(), HostBuffers[str](HERE)
    sent = arrays()
    slots = [packer.add(array) for array in sent]
    buffers.send(packer.pack(), "all")
    assert buffers.oldest == "all"
    for array, found in zip(sent, received(buffers, slots), strict=True):
        wanted = array.cpu().numpy()
        assert found.dtype == wanted.dtype and found.shape == wanted.shape
        assert np.ascontiguousarray(found).tobytes() == np.ascontiguousarray(wanted).tobytes()
    assert buffers.oldest is None


def test_a_live_array_is_that_of_the_moment():
    packer, buffers = ArrayPacker(), HostBuffers[None](HERE)
    array = torch.zeros(3, device=HERE)
    first = packer.add(array, live=True)
    array += 1.0
    second = packer.add(array, live=True)
    array += 1.0
    third = packer.add(array)
    buffers.send(packer.pack(), None)
    found = received(buffers, [first, second, third])
    assert [values.tolist() for values in found] == [[0.0] * 3, [1.0] * 3, [2.0] * 3]


def test_two_copies_are_on_their_way():
    """The third needs that the first was read, and what was read does not change any more."""
    packer, buffers = ArrayPacker(), HostBuffers[int](HERE)
    kept = []
    for number in range(5):
        slot = packer.add(torch.full((number + 1,), float(number), device=HERE))
        packed = packer.pack()
        if number < 2:
            assert not buffers.full
        else:
            with pytest.raises(ValueError, match="both buffers are in use"):
                buffers.send(packed, number)
            oldest = buffers.oldest
            (values,) = received(buffers, [slot._replace(shape=(oldest + 1,))])
            kept.append((oldest, values))
        buffers.send(packed, number)
    assert [oldest for oldest, _ in kept] == [0, 1, 2]
    assert [values.tolist() for _, values in kept] == [[0.0], [1.0] * 2, [2.0] * 3]


def test_nothing_to_pack_is_an_error():
    packer = ArrayPacker()
    packer.add(torch.ones(2, device=HERE))
    packer.clear()
    with pytest.raises(ValueError, match="no arrays to pack"):
        packer.pack()
