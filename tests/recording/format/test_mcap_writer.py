"""`McapWriter` beside the library's own writer: the same bytes, and the library stays as it is."""

import io
import subprocess
import sys
import textwrap

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from embodichain.recording.format.container.mcap_writer import McapWriter

RNG = np.random.default_rng(0)
ROWS = [RNG.normal(size=(40, 16)) for _ in range(30)]
KINDS = {"none": CompressionType.NONE, "lz4": CompressionType.LZ4, "zstd": CompressionType.ZSTD}


def _ours(compression: str, *, finish: bool = True) -> bytes:
    stream = io.BytesIO()
    writer = McapWriter(stream, compression, "lib", profile="p", chunk_bytes=20_000)
    writer.attachment("a.txt", "text/plain", b"words", 7)
    first = writer.channel("/first", "protobuf", writer.schema("first", "protobuf", b"def"))
    second = writer.channel("/second", "json", writer.schema("second", "", b""), {"key": "value"})
    for step, rows in enumerate(ROWS):
        writer.message(first, 100 - step, [b"head", rows])
        writer.message(second, 50 + step, rows.tobytes()[:10])
        if step == 5:
            writer.metadata("middle", {"step": "5"})
        if step == 7:
            writer.end_chunk()
            writer.end_chunk()
    writer.metadata("end", {})
    if finish:
        writer.finish()
    return stream.getvalue()


def _librarys(compression: str) -> bytes:
    stream = io.BytesIO()
    writer = Writer(stream, 20_000, KINDS[compression], enable_data_crcs=True)
    writer.start("p", "lib")
    writer.add_attachment(7, 7, "a.txt", "text/plain", b"words")
    declared = writer.register_schema("first", "protobuf", b"def")
    first = writer.register_channel("/first", "protobuf", declared)
    declared = writer.register_schema("second", "", b"")
    second = writer.register_channel("/second", "json", declared, {"key": "value"})
    for step, rows in enumerate(ROWS):
        writer.add_message(first, 100 - step, b"head" + rows.tobytes(), 100 - step)
        writer.add_message(second, 50 + step, rows.tobytes()[:10], 50 + step)
        if step == 5:
            writer.add_metadata("middle", {"step": "5"})
        if step == 7:
            writer.flush()
            writer.flush()
    writer.add_metadata("end", {})
    writer.finish()
    return stream.getvalue()


@pytest.mark.parametrize("compression", ["none", "lz4"])
def test_the_bytes_are_those_of_the_library(compression: str) -> None:
    assert _ours(compression) == _librarys(compression)


def test_another_level_of_zstd_unpacks_to_the_same() -> None:
    def content(data: bytes) -> list[tuple[str, int, bytes]]:
        reader = make_reader(io.BytesIO(data), validate_crcs=True)
        return [(c.topic, m.log_time, m.data) for _, c, m in reader.iter_messages()]

    assert content(_ours("zstd")) == content(_librarys("zstd"))


def test_without_an_end_there_is_the_same_beginning() -> None:
    cut = _ours("none", finish=False)
    assert _librarys("none").startswith(cut)


def test_a_file_without_messages() -> None:
    stream = io.BytesIO()
    McapWriter(stream, "zstd", "lib").finish()
    other = io.BytesIO()
    writer = Writer(other, enable_data_crcs=True)
    writer.start(library="lib")
    writer.finish()
    assert stream.getvalue() == other.getvalue()


def test_importing_the_recorder_changes_nothing_of_other_packages() -> None:
    code = """
        import io, os
        import mcap.writer
        import zstandard
        from mcap.records import Message

        def size():
            stream = io.BytesIO()
            writer = mcap.writer.Writer(stream)
            writer.start()
            channel = writer.register_channel("/a", "json", 0)
            writer.add_message(channel, 0, bytes(range(256)) * 5000, 0)
            writer.finish()
            return len(stream.getvalue())

        before = size()
        from embodichain.recording import McapRecorder
        from embodichain.recording.export.formats import ros2
        from embodichain.recording.read.recover import recover
        print(size() == before, mcap.writer.zstandard is zstandard, mcap.writer.Message is Message)
    """
    command = [sys.executable, "-c", textwrap.dedent(code)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    assert done.stdout.split() == ["True", "True", "True"]
