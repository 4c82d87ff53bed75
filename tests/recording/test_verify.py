import pytest

from embodichain.recording import McapRecorder, verify
from tests.recording.scene import SmallEnv


@pytest.fixture
def record(tmp_path):
    """Records a run of the small environment, returns the file."""

    def run(name="log.mcap", steps=20, options=None, before=0, **kwargs):
        env = SmallEnv(**kwargs)
        for _ in range(before):
            env.reset()
            env.step()
        recorder = McapRecorder(tmp_path / name, env, "seed: 0\n", ["seed=0"], options, "small")
        env.add_observer(recorder)
        env.reset()
        for _ in range(steps):
            env.step()
        env.close()
        return tmp_path / name

    return run


def test_a_log_verifies(record):
    report = verify(record())
    assert report.ok, str(report)
