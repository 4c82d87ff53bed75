"""What tests cost: CPU seconds of each module, those of processes that it started included.

CPU time, unlike time on a clock, depends little on what else a machine does. `pytest --costs 30`
prints the 30 most expensive modules, and what the tiers cost (`make test COSTS=30`).
"""

import os
from collections import Counter
from collections.abc import Iterator
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


@pytest.hookimpl(tryfirst=True)  # before `-m` chooses
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if tier(item) == "fast":
            item.add_marker(pytest.mark.fast)


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
