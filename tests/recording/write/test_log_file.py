import numpy as np
import pytest
from mcap.reader import make_reader

from embodichain.recording.write.log_file import LogFile
from embodichain.recording.write.log_writer import Queue

TOPIC, SCHEMA = "/sim/steps", "embodichain.Steps"


def start(path, compression="lz4"):
    log = LogFile(path, compression)
    log.channel(TOPIC, SCHEMA)
    return log


def read(path):
    with path.open("rb") as stream:
        return [m.data for _, _, m in make_reader(stream, validate_crcs=True).iter_messages()]


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_chunks_of_every_compression(tmp_path, compression):
    log = start(tmp_path / "log.mcap", compression)
    arrays = [np.random.default_rng(i).normal(size=50_000).tobytes() for i in range(6)]
    for i, array in enumerate(arrays):
        log.write(TOPIC, i, array)
    assert log.finish() == log.size == log.nbytes == (tmp_path / "log.mcap").stat().st_size
    log.close()
    assert read(tmp_path / "log.mcap") == arrays
    with (tmp_path / "log.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert len(summary.chunk_indexes) > 1
    assert summary.statistics.message_count == 6
    assert (summary.statistics.message_start_time, summary.statistics.message_end_time) == (0, 5)


def test_a_file_without_messages_is_whole(tmp_path):
    log = start(tmp_path / "log.mcap")
    log.finish()
    log.close()
    assert read(tmp_path / "log.mcap") == []
    with (tmp_path / "log.mcap").open("rb") as stream:
        assert list(make_reader(stream).get_summary().channels) == [1]


def test_a_channel_is_declared_once(tmp_path):
    log = start(tmp_path / "log.mcap")
    log.channel(TOPIC, SCHEMA)
    log.write(TOPIC, 1, b"")
    log.finish()
    log.close()
    with (tmp_path / "log.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert [c.topic for c in summary.channels.values()] == [TOPIC]
    assert [s.name for s in summary.schemas.values()] == [SCHEMA]


def test_a_log_goes_on_in_another_file_with_the_same_channels(tmp_path):
    log = start(tmp_path / "log.mcap")
    log.channel("/log", "foxglove.Log")
    log.write(TOPIC, 1, b"first", last_step=0)
    size = log.roll("log_0001.mcap", lambda: log.metadata("end", {"next": "log_0001.mcap"}))
    assert size == (tmp_path / "log.mcap").stat().st_size
    log.write("/log", 2, b"second")
    log.finish()
    assert log.nbytes == size + log.size
    log.close()
    assert read(tmp_path / "log.mcap") == [b"first"]
    assert read(tmp_path / "log_0001.mcap") == [b"second"]
    with (tmp_path / "log.mcap").open("rb") as stream:
        (end,) = make_reader(stream).iter_metadata()
    assert end.metadata == {"next": "log_0001.mcap"}


def test_the_other_file_must_not_exist(tmp_path):
    (tmp_path / "log_0001.mcap").write_bytes(b"mine")
    log = start(tmp_path / "log.mcap")
    with pytest.raises(FileExistsError):
        log.roll("log_0001.mcap", lambda: None)
    log.write(TOPIC, 1, b"goes on")
    log.finish()
    log.close()
    assert read(tmp_path / "log.mcap") == [b"goes on"]
    assert (tmp_path / "log_0001.mcap").read_bytes() == b"mine"


def test_where_a_log_ends_is_said_of_what_is_readable(tmp_path):
    log = start(tmp_path / "log.mcap", "none")
    assert log.where_it_ends == "no control step is in it"
    log.write(TOPIC, 1, b"x", last_step=6)
    assert log.where_it_ends == "no control step is in it"
    log.flush()
    assert log.where_it_ends == "it ends after control step 6"
    log.write(TOPIC, 2, bytes(2**21), last_step=9)  # more than a chunk: it is written at once
    assert log.where_it_ends == "it ends after control step 9"
    log.finish()
    log.close()


def test_a_file_that_was_removed_is_noticed(tmp_path):
    log = start(tmp_path / "log.mcap")
    (tmp_path / "log.mcap").unlink()
    with pytest.raises(FileNotFoundError, match="removed while it was written"):
        log.flush()
    log.close()


def test_a_message_that_no_reader_would_unpack_is_not_written(tmp_path, monkeypatch):
    # Small enough for a message of a test.
    monkeypatch.setattr("embodichain.recording.write.log_file._LARGEST_MESSAGE", 1000)
    log = start(tmp_path / "log.mcap")
    log.write(TOPIC, 1, bytes(1000))
    with pytest.raises(OSError, match="a message of 1001 bytes fits into no chunk"):
        log.write(TOPIC, 2, bytes(1001))
    log.close()


def test_a_channel_may_be_declared_while_the_queue_is_written(tmp_path):
    log, queue = start(tmp_path / "log.mcap"), Queue()

    def messages():  # what another thread may do while a message is encoded
        queue.channel("/log", "foxglove.Log")
        queue.send(2, [("/log", b"later")])
        yield TOPIC, b"first"

    queue.send(1, messages())
    queue.write(log)
    log.finish()
    log.close()
    assert read(tmp_path / "log.mcap") == [b"first", b"later"]
