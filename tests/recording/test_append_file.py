"""Appending to a file: what is in it, and what the system is told of its pages."""

import os

import numpy as np
import pytest

from embodichain.recording import append_file
from embodichain.recording.append_file import AppendFile

MB = 2**20


def written(path, sizes, seed=0):
    """Write pieces of these sizes; what the file should hold, and the writer."""
    generator, content = np.random.default_rng(seed), b""
    with open(path, "xb", buffering=0) as stream:
        file = AppendFile(stream)
        for size in sizes:
            data = generator.bytes(size)
            file.write([data[: size // 3], data[size // 3 :]])
            content += data
    assert file.size == len(content)
    return content


@pytest.fixture
def advice(monkeypatch):
    """Spans (start, end) that the system was told to let go."""
    spans = []

    def told(_, offset, length, kind):
        assert kind == os.POSIX_FADV_DONTNEED
        spans.append((offset, offset + length))

    monkeypatch.setattr(os, "posix_fadvise", told)
    return spans


def test_a_file_has_every_byte_while_its_pages_are_let_go(tmp_path):
    path = tmp_path / "long"
    content = written(path, [3 * MB + 1] * 7)
    assert path.read_bytes() == content


def test_pages_are_let_go_twice_when_they_were_written_and_when_they_are_on_the_disk(
    tmp_path, advice
):
    content = written(tmp_path / "long", [MB] * 20)
    assert all(0 <= start < end <= len(content) for start, end in advice)
    block = append_file._BLOCK
    for at in range(0, len(content) - 2 * block, MB):
        assert sum(start <= at < end for start, end in advice) >= 2


def test_what_is_far_behind_is_not_looked_at_again(tmp_path, advice, monkeypatch):
    monkeypatch.setattr(append_file, "_WINDOW", 8 * MB)
    written(tmp_path / "long", [MB] * 40)
    assert max(end - start for start, end in advice) == 8 * MB
    assert [end for _, end in advice] == [4 * MB * k for k in range(1, 11)]


def test_short_files_stay_in_memory(tmp_path, advice):
    written(tmp_path / "short", [MB, MB])
    assert advice == []


def test_a_file_system_that_takes_no_advice_is_written_all_the_same(tmp_path, monkeypatch):
    def refused(*_):
        raise OSError(22, "Invalid argument")

    monkeypatch.setattr(os, "posix_fadvise", refused)
    content = written(tmp_path / "a", [5 * MB])
    monkeypatch.delattr(os, "posix_fadvise")  # as on macOS
    assert written(tmp_path / "b", [5 * MB]) == content


def test_a_write_that_takes_a_part_goes_on_behind_it(tmp_path, monkeypatch):
    real = os.writev

    def some(descriptor, parts):
        return real(descriptor, [memoryview(parts[0])[:1000]])

    monkeypatch.setattr(os, "writev", some)
    content = written(tmp_path / "bits", [10_000, 1, 7])
    assert (tmp_path / "bits").read_bytes() == content
