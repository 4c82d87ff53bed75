import pytest

from embodichain.utils.suggest import closest, did_you_mean, listing

TASKS = ["random_reach", "reach", "push_cube"]


def test_best_match_first_and_at_most_n():
    assert closest("reech", TASKS) == ["reach"]
    assert closest("random_rech", TASKS, n=3, cutoff=0.5) == ["random_reach", "reach"]


def test_case_does_not_count_and_spelling_is_kept():
    assert closest("UR10.URDF", ["ur5.urdf", "UR10.urdf"], cutoff=1.0) == ["UR10.urdf"]


def test_nothing_close_gives_nothing():
    assert closest("zebra", TASKS) == []
    assert closest("reach", []) == []
    assert did_you_mean("zebra", TASKS) == ""


def test_ties_keep_the_order_given_and_duplicates_count_once():
    assert closest("ax", ["ab", "ac", "ab"], n=3, cutoff=0.5) == ["ab", "ac"]


def test_did_you_mean_reads_on_after_a_sentence():
    assert "Unknown task 'pushcube'." + did_you_mean("pushcube", TASKS) == (
        "Unknown task 'pushcube'. Did you mean 'push_cube'?"
    )


@pytest.mark.parametrize(
    ("n", "cutoff", "message"),
    [(0, 0.6, "n must be at least 1, got 0"), (1, 1.5, r"cutoff must lie in \[0, 1\], got 1.5")],
)
def test_bad_arguments_are_named(n, cutoff, message):
    with pytest.raises(ValueError, match=message):
        closest("x", ["y"], n=n, cutoff=cutoff)


def test_a_few_names_are_listed_and_of_many_the_closest():
    assert listing([]) == "none"
    assert listing(TASKS, "reech") == "random_reach, reach, push_cube"
    many = [f"joint{i:02}" for i in range(40)] + ["wrist", "elbow"]
    assert listing(many, "wirst").startswith("wrist, ")
    assert listing(many, "wirst").endswith(", ... (42 in all)")
    assert listing(many, "wirst", "mine list").endswith(", ... (42 in all: `mine list`)")
    assert listing(many, "wirst").count(", ") == 3
    assert listing(many) == "joint00, joint01, joint02, ... (42 in all)"
