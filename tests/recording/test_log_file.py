import os
import struct
from contextlib import closing

import numpy as np
import pytest
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader

from embodichain.recording import chunks
from embodichain.recording.log_file import LogFile

TOPIC, SCHEMA = "/sim/state", "embodichain.BatchedState"


def start(path, compression="lz4"):
    file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL)
    log = LogFile(file, os.open(path.parent, os.O_RDONLY), path.name, compression)
    log.channel(TOPIC, SCHEMA)
    return log


def read(path):
    with path.open("rb") as stream:
        return [m.data for _, _, m in make_reader(stream, validate_crcs=True).iter_messages()]


@pytest.mark.parametrize("compression", ["zstd-fast", "lz4", "zstd", "none"])
def test_chunks_of_every_compression(tmp_path, compression):
    log = start(tmp_path / "log.mcap", compression)
    arrays = [np.random.default_rng(i).normal(size=50_000) for i in range(6)]  # several chunks
    for i, array in enumerate(arrays):
        log.write(TOPIC, i, (b"head", array, b"tail"))
    log.finish()
    assert read(tmp_path / "log.mcap") == [b"head" + a.tobytes() + b"tail" for a in arrays]
    with (tmp_path / "log.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert len(summary.chunk_indexes) > 1
    assert summary.statistics.message_count == 6
    assert summary.statistics.chunk_count == len(summary.chunk_indexes)
    assert (summary.statistics.message_start_time, summary.statistics.message_end_time) == (0, 5)


@pytest.mark.parametrize("size", [10, 40_000, 100_000, 300_000])  # more than a chunk
def test_arrays_may_change_once_they_are_handed_over(tmp_path, size):
    log = start(tmp_path / "log.mcap")
    array, expected = np.zeros(size), []
    for i in range(5):
        array[:] = i
        expected.append(array.tobytes())
        log.write(TOPIC, i, (array,))
    log.finish()
    assert read(tmp_path / "log.mcap") == expected


def test_rows_are_the_messages_that_they_stand_for(tmp_path):
    """Found by time and by topic as well, in chunks of any size."""
    generator = np.random.default_rng(0)
    expected = []

    def table(count, width):
        return generator.integers(0, 256, (count, width), np.uint8)

    log = start(tmp_path / "log.mcap")
    log.channel("/sim/step", "embodichain.Step")
    now = 0
    for count, width in ((2, 5), (40, 1000), (3, 400_000), (7, 0), (100, 33)):
        times = list(range(now, now + count))
        now += count
        first, second, third = table(1, width), table(count - 1, width), table(count, 9)
        log.write_rows([
            (TOPIC, [b"head", [first, second], b""]),
            ("/sim/step", [[third], b"tail"]),
            (TOPIC, [b"again"]),
        ], times)  # fmt: skip
        for time, a, b in zip(times, np.concatenate([first, second]), third, strict=True):
            expected += [
                (TOPIC, time, b"head" + a.tobytes()),
                ("/sim/step", time, b.tobytes() + b"tail"),
                (TOPIC, time, b"again"),
            ]
        log.write("/sim/step", now, (b"between",))
        expected.append(("/sim/step", now, b"between"))
    log.finish()
    with (tmp_path / "log.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        found = [(c.topic, m.log_time, m.data) for _, c, m in reader.iter_messages()]
        assert sorted(found) == sorted(expected)
        some = reader.iter_messages(topics=["/sim/step"], starting_at=30, ending_before=60)
        assert sorted((c.topic, m.log_time, m.data) for _, c, m in some) == sorted(
            message for message in expected if message[0] == "/sim/step" and 30 <= message[1] < 60
        )
        statistics = reader.get_summary().statistics
    assert statistics.message_count == len(expected)
    assert (statistics.message_start_time, statistics.message_end_time) == (0, now)
    assert statistics.chunk_count > 2


def test_a_file_without_messages_is_whole(tmp_path):
    start(tmp_path / "log.mcap").finish()
    assert read(tmp_path / "log.mcap") == []
    with (tmp_path / "log.mcap").open("rb") as stream:
        assert list(make_reader(stream).get_summary().channels) == [1]


def test_a_channel_is_declared_once(tmp_path):
    log = start(tmp_path / "log.mcap")
    log.channel(TOPIC, SCHEMA)
    log.write(TOPIC, 1, (b"",))
    log.finish()
    with (tmp_path / "log.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert [c.topic for c in summary.channels.values()] == [TOPIC]
    assert [s.name for s in summary.schemas.values()] == [SCHEMA]


@pytest.mark.parametrize(("lacks", "there"), [(1, True), (40, True), (200, False)])
def test_a_disk_that_fills_within_a_chunk_leaves_what_is_said(tmp_path, monkeypatch, lacks, there):
    """The last bytes of a chunk are its index: without them its messages can still be read."""
    log = start(tmp_path / "log.mcap", "none")
    for i in range(2):
        log.write(TOPIC, i, (b"message" * 40,))
    took, write = [], os.writev

    def full(descriptor, parts):
        if took:
            raise OSError(28, "No space left on device")
        data = b"".join(parts)
        took.append(write(descriptor, [data[: len(data) - lacks]]))
        return took[0]

    monkeypatch.setattr(os, "writev", full)
    with pytest.raises(OSError, match="No space left"):
        log.flush()
    monkeypatch.undo()
    log.close()
    assert log.written(TOPIC) == (2 if there else 0)
    with (tmp_path / "log.mcap").open("rb") as stream:
        found = []
        with pytest.raises((McapError, struct.error)):  # it ends in the middle of a record
            for record in StreamReader(stream).records:
                found += [record] if isinstance(record, Message) else []
    assert len(found) == log.written(TOPIC)


def test_messages_of_a_file_that_is_not_in_order_of_time(tmp_path, monkeypatch):
    generator = np.random.default_rng(0)
    log = start(tmp_path / "log.mcap")
    log.channel("/sim/step", "embodichain.Step")
    written = []
    for block in range(12):  # each lies in several chunks, and begins before the last one ends
        for topic, ahead in ((TOPIC, 0), ("/sim/step", -5)):
            for time in range(10 * block, 10 * block + 10):
                data = generator.bytes(200_000)
                log.write(topic, max(0, time + ahead), (data,))
                written.append((topic, max(0, time + ahead), data))
    log.finish()
    expected = sorted(written, key=lambda message: message[1])
    for most in (chunks._WAITING, 3):
        monkeypatch.setattr(chunks, "_WAITING", most)
        with closing(chunks.ChunkFile(tmp_path / "log.mcap")) as file:
            assert len(file.chunks) > 20
            found = [(t, time, bytes(d)) for t, time, d in file.messages_in_time(lambda t: True)]
            steps = list(file.messages_in_time(lambda topic: topic == "/sim/step"))
        assert sorted(found) == sorted(written)
        assert (found == expected) == (most > 3)
        assert [time for _, time, _ in steps] == [m[1] for m in written if m[0] == "/sim/step"]
