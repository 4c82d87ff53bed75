"""Which factor breaks a policy: planted ones are found, separated ones are said."""

from itertools import pairwise

import numpy as np
import pytest
import statsmodels.api as sm

from embodichain.learning.evaluation.factors import rank_factors, success_by_factor

EPISODES = 256


def drawn(rng):
    return {
        "friction": rng.uniform(0.3, 1.2, EPISODES),
        "mass": rng.uniform(0.1, 0.5, EPISODES),
        "light": rng.normal(0, 1, EPISODES),
        "offset": rng.uniform(-0.1, 0.1, EPISODES),
        "delay": rng.integers(0, 3, EPISODES).astype(float),
    }


def outcomes(rng, log_odds):
    return rng.random(EPISODES) < 1 / (1 + np.exp(-log_odds))


@pytest.mark.parametrize(
    ("planted", "log_odds"),
    [
        ("friction", lambda f: 1 + 4 * (f["friction"] - 0.75)),
        pytest.param("offset", lambda f: 1.5 - 600 * f["offset"] ** 2, id="both sides fail"),
        pytest.param("delay", lambda f: 1.5 - 1.2 * f["delay"], id="three values"),
    ],
)
def test_a_planted_factor_is_first(planted, log_odds):
    first = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        factors = drawn(rng)
        ranking = rank_factors(factors, outcomes(rng, log_odds(factors)))
        first.append(ranking.effects[0].name)
    assert first.count(planted) >= 19


def test_without_a_planted_factor_small_p_values_are_as_rare_as_they_say():
    p_values = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        factors = drawn(rng)
        ranking = rank_factors(factors, rng.random(EPISODES) < 0.5)
        p_values += [effect.p_value for effect in ranking.effects]
    assert 0.01 < np.mean(np.array(p_values) < 0.05) < 0.1


def test_two_factors_that_act_together_are_an_interaction():
    rng = np.random.default_rng(3)
    factors = drawn(rng)
    friction = (factors["friction"] - 0.75) / 0.26
    mass = (factors["mass"] - 0.3) / 0.115
    ranking = rank_factors(factors, outcomes(rng, 2 * friction * mass))
    assert set(ranking.interactions[0].names) == {"friction", "mass"}
    low, high = ranking.interactions[0].interval
    assert low > 0
    assert {effect.name for effect in ranking.effects[:2]} == {"friction", "mass"}


def test_numbers_are_those_of_a_model_written_by_hand():
    rng = np.random.default_rng(4)
    friction = rng.integers(0, 2, EPISODES).astype(float)
    success = outcomes(rng, 0.3 + friction)
    effect = rank_factors({"friction": friction}, success).effects[0]
    standard = (friction - friction.mean()) / friction.std()
    model = sm.Logit(success.astype(float), sm.add_constant(standard)).fit(disp=False)
    assert effect.odds_ratio == pytest.approx(np.exp(model.params[1]))
    assert effect.odds_interval == pytest.approx(tuple(np.exp(model.conf_int()[1])), rel=1e-6)
    assert effect.deviance == pytest.approx(2 * (model.llf - model.llnull))
    assert effect.p_value == pytest.approx(model.llr_pvalue)


def test_complete_separation_is_said_and_has_no_interval():
    rng = np.random.default_rng(5)
    factors = drawn(rng)
    ranking = rank_factors(factors, factors["offset"] > 0.02)
    assert ranking.effects[0].name == "offset"
    assert all(effect.odds_interval is None for effect in ranking.effects)
    assert ranking.interactions == ()
    assert any(note.startswith("offset separates success from failure") for note in ranking.notes)


def test_what_is_left_out_is_said():
    rng = np.random.default_rng(6)
    offset = rng.uniform(-1, 1, EPISODES)
    rare = np.where(rng.random(EPISODES) < 0.9, np.nan, offset)
    some = np.where(rng.random(EPISODES) < 0.1, np.nan, rng.normal(size=EPISODES))
    factors = {
        "offset": offset,
        "twice": 2 * offset,
        "constant": np.ones(EPISODES),
        "rare": rare,
        "some": some,
    }
    ranking = rank_factors(factors, rng.random(EPISODES) < 0.5)
    assert {effect.name for effect in ranking.effects} == {"offset", "some"}
    text = "\n".join(ranking.notes)
    assert "twice follows from the factors before it" in text
    assert "constant is the same in all episodes" in text
    assert "rare was drawn for" in text
    assert f"{int(np.isnan(some).sum())} episodes without a value" in text


@pytest.mark.parametrize(("success", "word"), [(True, "succeeded"), (False, "failed")])
def test_one_result_in_all_episodes_explains_nothing(success, word):
    ranking = rank_factors({"friction": np.arange(9.0)}, np.full(9, success))
    assert ranking.effects == ()
    assert ranking.notes == (f"all 9 episodes {word}: there is nothing to explain",)


def test_groups_have_equal_numbers_of_episodes_or_one_value_each():
    rng = np.random.default_rng(7)
    values = rng.uniform(0, 1, 100)
    groups = success_by_factor(values, values > 0.5)
    assert [group.success.trials for group in groups] == [20] * 5
    assert groups[0].success.rate == 0 and groups[-1].success.rate == 1
    assert all(one.high < other.low for one, other in pairwise(groups))
    values[:10] = np.nan
    kinds = success_by_factor(np.where(np.isnan(values), np.nan, 3.0), values > 0.5)
    assert [(group.low, group.high, group.success.trials) for group in kinds] == [(3.0, 3.0, 90)]


def test_few_failures_are_not_explained_by_many_factors():
    rng = np.random.default_rng(8)
    success = np.full(EPISODES, True)
    success[:7] = False
    ranking = rank_factors(drawn(rng), success)
    assert ranking.effects == ()
    assert ranking.notes == ("7 episodes failed: a model of 5 factors needs at least 25",)
