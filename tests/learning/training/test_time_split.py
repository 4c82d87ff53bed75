from types import SimpleNamespace

import pytest

from embodichain.learning.training import session
from embodichain.learning.training.session import TimeSplit


def test_every_second_belongs_to_one_part(monkeypatch):
    now = [100.0]
    # A clock that the test moves: no bound depends on how busy the machine is.
    monkeypatch.setattr(session.time, "perf_counter", lambda: now[0])
    env = SimpleNamespace(base=SimpleNamespace(sim=SimpleNamespace(physics_seconds=7.0)))
    env.step_seconds = 8.0  # what was spent before learning belongs to nobody
    split = TimeSplit()
    assert split.fractions == {}
    split.rollout_begins(env)
    for update in (4.0, 6.0):
        env.base.sim.physics_seconds += 3.0
        env.step_seconds += 5.0
        now[0] += 10.0
        split.rollout_ends(env)
        env.step_seconds += 0.5  # an evaluation in between, say, is part of the update's time
        now[0] += update
        if update == 4.0:
            split.rollout_begins(env)
    split.end()
    assert split.seconds == {"physics": 6.0, "environment": 4.0, "policy": 10.0, "update": 10.0}
    assert split.fractions["update"] == pytest.approx(1 / 3)
    assert sum(split.seconds.values()) == now[0] - 100.0
