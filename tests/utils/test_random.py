"""Counter-based streams: independent of how many environments draw, and of who draws."""

import numpy as np
import pytest

from embodichain.utils.random import RandomStreams


@pytest.mark.parametrize("num_envs", [1, 3, 64])
def test_an_environment_draws_the_same_numbers_in_every_batch(num_envs):
    one, many = RandomStreams(7, 1), RandomStreams(7, num_envs)
    for _ in range(3):
        assert one.uniform("a", (3,)).tobytes() == many.uniform("a", (3,))[:1].tobytes()
        assert one.normal("b", (2, 2)).tobytes() == many.normal("b", (2, 2))[:1].tobytes()


def test_a_partial_draw_moves_only_those_who_draw():
    whole, parts = RandomStreams(0, 4), RandomStreams(0, 4)
    first = whole.uniform("s", (2,))
    some = parts.uniform("s", (2,), env_ids=np.array([1, 3]))
    np.testing.assert_array_equal(some, first[[1, 3]])
    rest = parts.uniform("s", (2,), env_ids=np.array([0, 2]))
    np.testing.assert_array_equal(rest, first[[0, 2]])
    np.testing.assert_array_equal(parts.uniform("s", (2,)), whole.uniform("s", (2,)))


def test_streams_names_seeds_and_environments_differ():
    draws = {
        (seed, name): RandomStreams(seed, 100).uniform(name, (50,)).ravel()
        for seed in (0, 1)
        for name in ("a", "b")
    }
    values = np.concatenate(list(draws.values()))
    assert len(np.unique(values)) == values.size


def test_uniform_is_uniform_within_its_range():
    values = RandomStreams(3, 1000).uniform("u", (1000,), -2.0, 6.0)
    assert values.min() >= -2.0 and values.max() < 6.0
    assert abs(values.mean() - 2.0) < 4 * (8 / np.sqrt(12)) / 1000
    counts = np.histogram(values, 64, (-2, 6))[0]
    chi2 = ((counts - values.size / 64) ** 2 / (values.size / 64)).sum()
    assert chi2 < 63 + 5 * np.sqrt(2 * 63)
    # Neither along an environment's own sequence nor across environments is there correlation.
    centred = values - 2.0
    lag = (centred[:, 1:] * centred[:, :-1]).mean() / values.var()
    across = (centred[1:] * centred[:-1]).mean() / values.var()
    assert abs(lag) < 5e-3 and abs(across) < 5e-3


def test_normal_has_unit_variance_and_normal_tails():
    values = RandomStreams(3, 1000).normal("n", (1000,))
    assert abs(values.mean()) < 4e-3 and abs(values.var() - 1) < 6e-3
    assert abs((np.abs(values) > 2).mean() - 0.0455) < 1e-3
    assert np.isfinite(values).all()


def test_state_continues():
    streams = RandomStreams(5, 3)
    streams.uniform("a", (2,)), streams.uniform("b")
    other = RandomStreams(0, 3)
    other.load_state_dict(streams.state_dict())
    assert other.uniform("a", (4,)).tobytes() == streams.uniform("a", (4,)).tobytes()
    assert other.uniform("new").tobytes() == streams.uniform("new").tobytes()


def test_numbers_computed_ahead_are_the_same_numbers():
    """Whole draws come from a block; partial draws, other widths and restores drop it."""
    ahead, plain = RandomStreams(4, 3), RandomStreams(4, 3)
    everyone = np.arange(3)
    script = [
        ("w", 2),
        ("w", 2),
        ("w", 3),
        ("some", 2),
        ("w", 2),
        ("load", 0),
        ("w", 2),
        ("bits", 2),
    ]
    for kind, width in script * 3:
        if kind == "w":
            got = ahead.uniform("s", (width,))
            want = plain.uniform("s", (width,), env_ids=everyone)
        elif kind == "some":
            got, want = (s.uniform("s", (width,), env_ids=np.array([0, 2])) for s in (ahead, plain))
        elif kind == "bits":
            got, want = ahead.bits("s", width), plain.bits("s", width)
        else:
            ahead.load_state_dict(ahead.state_dict())
            continue
        assert got.tobytes() == want.tobytes()


def test_an_environment_with_another_number_draws_what_that_one_draws():
    batch, few = RandomStreams(9, 6), RandomStreams(9, 2)
    few.uniform("a", (2,)), few.uniform("c", (2,), env_ids=np.array([1]))
    few.renumber(np.array([1]), np.array([5]))
    wanted = {name: batch.uniform(name, (2,)) for name in ("a", "b", "c")}
    for name, values in wanted.items():
        np.testing.assert_array_equal(few.uniform(name, (2,))[1], values[5])
    other = RandomStreams(0, 2)
    other.load_state_dict(few.state_dict())
    assert other.uniform("d", (2,)).tobytes() == few.uniform("d", (2,)).tobytes()
    np.testing.assert_array_equal(few.uniform("a", (2,))[1], batch.uniform("a", (2,))[5])
    few.reseed(9)
    np.testing.assert_array_equal(few.uniform("a", (2,)), wanted["a"][:2])
