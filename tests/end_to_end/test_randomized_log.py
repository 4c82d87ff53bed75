"""A log of an environment whose model fields are randomized verifies from the file alone."""

import numpy as np
import pytest
import torch

from embodichain.recording import McapRecorder, verify
from embodichain.recording.write.log_writer import LogWriter
from tests.helpers.randomizers import CASES
from tests.helpers.ur10_task import HOME, builder

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]


def record(path, late: bool = False) -> np.ndarray:
    """A few episodes with every randomizer: at the start, at resets, at intervals."""
    modes = ("startup", "reset", "interval")
    events = {}
    for i, case in enumerate(CASES):
        more = {"interval_step": 3} if i % 3 == 2 else {}
        events[f"e{i}"] = case.event(mode=modes[i % 3], **more)
    with builder() as make:
        env = make(num_envs=3, max_episode_steps=7, events=events)
        if late:
            env.reset()
            env.step(torch.tensor([HOME] * 3))
        env.add_observer(McapRecorder(path, env))
        if not late:
            env.reset()
        for step in range(20):
            if step == 4:
                env.reset(options={"reset_ids": [1]})
            wave = HOME + 0.3 * np.sin(0.7 * step + np.arange(3)[:, None] + np.arange(6))
            env.step(torch.from_numpy(wave.astype(np.float32)))
        return env.sim.engine.rows.copy()


@pytest.mark.parametrize("late", [False, True])
def test_it_verifies(tmp_path, late) -> None:
    rows = record(tmp_path / "log.mcap", late)
    assert np.isfinite(rows).all()
    report = verify(tmp_path / "log.mcap")
    assert report.ok, report
    assert report.steps == 20
    for env in range(3):
        assert verify(tmp_path / "log.mcap", env=env).ok


@pytest.mark.parametrize("lost", ["all fields", "one field", "derived fields"])
def test_what_was_randomized_before_the_log_belongs_to_it(tmp_path, monkeypatch, lost) -> None:
    start = LogWriter.start

    def forgetful(self, step, rows, fields):
        kept = dict(fields)
        if lost == "all fields":
            kept = {}
        elif lost == "one field":
            kept.pop("actuator_forcerange")
        else:
            kept["dof_invweight0"] = kept["dof_invweight0"] * 1.01
        return start(self, step, rows, kept)

    # A recorder with a bug, which `verify` has to find.
    monkeypatch.setattr(LogWriter, "start", forgetful)
    record(tmp_path / "log.mcap", late=True)
    assert not verify(tmp_path / "log.mcap").ok
