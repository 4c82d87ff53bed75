import pytest

from embodichain.recording.foxglove.log_lines import log_line
from embodichain.recording.foxglove.messages import Log, timestamp


@pytest.mark.parametrize("time_ns", [0, 5, 10**9, 1_763_785_488_123_456_789])
@pytest.mark.parametrize("level", Log.Level.keys())
@pytest.mark.parametrize("message", ["", "l'épisode 3", "a" * 300])
def test_a_line_has_the_bytes_that_protobuf_writes(time_ns, level, message):
    line = Log(timestamp=timestamp(time_ns), level=Log.Level.Value(level), message=message)
    line.name = "embodichain"
    assert log_line(time_ns, message, level) == line.SerializeToString()
