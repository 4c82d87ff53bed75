"""Logs of the small environment."""

import numpy as np
import pytest

from embodichain.recording import McapRecorder, RecordOptions
from tests.recording.scene import SmallEnv


@pytest.fixture
def record(tmp_path):
    """Records a run of the small environment; returns the file.

    `before` steps are made without a recorder; everything else goes to `SmallEnv`.
    """

    def run(name="log.mcap", steps=20, options=None, before=0, env=SmallEnv, **kwargs):
        env = env(**kwargs)
        if before:
            env.reset()
        for _ in range(before):
            env.step()
        recorder = McapRecorder(tmp_path / name, env, "seed: 0\n", ["seed=0"], options, "small")
        env.add_observer(recorder)
        if not before:
            env.reset()
        for _ in range(steps):
            env.step()
        env.close()
        return tmp_path / name

    return run


@pytest.fixture
def many_chunks(tmp_path):
    """Records 120 steps, in chunks of seven, with controls that stay; returns the file."""

    def run(state="all"):
        path = tmp_path / f"{state}.mcap"
        if path.exists():
            return path
        env = SmallEnv(length=60)
        recorder = McapRecorder(path, env, options=RecordOptions(state=state))
        env.add_observer(recorder)
        env.reset()
        for step in range(120):
            env.sim.engine.write("ctrl", 0.01 * step, None, np.array([step % 2]))
            env.step()
            if step % 7 == 0:
                recorder.flush()  # the end of a chunk
        env.close()
        return path

    return run


class _Poisoned(SmallEnv):
    """Environment 1 gets an impossible velocity in step 5: physics diverges there."""

    def step(self):
        if self.count == 5:
            self.sim.engine.write("qvel", np.nan, np.array([1]), np.array([0]))
        super().step()


@pytest.fixture
def poison():
    return _Poisoned
