import numpy as np
import pytest

from embodichain.recording.format.messages.hashing import row_hashes

ROWS = np.random.default_rng(0).normal(size=(4, 30))


@pytest.mark.parametrize("value", [1.5, 0.0, np.nan, -1e300])
def test_any_single_flipped_bit_changes_the_hash(value):
    row = np.full((1, 30), value)
    row[0, ::3] = ROWS[0, ::3]
    flips = np.repeat(row, 30 * 64, axis=0)
    words = flips.view(np.uint64)
    index = np.arange(30 * 64)
    words[index, index // 64] ^= np.uint64(1) << (index % 64).astype(np.uint64)
    assert len(np.unique(row_hashes(flips))) == 30 * 64
    assert row_hashes(row)[0] not in row_hashes(flips)


def test_changed_signs_do_not_cancel():
    negated = ROWS.copy()
    negated[:, 3:7] *= -1.0
    assert (row_hashes(negated) != row_hashes(ROWS)).all()


def test_swapped_columns_and_rows_differ():
    swapped = ROWS.copy()
    swapped[:, [0, 1]] = swapped[:, [1, 0]]
    assert (row_hashes(swapped) != row_hashes(ROWS)).all()


def test_a_row_hashes_alike_in_any_batch():
    whole = row_hashes(ROWS)
    assert [int(row_hashes(ROWS[i : i + 1])[0]) for i in range(4)] == whole.tolist()


def test_the_hash_is_the_documented_one():
    words = ROWS.view(np.uint64)

    def mix(z):
        z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) % 2**64
        z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) % 2**64
        return z ^ (z >> 31)

    total = 0
    for j, word in enumerate(int(w) for w in words[2]):
        odd = mix((j + 1) * 0x9E3779B97F4A7C15 % 2**64) | 1
        total = (total + odd * (word ^ (word >> 32))) % 2**64
    assert int(row_hashes(ROWS)[2]) == mix(total)
