"""Arrays of a step travel as one array of bytes."""

import pickle

import numpy as np
import pytest

from embodichain.lab.gym.shards.splitting import numbers_in_shard, split_batch
from embodichain.lab.gym.shards.step_tables import StepTable, join_rows


def test_arrays_come_back() -> None:
    arrays = {
        ("obs",): np.arange(6, dtype=np.float32).reshape(2, 3)[:, ::-1],
        ("info", "done"): np.array([True, False]),
        ("image",): np.arange(10, dtype=np.uint8).reshape(2, 5),
        ("none",): np.zeros((0, 4)),
        ("count",): np.array([2**40, -1]),
    }
    table = pickle.loads(pickle.dumps(StepTable.of(arrays, {"a": 1})))
    assert table.values == {"a": 1} and table.data.dtype == np.uint8
    assert len(table.data) == 24 + 8 + 16 + 0 + 16  # each a multiple of eight
    found = table.arrays()
    assert list(found) == list(arrays)
    for path, array in arrays.items():
        assert found[path].dtype == array.dtype and np.array_equal(found[path], array)


def test_rows_of_shards_are_joined() -> None:
    parts = [{("a",): np.array([[1.0], [2.0]])}, {("a",): np.array([[3.0]])}]
    assert join_rows(parts)["a",].tolist() == [[1.0], [2.0], [3.0]]
    with pytest.raises(ValueError, match="info/b is in some shards of the batch, and not in"):
        join_rows([{("info", "b"): np.zeros(1)}, {}])


def test_a_batch_is_split_evenly() -> None:
    assert split_batch(10, 4) == [3, 3, 2, 2]
    assert split_batch(4, 4) == [1, 1, 1, 1]
    assert numbers_in_shard([0, 3, 5, 6, 9], 3, 3) == [0, 2]
