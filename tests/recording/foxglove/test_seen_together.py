"""What viewers of a log are shown of many moments at once is what they are shown of each."""

import mujoco
import numpy as np

from embodichain.recording.foxglove.view_encoder import ViewEncoder
from embodichain.recording.foxglove.view_spec import ViewSpec
from embodichain.recording.seen_together import VIEW, SeenTogether
from tests.recording.scene import MODEL

SPEC = ViewSpec(env_ids=(0, 2), offsets=((0, 0, 0), (2, 0, 0)), every=1, period_ns=10)


class File:
    """Keeps messages."""

    def __init__(self):
        self.found = {}

    def channel(self, topic, schema, data=None): ...

    def send(self, time_ns, messages):
        for topic, data in messages:
            self.found.setdefault(topic, []).append((time_ns, data))

    def write_rows(self, messages, times):
        for topic, ((table,),) in messages:
            rows = zip(times, table, strict=True)
            self.found.setdefault(topic, []).extend((t, row.tobytes()) for t, row in rows)


def shown(file, most, monkeypatch):
    """Three colours, five moments of each, and numbers with two factors; memory is lent."""
    monkeypatch.setattr("embodichain.recording.seen_together._MOST", most)
    seen = SeenTogether(ViewEncoder(MODEL, SPEC, file), file)
    methods = seen.methods()
    generator = np.random.default_rng(0)
    nstate = mujoco.mj_stateSize(MODEL, mujoco.mjtState.mjSTATE_INTEGRATION)

    def lent(method, *args):
        methods[VIEW + method](*args)
        for arg in args:
            if isinstance(arg, np.ndarray):
                arg[...] = 77

    lent("scalars", ("height", "speed"))
    for colour in range(3):
        lent("set_field", 2, "geom_rgba", slice(0, 3), np.full(3, 0.25 * colour))
        if colour != 1:
            lent("show", {0: False, 2: True})
            lent("factors", np.array([1.0, 10.0 * colour]))
        for k in range(5):
            step = 5 * colour + k
            assert seen.is_due(step)
            seen.look(step, 10 * step, generator.uniform(-1, 1, (2, nstate)))
            assert not seen.is_due(step)
            lent("numbers", 10 * step, generator.uniform(-1, 1, (2, 2)))
    seen.finish()
    return file.found


def test_messages_are_those_of_each_moment(monkeypatch):
    alone, together = shown(File(), 1, monkeypatch), shown(File(), 64, monkeypatch)
    assert together == alone
    assert [time_ns for time_ns, _ in together["/tf"]] == list(range(0, 150, 10))
    assert len(together["/env_2/metrics"]) == 15
    assert len(together["/env_2/scene"]) == 2
    assert len({data for _, data in together["/env_0/metrics"]}) == 15


def test_no_more_than_so_many_wait(monkeypatch):
    class Counting(File):
        tables = 0

        def write_rows(self, messages, times):
            self.tables += 1
            assert len(times) <= 2
            super().write_rows(messages, times)

    file = Counting()
    shown(file, 2, monkeypatch)
    assert file.tables > 10
