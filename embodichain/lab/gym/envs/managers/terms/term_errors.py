"""Errors of terms: which term raised or gave NaN, where it is declared, and in which step.

`KeySources` finds the file of a key; `failed_term` makes the error of a term that raised,
`warn_not_finite` tells of values that are not finite.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import lazy_loader
import numpy as np

from embodichain.utils.errors import ConfigError, EmbodichainError, Problem

if TYPE_CHECKING:
    import mujoco
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.managers.context import TermContext
else:
    mujoco = lazy_loader.load("mujoco")

__all__ = [
    "FAILURES",
    "KeySources",
    "TermError",
    "counted",
    "declared_at",
    "failed_term",
    "finite_physics",
    "kind_of_values",
    "listed",
    "present_step",
    "warn_not_finite",
]

logger = logging.getLogger(__name__)
FAILURES = (Exception, SystemExit)
"""What a term may raise by mistake; a SystemExit would end a run as if it had finished."""
_SHOWN = 8
"""Most environments that a message lists."""


class TermError(EmbodichainError, RuntimeError):
    """A term of a task raised an exception, which is the `__cause__`; names the term."""


class KeySources:
    """Where the keys of a task were set; copies of a config share it.

    Args:
        find: Key path from the root of the config -> ``FILE:LINE``, ``command line``, or empty.
        section: The key under which the task is.
        varied: Key paths from the root that variations have set.

    Attributes:
        varied: As given.
    """

    def __init__(
        self,
        find: Callable[[str], str],
        section: str = "task",
        varied: frozenset[str] = frozenset(),
    ) -> None:
        self._find = find
        self._section = section
        self.varied = varied

    def __deepcopy__(self, memo: Any) -> KeySources:
        """Return itself: it has no values of the config."""
        return self

    def of(self, path: str) -> tuple[str, str]:
        """Return the source of a key of the task, and its path from the root."""
        full_path = f"{self._section}.{path}"
        return self._find(full_path), full_path


def declared_at(env: TermContext, path: str) -> str:
    """Return a term as messages name it: ``FILE:LINE: task.SECTION.NAME``, or its path alone.

    Args:
        env: The environment.
        path: ``SECTION.NAME``.
    """
    sources: KeySources | None = env.cfg.key_sources
    if sources is None:
        return path
    source, full_path = sources.of(path)
    return f"{source}: {full_path}" if source else full_path


def present_step(env: TermContext) -> str:
    """Return the control step as logs number it, from 0."""
    count = env.control_step
    return f"control step {count - 1}" if count else "before the first control step"


def listed(ids: NDArray[np.int64]) -> str:
    """Return numbers of environments, the first few."""
    shown = ", ".join(map(str, ids[:_SHOWN].tolist()))
    return f"{shown}, ..." if len(ids) > _SHOWN else shown


def failed_term(
    env: TermContext, path: str, place: str, error: BaseException, env_ids: Any = None
) -> EmbodichainError:
    """Return the error to raise, from this one, for a term that raised an exception.

    Args:
        env: The environment.
        path: ``SECTION.NAME`` of the term.
        place: ``MODULE:NAME`` of its function.
        error: What it raised; a mistake in the config keeps its type.
        env_ids: (n,) environments for which it was called, or None for all.
    """
    if isinstance(error, ConfigError):
        return type(error)(_located(env, path, problem) for problem in error.problems)
    text = " ".join(str(error).split())
    if isinstance(error, TermError):  # of a term within this one
        return TermError(f"{declared_at(env, path)}: {text}")
    raised = f"{type(error).__name__}: {text}" if text else type(error).__name__
    where = "all environments"
    if env_ids is not None and isinstance(env_ids, np.ndarray):
        where = f"environments {listed(env_ids)}"
    return TermError(
        f"{declared_at(env, path)}: {place} raised {raised} ({present_step(env)}, {where})"
    )


def _located(env: TermContext, path: str, problem: Problem) -> Problem:
    """Return a mistake with the key path of its term, its file and its line."""
    sources: KeySources | None = env.cfg.key_sources
    if problem.source:
        return problem
    inner = problem.path
    if not f"{inner}.".startswith(f"{path}."):
        inner = f"{path}.{inner}".rstrip(".")
    if sources is None:
        return replace(problem, path=inner)
    return problem.at(*sources.of(inner))


def finite_physics(env: TermContext) -> NDArray[np.bool_]:
    """(N,) environments whose state is finite and not beyond what MuJoCo calls diverged."""
    # The largest of NaN and others is NaN, which is not smaller.
    return np.abs(env.sim.engine.rows).max(axis=1) < mujoco.mjMAXVAL


def kind_of_values(values: NDArray[Any]) -> str:
    """Return what numbers that are not finite are: NaN, infinite or both."""
    has_nan = bool(np.isnan(values).any())
    has_infinity = bool(np.isinf(values).any())
    if has_nan and has_infinity:
        return "NaN or infinite"
    return "NaN" if has_nan else "infinite"


def counted(path: str, counts: dict[str, int]) -> int:
    """Count a step of a term; return the count if it is 1, 10, 100..., and else 0."""
    count = counts.get(path, 0) + 1
    counts[path] = count
    is_power_of_ten = count == 10 ** (len(str(count)) - 1)
    return count if is_power_of_ten else 0


def warn_not_finite(
    env: TermContext,
    causes: Mapping[str, tuple[str, NDArray[np.bool_]]],
    what: str,
    counts: dict[str, int],
) -> None:
    """Log which terms gave values that are not finite, and in which environments.

    Args:
        env: The environment.
        causes: ``SECTION.NAME`` -> what its values are (`kind_of_values`), and in which
            environments, (N,).
        what: What happens to these environments.
        counts: Counts the steps of each term; it is named in the first, the tenth, the hundredth...
    """
    for path, (kind, rows) in causes.items():
        count = counted(path, counts)
        if not count:
            continue
        ids = np.flatnonzero(rows)
        so_far = f"; such steps so far: {count}" if count > 1 else ""
        logger.warning(
            "%s: %s is %s in %d of %d environments (%s); %s%s",
            present_step(env),
            declared_at(env, path),
            kind,
            len(ids),
            len(rows),
            listed(ids),
            what,
            so_far,
        )
