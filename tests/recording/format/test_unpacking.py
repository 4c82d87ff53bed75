"""What is compressed unpacks to what the log states, and no further."""

import io
import json
import tracemalloc
import zipfile

import pytest
import zstandard

from embodichain.recording import inspect, verify
from embodichain.recording.format.container.unpacking import (
    listed,
    most_unpacked,
    unpack_zip,
    unpack_zstd,
    unpacked_size,
)
from embodichain.recording.format.log_error import DamageError
from embodichain.recording.format.seals import digest_of, sealed
from tests.recording.rewrite import as_before, rewrite

MB = 2**20


@pytest.fixture(scope="module")
def bomb():
    """2 GB of zeros, packed into some 200 kB."""
    packer = zstandard.ZstdCompressor().compressobj(size=2**31 - MB)
    parts = [packer.compress(bytes(MB)) for _ in range(2047)]
    return b"".join([*parts, packer.flush()])


def peak_of(function):
    """Most bytes that Python held while it ran."""
    tracemalloc.start()
    try:
        function()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_limits_worked_by_hand():
    assert most_unpacked(10, None) == 256 * MB
    assert most_unpacked(453_000, None) == 453_000_000
    assert most_unpacked(100 * MB, None) == 2**31
    assert most_unpacked(10, 5) == 5
    for stated in (256 * MB + 1, 2**31, -1):
        with pytest.raises(DamageError, match="it should unpack"):
            most_unpacked(10, stated)


@pytest.mark.parametrize("old", [False, True], ids=["stated", "earlier version"])
def test_a_model_that_unpacks_to_gigabytes_is_refused(record, tmp_path, bomb, old):
    """With the size of the recorded model stated, and in a log that states none."""
    path = as_before(record(), tmp_path / "old.mcap") if old else record()
    recorded = 0

    def attachment(name, data):
        nonlocal recorded
        if name != "model.mjb.zst":
            return data
        recorded = unpacked_size(name, data)
        return bomb

    def metadata(name, values):
        if "attachments" not in values:
            return values
        listed = json.loads(values["attachments"])
        listed["model.mjb.zst"][0] = recorded
        return sealed(name, {**values, "attachments": json.dumps(listed)})

    bad = rewrite(path, tmp_path / "bad.mcap", attachment=attachment, metadata=metadata, seal=False)
    assert bad.stat().st_size < MB
    reports = []
    assert peak_of(lambda: reports.append(verify(bad))) < 16 * MB
    assert not reports[0].ok
    assert peak_of(lambda: inspect(bad)) < 16 * MB
    assert inspect(bad).warnings


def test_a_log_that_states_gigabytes_is_refused(record, tmp_path, bomb):
    """All digests are right, and the metadata state what the model unpacks to."""
    bad = rewrite(
        record(),
        tmp_path / "bad.mcap",
        attachment=lambda name, data: bomb if name == "model.mjb.zst" else data,
    )
    reports = []
    assert peak_of(lambda: reports.append(verify(bad))) < 16 * MB
    assert reports[0].damage == []  # each byte is as it was written
    (problem,) = reports[0].problems
    assert problem.startswith("the attachment model.mjb.zst is damaged: it should unpack from ")


def test_a_frame_that_states_less_than_it_has(bomb):
    small = zstandard.compress(bytes(1000))
    assert unpack_zstd(small, 1000) == unpack_zstd(small, None) == bytes(1000)
    for stated in (999, 1001):
        with pytest.raises(DamageError):
            unpack_zstd(small, stated)
    # a frame header: magic, descriptor, window, size: a lie about the size
    lying = bytearray(zstandard.ZstdCompressor().compress(bytes(40 * MB)))
    at = bytes(lying).index((40 * MB).to_bytes(4, "little"))
    lying[at : at + 4] = (5 * MB).to_bytes(4, "little")
    assert peak_of(lambda: pytest.raises(DamageError, unpack_zstd, bytes(lying), None)) < 16 * MB
    with pytest.raises(DamageError, match="announces -1"):
        unpack_zstd(zstandard.ZstdCompressor(write_content_size=False).compress(bytes(MB)), None)
    for cut in (3, 8, len(small) - 1):
        with pytest.raises(DamageError):
            unpack_zstd(small[:cut], None)


def archive(content, kind=zipfile.ZIP_DEFLATED):
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", kind) as file:
        file.writestr("model.xml", content)
    return out.getvalue()


def test_an_archive_that_announces_less_than_it_has():
    """A file of 40 MB that says it has 1000 bytes: it is not unpacked to see."""
    good = archive(bytes(40 * MB))
    assert unpack_zip(good, 40 * MB) == unpack_zip(good, None) == {"model.xml": bytes(40 * MB)}
    lying = good.replace((40 * MB).to_bytes(4, "little"), (1000).to_bytes(4, "little"))
    assert peak_of(lambda: pytest.raises(DamageError, unpack_zip, lying, None)) < 16 * MB
    with pytest.raises(DamageError, match="announces"):
        unpack_zip(good, 39 * MB)
    with pytest.raises(DamageError, match="announces"):
        unpack_zip(archive(bytes(300 * MB)), None)


@pytest.mark.parametrize("kind", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_archives_are_packed_as_recorders_do(kind):
    with pytest.raises(DamageError, match="model.xml has a compression that logs do not use"):
        unpack_zip(archive(b"<mujoco/>", kind), None)


def test_the_recorder_says_what_could_not_be_read_again(caplog):
    packed = zstandard.compress(bytes(300 * MB))
    assert listed([("model.mjb.zst", "", packed), ("config.yaml", "", b"seed: 1\n")]) == {
        "model.mjb.zst": (300 * MB, digest_of(packed)),
        "config.yaml": (8, digest_of(b"seed: 1\n")),
    }
    (said,) = caplog.messages
    assert said.startswith("the log cannot be verified: its attachment model.mjb.zst: it should ")


def test_what_is_no_archive():
    for data in (b"", b"PK", archive(b"<mujoco/>")[:-30]):
        with pytest.raises(DamageError):
            unpack_zip(data, None)
