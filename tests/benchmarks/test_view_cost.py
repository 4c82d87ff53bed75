"""The cost of an update for viewers is measured, and what is too much is named."""

from benchmarks.view_cost import measure, report


def test_a_task_is_measured():
    found = measure("random_reach", num_envs=2, steps=20, rounds=1)
    assert found["dt"] == 0.04
    assert found["writing"] > 0 and found["step"] > 0


def test_the_table_says_what_is_too_much_and_its_share():
    good = {"stepping": 0.02, "writing": 0.03, "step": 1.0, "dt": 0.02}
    facts = {"num_envs": 4, "tasks": {"good": good, "bad": {**good, "writing": 0.09}}}
    lines = report(facts).splitlines()
    assert lines[-2] == "| good | 0.020 | 0.030 | 0.050 | yes | 1.00 | 4 % | 20 % |"
    assert lines[-1] == "| bad | 0.020 | 0.090 | 0.110 | no | 1.00 | 9 % | 44 % |"
