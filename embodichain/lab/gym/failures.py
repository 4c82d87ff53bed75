"""Why episodes of a planned policy failed: `known_failure` of one, `failures_of` of a batch."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.lab.gym.policies import PlannedPolicy

    Mask = NDArray[np.bool_]

__all__ = ["DONE", "LATE", "failed_in", "failures_of", "known_failure"]

DONE = "done, but no success"
LATE = "ran out of time"
_TERMINATED = "terminated: "


def failed_in(failure: str) -> str:
    """The step that failed, without its details: what is before the colon."""
    return failure if failure.startswith(_TERMINATED) else failure.partition(":")[0]


def known_failure(
    env: BaseEnv, row: int, planned: PlannedPolicy | None, terminated: bool, diverged: bool
) -> str | None:
    """What ended an episode without success, in one line; None if only time or the plan did.

    Args:
        env: The environment, after the step that ended the episode.
        row: Its number in the batch.
        planned: The policy, before its reset, if it is one.
        terminated: Whether the episode terminated.
        diverged: Whether it diverged.
    """
    if diverged:
        return "diverged"
    failures: Sequence[str | None] = ()
    if planned is not None:
        failures = planned.failures  # empty before the first action
    if failures and failures[row] is not None:
        return " ".join(str(failures[row]).split())
    if terminated:
        values = env.termination_manager.values
        terms = [name for name, has_fired in values.items() if has_fired[row]]
        return _TERMINATED + (", ".join(terms) or "fail")
    return None


def failures_of(
    env: BaseEnv,
    planned: PlannedPolicy,
    ended: Mask,
    terminated: Mask,
    values: Mapping[str, NDArray[Any]],
) -> NDArray[Any]:
    """(N,) why episodes failed that end in this step, in one line; "" of the others.

    Without a `success` in the values, an episode fails if the policy says so.

    Args:
        env: The environments.
        planned: The policy, before its reset.
        ended: (N,) whether an episode ends.
        terminated: (N,) whether it terminated.
        values: `diverged`, (N,), and `success` if the task judges it.
    """
    reasons = np.full(len(ended), "", object)
    is_judged = "success" in values
    has_failed = ended
    if is_judged:
        has_failed = ended & ~(values["success"] > 0)
    done = planned.done
    for row in np.flatnonzero(has_failed).tolist():
        reason = known_failure(
            env,
            row,
            planned,
            terminated=is_judged and bool(terminated[row]),
            diverged=bool(values["diverged"][row]),
        )
        if not reason and is_judged:
            is_done = len(done) and done[row]
            reason = DONE if is_done else LATE
        reasons[row] = reason or ""
    return reasons
