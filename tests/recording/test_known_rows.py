"""Rows that are followed through writes are those that writing them at once gives."""

import numpy as np
import pytest

from embodichain.lab.sim.engine.base import Write
from embodichain.recording.hashing import RowHash
from embodichain.recording.known_rows import KnownRows

N = 5
LAYOUT = {
    "time": slice(0, 1),
    "qpos": slice(1, 4),
    "qvel": slice(4, 6),
    "ctrl": slice(6, 10),
    "mocap_pos": slice(10, 16),
}
PLACES = [
    ("ctrl", slice(None)),
    ("ctrl", slice(0, 2)),  # shares columns with the first
    ("ctrl", np.array([3])),
    ("mocap_pos", slice(0, 3)),
    ("mocap_pos", np.array([1, 5])),  # shares one with the fourth
    ("qpos", slice(None)),
    ("mocap_pos", slice(3, 6)),
]


def known_and_rows(draw):
    known, rows = KnownRows(LAYOUT), draw.normal(size=(N, 16))
    known.take(rows.copy())
    return known, rows


@pytest.mark.parametrize("seed", range(20))
def test_writes_to_places_that_share_columns(seed):
    draw = np.random.default_rng(seed)
    known, rows = known_and_rows(draw)
    row_hash = RowHash(16)
    for _ in range(60):
        number = int(draw.integers(len(PLACES)))
        field, columns = PLACES[number]
        where = np.arange(16)[LAYOUT[field]][columns]
        ids = None if draw.random() < 0.7 else np.flatnonzero(draw.random(N) < 0.5)
        values = draw.normal(size=(N if ids is None else len(ids), len(where)))
        lent = values.copy()
        known.write(number, Write("state", field, ids, columns, lent), ids, lent)
        rows[np.ix_(np.arange(N) if ids is None else ids, where)] = values
        what = draw.integers(7)
        some = np.array([0, 3])
        if what == 0:
            np.testing.assert_array_equal(known.whole(), rows)
        elif what == 1:
            np.testing.assert_array_equal(known.of(some), rows[some])
        elif what == 2:
            np.testing.assert_array_equal(known.inputs, rows[:, 6:])
        elif what == 3:  # the memory of what was written goes
            known.settle()
            lent[:] = np.nan
        elif what == 4:
            moved = draw.normal(size=(N, 6))
            known.returned(moved)
            rows[:, :6] = moved
        elif what == 5:
            known.take(rows.copy())
        expected = row_hash(rows, [(0, 16)])
        np.testing.assert_array_equal(known.hashes(row_hash), expected)
    np.testing.assert_array_equal(known.whole(), rows)


def test_more_columns_in_use_keep_what_was_written():
    known = KnownRows(LAYOUT)
    known.columns([(0, 10)])
    rows = np.random.default_rng(0).normal(size=(N, 16))
    rows[:, 10:] = 0
    known.take(rows[:, :10].copy())
    ctrl = np.full((N, 4), 2.0)
    known.write(0, Write("state", "ctrl", None, slice(None), ctrl), None, ctrl)
    known.columns([(0, 16)])
    rows[:, 6:10] = 2.0
    np.testing.assert_array_equal(known.whole(), rows)
    row_hash = RowHash(16)
    np.testing.assert_array_equal(known.hashes(row_hash), row_hash(rows, [(0, 16)]))


@pytest.mark.parametrize("shape", [(N, 3), (N - 1, 4), (N, 5)])
def test_a_write_of_too_many_or_too_few_values_is_refused(shape):
    known, _ = known_and_rows(np.random.default_rng(0))
    values = np.zeros(shape)
    with pytest.raises(ValueError, match=r"\(5, 4\) were announced"):
        known.write(0, Write("state", "ctrl", None, slice(None), values), None, values)
