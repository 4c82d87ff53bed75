"""What tests cost: CPU seconds of each module, those of processes that it started included.

CPU time, unlike time on a clock, depends little on what else a machine does. `pytest --costs 30`
prints the 30 most expensive modules, and what the tiers cost (`make test COSTS=30`).
"""

import os
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

from tests.helpers.commands import cpu_seconds

__all__ = [
    "TIERS",
    "pytest_addoption",
    "pytest_collection_modifyitems",
    "pytest_runtest_protocol",
    "pytest_sessionfinish",
    "pytest_terminal_summary",
    "pytest_testnodedown",
    "spread",
    "tier",
]

TIERS = ("fast", "slow", "cluster")
_COSTS = pytest.StashKey[Counter[str]]()


def tier(item: pytest.Item) -> str:
    """Return the tier of a test: `fast` unless it or its module is marked otherwise."""
    marks = {mark.name for mark in item.iter_markers()}
    return next((name for name in ("cluster", "slow") if name in marks), "fast")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--costs", type=int, default=0, help="how many modules' CPU seconds to print")


@pytest.hookimpl(wrapper=True, tryfirst=True)  # before `-m` chooses, and after it
def pytest_collection_modifyitems(items: list[pytest.Item]) -> Iterator[None]:
    for item in items:
        if tier(item) == "fast":
            item.add_marker(pytest.mark.fast)
    yield
    workers = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    if workers > 1:
        items[:] = spread(items, workers)


def spread(items: Sequence[pytest.Item], workers: int) -> list[pytest.Item]:
    """Order tests so that each worker of xdist has its slow tests before its last fast ones.

    xdist gives each worker an equal number of consecutive tests, and work is stolen from the end of
    a share. In the order of their files, one worker would have most of the slow tests, and all
    would wait for the last of them. Folders of slow tests are dealt out in turn, since modules of
    one folder share what they build. The clusters, whose nodes have to start in time, wait for each
    other in the first share, while the other workers have fast tests.

    Args:
        items: The tests.
        workers: The number of workers.
    """
    shares: list[list[pytest.Item]] = [[] for _ in range(workers)]
    fast: list[pytest.Item] = []
    owner: dict[Path, int] = {}
    for item in sorted(items, key=lambda item: tier(item) != "cluster"):
        if tier(item) == "cluster":
            shares[0].append(item)
        elif tier(item) == "slow":
            folder = item.path.parent
            number = owner.setdefault(folder, (len(owner) + 1) % workers)
            shares[number].append(item)
        else:
            fast.append(item)
    ordered: list[pytest.Item] = []
    for number, share in enumerate(shares):
        size = (len(items) - len(ordered)) // (workers - number)  # as xdist divides them
        missing = max(0, size - len(share))
        before = missing // 2 if number else 0
        ordered += [*fast[:before], *share, *fast[before:missing]]
        del fast[:missing]
    return ordered


def _cpu() -> float:
    user, system, user_of_children, system_of_children, _ = os.times()
    return user + system + user_of_children + system_of_children + cpu_seconds()


def _costs(config: pytest.Config) -> Counter[str]:
    """CPU seconds, by tier and module."""
    return config.stash.setdefault(_COSTS, Counter())


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    before = _cpu()
    done = yield
    module = item.nodeid.partition("::")[0]
    _costs(item.config)[f"{tier(item)} {module}"] += _cpu() - before
    return done


def pytest_sessionfinish(session: pytest.Session) -> None:
    output = getattr(session.config, "workeroutput", None)
    if output is not None:  # in a worker of xdist
        output["costs"] = dict(_costs(session.config))


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any) -> None:
    """In the process that xdist's workers report to."""
    _costs(node.config).update(getattr(node, "workeroutput", {}).get("costs", {}))


def pytest_terminal_summary(
    terminalreporter: pytest.TerminalReporter, config: pytest.Config
) -> None:
    most = config.getoption("--costs")
    if not most:
        return
    costs = _costs(config)
    terminalreporter.section("CPU seconds")
    for name in TIERS:
        seconds = sum(cost for key, cost in costs.items() if key.startswith(f"{name} "))
        terminalreporter.write_line(f"{seconds:8.1f} {name}")
    for key, seconds in costs.most_common(most):
        terminalreporter.write_line(f"{seconds:8.1f} {key}")
