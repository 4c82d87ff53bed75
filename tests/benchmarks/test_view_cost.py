"""The cost of an update for viewers is measured, and what is too much is named."""

import pytest

from benchmarks.view_cost import measure, report

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]


def test_a_task_is_measured():
    found = measure("random_reach", num_envs=2, steps=20, rounds=1)
    assert found["dt"] == 0.04
    assert found["step"] > 0
    assert len(found["costs"]) == 1  # one pair


def test_the_table_says_what_is_too_much_and_its_share():
    good = {"costs": [0.04, 0.05, 0.07], "step": 1.0, "dt": 0.02}
    bad = {**good, "costs": [0.09, 0.11, 0.12]}
    lines = report({"num_envs": 4, "tasks": {"good": good, "bad": bad}}).splitlines()
    sure = "**0.050** [0.040 to 0.070]", "**0.110** [0.090 to 0.120]"
    assert lines[-2] == f"| good | {sure[0]} | yes | 1.00 | 4 % | 20 % |"
    assert lines[-1] == f"| bad | {sure[1]} | no | 1.00 | 9 % | 44 % |"
