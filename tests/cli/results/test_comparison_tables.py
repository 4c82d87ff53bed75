"""Tables over seeds: the title says what is in the cells, a rate says of how many episodes."""

from pathlib import Path

import pytest

from embodichain.cli.pages.headline import seeds_result
from embodichain.cli.results.comparison_tables import comparison_table, describe_means
from embodichain.cli.studies.results import Factors, StudyResults
from embodichain.learning.evaluation.comparison import Group, TrainedRun
from embodichain.learning.evaluation.factors import FactorEffect, FactorRanking
from embodichain.learning.evaluation.statistics import over_seeds


def trained(seed: int, success: float, episodes: int) -> TrainedRun:
    numbers = {"eval_success": success, "train_seconds": 10.0}
    trials = {"eval_success": episodes}
    return TrainedRun(Path(f"run-{seed}"), ("reach", "ppo"), seed, numbers, trials, curves={})


@pytest.mark.parametrize(
    ("counts", "title"),
    [
        ([5, 8], "mean over seeds [95 % interval]"),
        ([1, 1], "one seed; an interval needs 5 seeds"),
        ([2, 2], "mean over 2 seeds (the value of each); an interval needs 5 seeds"),
        ([1, 3], "mean over 1 or 3 seeds (the value of each); an interval needs 5 seeds"),
        (
            [2, 5],
            "mean over seeds [95 % interval], or (the value of each seed); an interval needs "
            "5 seeds",
        ),
    ],
)
def test_the_title_says_what_the_cells_are(counts: list[int], title: str) -> None:
    estimates = [over_seeds([0.1 * i for i in range(count)]) for count in counts]
    assert describe_means([*estimates, None]) == title


def test_the_values_of_few_seeds_do_not_look_like_an_interval() -> None:
    runs = (trained(0, 0.0625, 100), trained(1, 0.25, 100))
    title, (row,) = comparison_table([Group("reach ppo", runs)])
    assert "mean over 2 seeds" in title and "95 % interval" not in title
    assert row["eval success"] == "15.6% (seeds 6.2, 25.0)"


def test_rates_say_of_how_many_episodes_they_are() -> None:
    groups = [
        Group("reach ppo", (trained(0, 1.0, 100),)),
        Group("reach ppo", (trained(1, 1.0, 4),)),
        Group("reach ppo", (trained(2, 1.0, 64), trained(3, 1.0, 1000))),
    ]
    _, rows = comparison_table(groups)
    assert [row["eval success"] for row in rows[:2]] == ["100.0%", "100.0%"]
    assert [row["eval episodes"] for row in rows] == ["100", "4", "64 to 1,000"]
    assert "episodes" not in rows[0]  # no rate of the training is known


def test_a_card_says_what_its_numbers_are() -> None:
    estimate = over_seeds([0.25, 0.0625], [16, 16])
    assert estimate is not None
    card = seeds_result("ppo: success", estimate, is_share=True)
    assert card.text == "15.6%"
    assert card.about == (
        "2 seeds",
        "value of each in percent: 25.0, 6.2",
        "an interval needs 5 seeds",
    )
    single = over_seeds([0.25])
    assert single is not None
    assert seeds_result("ppo: return", single).about == ("1 seed",)


def test_only_ranked_factors_are_in_their_table() -> None:
    ranked = FactorRanking((FactorEffect("friction", 9.0, 1, 0.001),), (), 100, ())
    unranked = FactorRanking((), (), 16, ("all 16 episodes failed: there is nothing to explain",))
    factors = (
        Factors("ppo", "reach", "clean", unranked, {}),
        Factors("ppo", "reach", "slippery", ranked, {}),
        Factors("sac", "reach", "slippery", None, {}),
    )
    empty = {"episodes": (), "arms": (), "across_tasks": (), "pairs": (), "notes": ()}
    results = StudyResults(study=None, factors=factors, **empty)  # type: ignore[arg-type]
    (row,) = results.ranked_factors()
    assert row["arm"] == "ppo" and row["variation"] == "slippery" and row["factor"] == "friction"
    assert "note" not in row  # no row has one
