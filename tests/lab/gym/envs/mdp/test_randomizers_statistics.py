"""Every randomizer's numbers: range, distribution, independence, no drift.

Seeds are fixed, so that a test either always passes or always fails; bounds are at five standard
errors and a Kolmogorov-Smirnov p of 1e-4.
"""

import numpy as np
import pytest
from scipy import stats

from embodichain.lab.gym.envs.managers import TERMS
from embodichain.lab.gym.envs.mdp.events.randomize import Randomize
from tests.helpers.randomizers import CASES, IDS, Case

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]

N = 600
DISTRIBUTED = [
    pytest.param(case, kind, id=f"{name}-{kind}")
    for case, name in zip(CASES, IDS, strict=True)
    for kind in case.distributions
]


def expected(case: Case, kind: str):
    low, high = case.low, case.high
    if kind == "uniform":
        return stats.uniform(low, high - low)
    if kind == "log_uniform":
        return stats.loguniform(low, high)
    return stats.norm((low + high) / 2, (high - low) / 6)


@pytest.mark.parametrize(("case", "kind"), DISTRIBUTED)
def test_values_are_distributed_as_declared(make, case, kind) -> None:
    env = make(num_envs=N, events={"e": case.event(kind)})
    env.reset()
    values = case.values(env)
    tiny = 1e-9 * (case.high - case.low)  # a ratio or a difference is read back rounded
    assert values.min() >= case.low - tiny
    assert values.max() <= case.high + tiny
    wanted = expected(case, kind)
    error = wanted.std() / np.sqrt(N)
    assert np.abs(values.mean(0) - wanted.mean()).max() < 5 * error
    # Standard error of a sample's standard deviation is at most std sqrt((kurtosis + 2) / 4N).
    assert np.abs(values.std(0) / wanted.std() - 1).max() < 5 * np.sqrt(3 / (4 * N))
    for column in values.T:
        assert stats.kstest(column, wanted.cdf).pvalue > 1e-4


@pytest.mark.parametrize("case", CASES, ids=IDS)
def test_no_drift_and_no_correlation_over_a_thousand_resets(make, case) -> None:
    env = make(num_envs=2, events={"e": case.event()})
    found = []
    for _ in range(1000):
        env.event_manager.apply("reset", None)
        found.append(case.values(env).copy())
    values = np.array(found)
    tiny = 1e-9 * (case.high - case.low)
    assert values[-100:].min() >= case.low - tiny and values.max() <= case.high + tiny
    wanted = expected(case, "uniform")
    for half in (values[:500], values[500:]):
        error = wanted.std() / np.sqrt(500)
        assert np.abs(half.mean(0) - wanted.mean()).max() < 5 * error
    own, other = values[:, 0], values[:, 1]
    limit = 5 / np.sqrt(1000)
    for column in range(values.shape[2]):
        # Environments of one draw, and draws of one environment, know nothing of each other.
        assert abs(np.corrcoef(own[:, column], other[:, column])[0, 1]) < limit
        assert abs(np.corrcoef(own[:-1, column], own[1:, column])[0, 1]) < limit
    if values.shape[2] > 1:
        together = abs(np.corrcoef(own[:, 0], own[:, 1])[0, 1])
        assert together < limit or together > 0.999  # its own draw, or one for both


def test_every_randomizer_of_model_fields_has_a_case() -> None:
    known = {
        name
        for name, spec in TERMS["event"].items()
        if isinstance(spec.func, type) and issubclass(spec.func, Randomize)
    }
    assert known == {case.func for case in CASES}
