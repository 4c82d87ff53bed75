"""Which drawn condition breaks a policy: success against each factor, and a joint model of all.

A *factor* is a number that was drawn for each episode, such as the friction of an object. The
joint model is a logistic regression of success on all factors at once: each in standard units, its
square, and the product of each pair, as in a response surface (Box and Wilson, 1951). It is fitted
by statsmodels, of the extra ``study``.
"""

from __future__ import annotations

import importlib.util
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from embodichain.learning.evaluation.statistics import Rate, rate
from embodichain.utils.errors import ConfigError

__all__ = [
    "FactorBin",
    "FactorEffect",
    "FactorRanking",
    "Interaction",
    "rank_factors",
    "success_by_factor",
]

F64 = NDArray[np.float64]

_BINS = 5
_LEAST_OF_KIND = 5
"""Episodes of the rarer result (success or failure) for each column of the model (Vittinghoff and
McCulloch, 2007); with fewer, columns are left out: first products, then squares."""
_NORMAL_QUANTILE = 1.959963984540054
"""Of a normal distribution, at 97.5 %: Wald's intervals at `CONFIDENCE`."""
_TOLERANCE = 1e-9


@dataclass(frozen=True, slots=True)
class FactorBin:
    """Success of the episodes in which a factor was in a range.

    Attributes:
        low: The smallest value of the factor in these episodes.
        high: The largest.
        success: Their rate of success, with its interval.
    """

    low: float
    high: float
    success: Rate


@dataclass(frozen=True, slots=True)
class Interaction:
    """How two factors act together.

    Attributes:
        names: The two factors.
        coefficient: Log-odds of success for one standard deviation more of both.
        interval: Its 95 % interval (Wald's), (low, high).
    """

    names: tuple[str, str]
    coefficient: float
    interval: tuple[float, float]


@dataclass(frozen=True, slots=True)
class FactorEffect:
    """What a factor explains in the joint model.

    Attributes:
        name: The factor.
        deviance: How much worse the model fits without the factor, its square and its products:
            twice the difference of log-likelihoods.
        degrees: Number of columns that the factor has in the model.
        p_value: Of the likelihood-ratio test of these columns.
        odds_ratio: What one standard deviation more multiplies the odds of success by, at the mean
            of all factors; None where success and failure are separated, as it has no finite
            estimate.
        odds_interval: Its 95 % interval (Wald's), (low, high); None likewise.
        optimum: Value of the factor with the most success where the square says that success falls
            to both sides; else None.
    """

    name: str
    deviance: float
    degrees: int
    p_value: float
    odds_ratio: float | None = None
    odds_interval: tuple[float, float] | None = None
    optimum: float | None = None


@dataclass(frozen=True, slots=True)
class FactorRanking:
    """The joint model of all factors.

    Attributes:
        effects: The factors, the one that explains most first.
        interactions: Products in the model, by their size; none if success is separated.
        episodes: Number of episodes in the model.
        notes: What was left out and why, and where success and failure are separated completely.
    """

    effects: tuple[FactorEffect, ...]
    interactions: tuple[Interaction, ...]
    episodes: int
    notes: tuple[str, ...]


def success_by_factor(
    values: ArrayLike, success: ArrayLike, bins: int = _BINS
) -> tuple[FactorBin, ...]:
    """Success of episodes grouped by a factor, each group with about as many episodes.

    A factor with at most `bins` different values has a group for each value.

    Args:
        values: (n,) the factor in each episode; NaN where it was not drawn.
        success: (n,) booleans.
        bins: Number of groups.
    """
    factor = np.asarray(values, np.float64)
    succeeded = np.asarray(success, np.bool_)
    was_drawn = ~np.isnan(factor)
    factor = factor[was_drawn]
    succeeded = succeeded[was_drawn]
    distinct = np.unique(factor)
    if distinct.size > bins:
        edges = np.quantile(factor, np.linspace(0, 1, bins + 1)[1:-1])
        group = np.searchsorted(edges, factor, side="right")
    else:
        group = np.searchsorted(distinct, factor)
    result: list[FactorBin] = []
    for index in np.unique(group):
        is_member = group == index
        success_rate = rate(succeeded[is_member])
        if success_rate is not None:
            members = factor[is_member]
            result.append(FactorBin(float(members.min()), float(members.max()), success_rate))
    return tuple(result)


def rank_factors(factors: Mapping[str, ArrayLike], success: ArrayLike) -> FactorRanking:
    """Rank factors by what each explains of success, all others given.

    Args:
        factors: For each factor, (n,) its value in each episode; NaN where it was not drawn.
        success: (n,) booleans.

    Raises:
        ConfigError: The extra ``study`` is not installed.
        ValueError: The lengths differ.
    """
    if importlib.util.find_spec("statsmodels") is None:
        raise ConfigError("the joint model of factors needs statsmodels: embodichain[study]")
    succeeded = np.asarray(success, np.bool_)
    columns = {name: np.asarray(values, np.float64) for name, values in factors.items()}
    for name, values in columns.items():
        if values.shape != succeeded.shape:
            raise ValueError(f"{name} has {values.size} values for {succeeded.size} episodes")
    notes: list[str] = []
    columns, succeeded = _drop_incomplete(columns, succeeded, notes)
    rarer = int(min(succeeded.sum(), (~succeeded).sum()))
    if not rarer:
        kind = "succeeded" if succeeded.size and succeeded.all() else "failed"
        notes.append(f"all {succeeded.size} episodes {kind}: there is nothing to explain")
        return FactorRanking((), (), int(succeeded.size), tuple(notes))
    columns = _drop_redundant(columns, notes)
    if not columns:
        return FactorRanking((), (), int(succeeded.size), tuple(notes))
    if rarer < _LEAST_OF_KIND * len(columns):
        kind = "succeeded" if succeeded.sum() == rarer else "failed"
        noun = "episode" if rarer == 1 else "episodes"
        notes.append(
            f"{rarer} {noun} {kind}: a model of {len(columns)} factors needs at least "
            f"{_LEAST_OF_KIND * len(columns)}"
        )
        return FactorRanking((), (), int(succeeded.size), tuple(notes))
    design = _design(columns, rarer, notes)
    return _fit(design, succeeded, notes)


@dataclass(frozen=True, slots=True)
class _Column:
    """A column of the model.

    Attributes:
        names: The factors in it: one, the same twice (a square), or two.
        values: (n,), in standard units.
    """

    names: tuple[str, ...]
    values: F64


@dataclass(frozen=True, slots=True)
class _Design:
    """The columns of the model, and the units of the factors.

    Attributes:
        columns: The columns, without the intercept.
        means: Mean of each factor.
        scales: Standard deviation of each factor.
    """

    columns: tuple[_Column, ...]
    means: dict[str, float]
    scales: dict[str, float]

    def matrix(self, without: str | None = None) -> F64:
        """Return (n, k) the intercept and the columns, without those of one factor."""
        n = self.columns[0].values.size
        kept = [column.values for column in self.columns if without not in column.names]
        return np.column_stack([np.ones(n), *kept])


def _drop_incomplete(
    columns: dict[str, F64], succeeded: NDArray[np.bool_], notes: list[str]
) -> tuple[dict[str, F64], NDArray[np.bool_]]:
    """Leave out factors that were not drawn for most episodes, then episodes without a value."""
    kept: dict[str, F64] = {}
    for name, values in columns.items():
        share = float(np.isnan(values).mean()) if values.size else 1.0
        if share > 0.5:
            notes.append(f"{name} was drawn for {1 - share:.0%} of the episodes: left out")
        else:
            kept[name] = values
    is_complete = np.ones(succeeded.size, np.bool_)
    for values in kept.values():
        is_complete &= ~np.isnan(values)
    missing = int((~is_complete).sum())
    if missing:
        notes.append(f"{missing} episodes without a value of every factor are left out")
    return {name: values[is_complete] for name, values in kept.items()}, succeeded[is_complete]


def _drop_redundant(columns: dict[str, F64], notes: list[str]) -> dict[str, F64]:
    """Leave out factors that do not vary, or that earlier ones determine."""
    kept: dict[str, F64] = {}
    basis = np.ones((next(iter(columns.values())).size, 1)) if columns else np.ones((0, 1))
    for name, values in columns.items():
        spread = float(values.std())
        if spread <= _TOLERANCE * max(1.0, float(np.abs(values).max())):
            notes.append(f"{name} is the same in all episodes: left out")
            continue
        standard = (values - values.mean()) / spread
        wider = np.column_stack([basis, standard])
        if np.linalg.matrix_rank(wider, tol=1e-6 * np.sqrt(len(values))) < wider.shape[1]:
            notes.append(f"{name} follows from the factors before it: left out")
            continue
        basis = wider
        kept[name] = values
    return kept


def _design(columns: dict[str, F64], rarer: int, notes: list[str]) -> _Design:
    """Choose the columns that the number of episodes allows."""
    names = list(columns)
    means = {name: float(values.mean()) for name, values in columns.items()}
    scales = {name: float(values.std()) for name, values in columns.items()}
    standard = {name: (columns[name] - means[name]) / scales[name] for name in names}
    chosen = [_Column((name,), standard[name]) for name in names]
    squares = [
        _Column((name, name), standard[name] ** 2 - 1)
        for name in names
        if np.unique(columns[name]).size > 2
    ]
    products = [
        _Column((one, other), standard[one] * standard[other])
        for one, other in combinations(names, 2)
    ]
    allowed = rarer // _LEAST_OF_KIND
    for title, further in (("squares", squares), ("products of two factors", products)):
        if not further:
            continue
        if len(chosen) + len(further) > allowed:
            notes.append(
                f"the model has no {title}: {len(chosen) + len(further)} columns need "
                f"{_LEAST_OF_KIND} episodes of the rarer result each, there are {rarer}"
            )
            continue
        chosen += _independent(chosen, further)
    return _Design(tuple(chosen), means, scales)


def _independent(columns: Sequence[_Column], further: Sequence[_Column]) -> list[_Column]:
    """Return those of further columns that the columns before them do not determine."""
    n = columns[0].values.size
    basis = np.column_stack([np.ones(n), *(column.values for column in columns)])
    kept: list[_Column] = []
    for column in further:
        wider = np.column_stack([basis, column.values])
        if np.linalg.matrix_rank(wider, tol=1e-6 * np.sqrt(n)) == wider.shape[1]:
            basis = wider
            kept.append(column)
    return kept


def _fit(design: _Design, succeeded: NDArray[np.bool_], notes: list[str]) -> FactorRanking:
    """Fit the model and, for each factor, the model without it."""
    from scipy.stats import chi2

    log_likelihood, coefficients, covariance = _logistic(design.matrix(), succeeded)
    is_separated = _separates(design.matrix(), succeeded)
    if is_separated:
        notes.append(_describe_separation(design, succeeded))
    deviations = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    effects: list[FactorEffect] = []
    interactions: list[Interaction] = []
    for index, column in enumerate(design.columns, start=1):
        coefficient = float(coefficients[index])
        half = _NORMAL_QUANTILE * float(deviations[index])
        low = coefficient - half
        high = coefficient + half
        if len(column.names) == 1:
            name = column.names[0]
            without_factor, _, _ = _logistic(design.matrix(without=name), succeeded)
            degrees = sum(name in other.names for other in design.columns)
            deviance = max(2 * (log_likelihood - without_factor), 0.0)
            effect = FactorEffect(
                name=name,
                deviance=deviance,
                degrees=degrees,
                p_value=float(chi2.sf(deviance, degrees)),
            )
            if not is_separated:
                effect = replace(
                    effect,
                    odds_ratio=float(np.exp(coefficient)),
                    odds_interval=(float(np.exp(low)), float(np.exp(high))),
                    optimum=_optimum(design, coefficients, name),
                )
            effects.append(effect)
        elif column.names[0] != column.names[1] and not is_separated:
            one, other_name = column.names
            interactions.append(Interaction((one, other_name), coefficient, (low, high)))
    effects.sort(key=lambda effect: (effect.p_value, -effect.deviance))
    interactions.sort(key=lambda interaction: -abs(interaction.coefficient))
    return FactorRanking(tuple(effects), tuple(interactions), int(succeeded.size), tuple(notes))


def _optimum(design: _Design, coefficients: F64, name: str) -> float | None:
    """Where success is most likely along one factor, if that is within two standard deviations."""
    linear = 0.0
    square = 0.0
    for index, column in enumerate(design.columns, start=1):
        if column.names == (name,):
            linear = float(coefficients[index])
        elif column.names == (name, name):
            square = float(coefficients[index])
    if square >= 0:
        return None
    standard = -linear / (2 * square)
    if abs(standard) > 2:
        return None
    return design.means[name] + standard * design.scales[name]


def _logistic(matrix: F64, succeeded: NDArray[np.bool_]) -> tuple[float, F64, F64]:
    """Fit a logistic regression; return log-likelihood, coefficients (k,), covariance (k, k)."""
    import statsmodels.api as sm

    # Of separated data the likelihood converges while coefficients grow: `_describe_separation`
    # says so. statsmodels would warn once for each model.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = sm.GLM(succeeded.astype(np.float64), matrix, family=sm.families.Binomial())
        result = model.fit(maxiter=100)
        log_likelihood = float(result.llf)
        coefficients = np.asarray(result.params, np.float64)
        covariance = np.asarray(result.cov_params(), np.float64)
    return log_likelihood, coefficients, covariance


def _separates(matrix: F64, succeeded: NDArray[np.bool_]) -> bool:
    """Whether columns separate success from failure, so that coefficients grow without limit.

    A linear program finds a direction in which no episode is on the wrong side and some are on the
    right side of it (Konis, 2007). Without separation the best direction is zero.
    """
    from scipy.optimize import linprog

    sides = np.where(succeeded, 1.0, -1.0)[:, None] * matrix
    result = linprog(
        -sides.sum(axis=0), A_ub=-sides, b_ub=np.zeros(len(sides)), bounds=(-1, 1), method="highs"
    )
    return result.x is not None and -result.fun > 1e-6


def _describe_separation(design: _Design, succeeded: NDArray[np.bool_]) -> str:
    """Say which factors separate success from failure, alone or together."""
    intercept = np.ones(succeeded.size)
    alone: list[str] = []
    for name in design.means:
        own_columns = [column.values for column in design.columns if set(column.names) == {name}]
        if _separates(np.column_stack([intercept, *own_columns]), succeeded):
            alone.append(name)
    which = " and ".join(alone) if alone else "the factors together"
    verb = "separates" if len(alone) == 1 else "separate"
    return (
        f"{which} {verb} success from failure: coefficients have no finite estimate, "
        "so the model has no intervals"
    )
