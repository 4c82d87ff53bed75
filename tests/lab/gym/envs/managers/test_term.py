"""`Term`: its state is the arrays that it names."""

import numpy as np

from embodichain.lab.gym.envs.managers.term import Term


class Counts(Term):
    saved = ("steps", "_seen")

    def __init__(self) -> None:
        self.steps = np.zeros(3, np.int64)
        self._seen = np.zeros((3, 2), np.bool_)


def test_the_state_of_a_term_is_copies_of_the_arrays_it_names() -> None:
    term = Counts()
    view = term.steps
    # A private array is part of a term's state as a public one is.
    term.steps[1], term._seen[2, 0] = 7, True
    state = term.state_dict()
    term.steps[:], term._seen[:] = 9, True
    assert state["steps"].tolist() == [0, 7, 0]
    assert state["_seen"].tolist() == [[False, False], [False, False], [True, False]]
    term.load_state_dict(state)
    assert view.tolist() == [0, 7, 0], "arrays are changed in place: other terms may have views"
    assert term._seen.tolist() == state["_seen"].tolist()


def test_a_term_without_arrays_has_an_empty_state() -> None:
    term = Term()
    assert term.state_dict() == {}
    term.load_state_dict({})
