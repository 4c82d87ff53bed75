"""Environments as indices on the host, or as a mask on a device."""

import numpy as np
import pytest
import torch

from embodichain.lab.sim.engine.device.device_array import EnvMask
from embodichain.utils.array_types import host_ids
from embodichain.utils.arrays import as_env_ids


def test_env_ids_of_the_host_are_returned_as_they_are() -> None:
    ids = np.array([1, 3])
    assert host_ids(ids) is ids


def test_a_mask_is_refused_where_indices_are_needed() -> None:
    mask = EnvMask(torch.tensor([True, False, True]))
    assert as_env_ids(mask, 3) is mask
    with pytest.raises(TypeError, match="must be indices on the host here, got EnvMask"):
        host_ids(mask)
