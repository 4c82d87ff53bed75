import threading

import numpy as np
import pytest
from mcap.reader import make_reader

from embodichain.recording.writer import McapThread

TOPIC, SCHEMA = "/sim/state", "embodichain.BatchedState"


def start(path, depth=4, compression="lz4"):
    thread = McapThread(path, compression, depth)
    thread.put([lambda file: file.channel(TOPIC, SCHEMA)])
    return thread


def read(path):
    with path.open("rb") as stream:
        return [m.data for _, _, m in make_reader(stream, validate_crcs=True).iter_messages()]


def test_a_slow_disk_makes_the_simulation_wait_and_drops_nothing(tmp_path):
    gate = threading.Event()
    thread = start(tmp_path / "log.mcap", depth=2)
    thread.put([lambda file: gate.wait()])
    put = []

    def simulate():
        for i in range(50):
            thread.put([(TOPIC, i, (b"%d" % i,))])
            put.append(i)

    simulation = threading.Thread(target=simulate)
    simulation.start()
    simulation.join(0.5)
    assert simulation.is_alive()
    assert len(put) <= 3
    gate.set()
    simulation.join()
    thread.close()
    assert read(tmp_path / "log.mcap") == [b"%d" % i for i in range(50)]


def test_an_error_reaches_the_simulation(tmp_path):
    def fail(file):
        raise OSError(28, "No space left on device")

    thread = start(tmp_path / "log.mcap", depth=1)
    thread.put([fail])
    with pytest.raises(OSError, match=r"log\.mcap could not be written") as error:
        for _ in range(20):
            thread.put([])
    assert "No space left" in str(error.value.__cause__)
    with pytest.raises(OSError, match=r"log\.mcap could not be written"):
        thread.close()
    thread.close()  # it was told


def test_flushing_a_failed_file_says_so(tmp_path):
    def fail(file):
        raise OSError(28, "No space left on device")

    thread = start(tmp_path / "log.mcap")
    thread.put([fail])
    with pytest.raises(OSError, match=r"log\.mcap could not be written"):
        thread.flush()
    with pytest.raises(OSError, match=r"log\.mcap could not be written"):
        thread.close()


@pytest.mark.parametrize("compression", ["lz4", "zstd", "none"])
def test_chunks_of_every_compression(tmp_path, compression):
    thread = start(tmp_path / "log.mcap", compression=compression)
    arrays = [np.random.default_rng(i).normal(size=50_000) for i in range(6)]  # several chunks
    for i, array in enumerate(arrays):
        thread.put([(TOPIC, i, (b"head", array, b"tail"))])
    thread.close()
    assert read(tmp_path / "log.mcap") == [b"head" + a.tobytes() + b"tail" for a in arrays]
    with (tmp_path / "log.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert len(summary.chunk_indexes) > 1
    assert summary.statistics.message_count == 6
    assert summary.statistics.chunk_count == len(summary.chunk_indexes)
    assert (summary.statistics.message_start_time, summary.statistics.message_end_time) == (0, 5)


def test_a_file_without_messages_is_whole(tmp_path):
    start(tmp_path / "log.mcap").close()
    assert read(tmp_path / "log.mcap") == []
    with (tmp_path / "log.mcap").open("rb") as stream:
        assert list(make_reader(stream).get_summary().channels) == [1]


def test_a_channel_is_declared_once(tmp_path):
    thread = start(tmp_path / "log.mcap")
    thread.put([lambda file: file.channel(TOPIC, SCHEMA), (TOPIC, 1, (b"",))])
    thread.close()
    with (tmp_path / "log.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert [c.topic for c in summary.channels.values()] == [TOPIC]
    assert [s.name for s in summary.schemas.values()] == [SCHEMA]
