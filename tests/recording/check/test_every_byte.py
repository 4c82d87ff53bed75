"""`verify` finds every changed byte, says which record it is in, and believes nothing of it."""

import struct
import zlib

import pytest
from mcap.opcode import Opcode

import embodichain.recording as recording
from embodichain.cli import main
from embodichain.recording import verify
from embodichain.recording.format.options import RecordOptions
from embodichain.recording.format.seals import SEAL, check_seal, sealed
from embodichain.recording.read.chunks import MAGIC
from embodichain.recording.read.recover import recover
from embodichain.utils.errors import ConfigError
from scripts.flip_bits import UNCOVERED, flips
from scripts.flip_bits import record as small_log
from tests.recording.rewrite import as_before, rewrite

pytestmark = pytest.mark.slow


def records(data):
    """(opcode, offset of the record, its bytes) of each record of a whole file."""
    found, at = [], len(MAGIC)
    while at < len(data) - len(MAGIC):
        opcode, length = struct.unpack_from("<BQ", data, at)
        found.append((opcode, at, data[at : at + 9 + length]))
        at += 9 + length
    return found


def place(data, opcode, number=0):
    """Offset and bytes of a record."""
    return [(at, body) for kind, at, body in records(data) if kind == opcode][number]


def flipped(path, target, *places, bit=0):
    """A copy with a bit of these bytes flipped."""
    data = bytearray(path.read_bytes())
    for at in places:
        data[at] ^= 1 << bit
    target.write_bytes(data)
    return target


def patched(path, target, at, new):
    """A copy with some bytes replaced, and the right checksum in DATA_END."""
    data = bytearray(path.read_bytes())
    data[at : at + len(new)] = new
    end, _ = place(bytes(data), Opcode.DATA_END)
    data[end + 9 : end + 13] = struct.pack("<I", zlib.crc32(data[:end]))
    target.write_bytes(data)
    return target


@pytest.mark.unmeasured
def test_no_changed_byte_goes_unnoticed(tmp_path):
    """Every byte outside of chunks, and each 101st of those inside."""
    path = small_log(tmp_path / "log.mcap")
    data = path.read_bytes()
    chunks = [range(at, at + len(body)) for kind, at, body in records(data) if kind == Opcode.CHUNK]
    assert len(chunks) > 1
    inside = {at for chunk in chunks for at in chunk}
    offsets = [at for at in range(len(data)) if at not in inside]
    offsets += [at for chunk in chunks for at in chunk[::101]]
    found = list(flips(path, offsets))
    assert len(found) == len(offsets)
    assert [flip for flip in found if not flip.found] == []
    assert UNCOVERED == {}
    # they are found in the bytes, none of them by physics, and none is another program's error
    assert {flip.first for flip in found} == {
        *("opening magic", "header", "attachment", "metadata", "chunk", "message index"),
        *("head of a record", "record", "data section", "DATA_END"),
        *("index", "index and footer", "footer", "closing magic"),
    }
    assert verify(path).ok  # the file is as it was


def test_a_changed_seed_is_named_and_not_believed(record, tmp_path, capsys):
    path = record()
    at, body = place(path.read_bytes(), Opcode.METADATA)
    bad = flipped(path, tmp_path / "bad.mcap", at + body.index(b"seed") + len("seed") + 4)
    assert main(["replay", str(bad), "--verify"]) == 1
    said = capsys.readouterr().err
    expected = (
        f"{bad}: NOT verified: {len(body)} bytes of the file are damaged: "
        f"metadata 'embodichain' at byte {at} (its digest is wrong)\n"
    )
    assert said == expected
    with pytest.raises(ConfigError, match=r"bad\.mcap: the metadata record .* digest is wrong"):
        recording.open(bad)
    with pytest.raises(ConfigError, match="digest is wrong"):
        recover(bad, tmp_path / "saved.mcap")
    report = verify(bad)
    (damage,) = report.damage
    assert (damage.kind, damage.name, damage.offset) == ("metadata", "'embodichain'", at)
    assert (damage.nbytes, report.envs, report.steps) == (len(body), 0, 0)


@pytest.mark.parametrize("what", ["value", "key"])
def test_a_change_of_the_digest_itself_is_found(record, tmp_path, what):
    path = record()
    at, body = place(path.read_bytes(), Opcode.METADATA)
    key = body.rindex(SEAL.encode())
    bad = flipped(path, tmp_path / "bad.mcap", at + key + (0 if what == "key" else 14))
    (damage,) = verify(bad).damage
    assert (damage.kind, damage.name) == ("metadata", "'embodichain'")


def test_digests_of_metadata():
    values = {"seed": "3", "task": "reach"}
    record = sealed("embodichain", values)
    assert check_seal("embodichain", record)
    assert not check_seal("embodichain", values)
    assert sealed("embodichain", dict(reversed(values.items())))[SEAL] == record[SEAL]
    # what is in one text must not be as good in another
    assert sealed("embodichain", {"seed": "3task", "": "reach"})[SEAL] != record[SEAL]
    assert sealed("embodichain.end", values)[SEAL] != record[SEAL]


def test_a_swapped_attachment_with_right_checksums_is_found(record, tmp_path):
    def attachment(name, data):
        return b"seed: 9\n" if name == "config.yaml" else data

    bad = rewrite(record(), tmp_path / "bad.mcap", attachment=attachment, seal=False)
    report = verify(bad)
    (damage,) = report.damage
    assert (damage.kind, damage.name, damage.why) == (
        *("attachment", "'config.yaml'"),
        "its digest is wrong",
    )
    with recording.open(bad) as log, pytest.raises(ConfigError, match="digest is wrong"):
        log.attachment("config.yaml")


@pytest.mark.parametrize("name", ["config.yaml", "overrides.yaml", "versions.json", "scene.mjz"])
def test_a_changed_attachment_is_named(record, tmp_path, name):
    path = record()
    data = path.read_bytes()
    at, body = next(
        (at, b) for k, at, b in records(data) if k == Opcode.ATTACHMENT and name.encode() in b
    )
    bad = flipped(path, tmp_path / "bad.mcap", at + len(body) - 6)
    (damage,) = verify(bad).damage
    assert (damage.kind, damage.name, damage.offset) == ("attachment", repr(name), at)


def test_a_changed_message_index_is_named(record, tmp_path):
    path = record()
    at, _ = place(path.read_bytes(), Opcode.MESSAGE_INDEX)
    for offset in (9, 11, 15, 23):  # channel, length, time, place
        (damage,) = verify(flipped(path, tmp_path / "bad.mcap", at + offset)).damage
        assert (damage.kind, damage.offset) == ("message index", at)


def test_checksums_that_are_zero_are_not_believed(record, tmp_path):
    path = record()
    data = path.read_bytes()
    chunk, _ = place(data, Opcode.CHUNK)
    # times, uncompressed size, checksum
    bad = patched(path, tmp_path / "chunk.mcap", chunk + 9 + 24, bytes(4))
    (damage,) = verify(bad).damage
    assert (damage.kind, damage.name, damage.offset) == ("chunk", "0", chunk)
    end, _ = place(data, Opcode.DATA_END)
    whole = tmp_path / "end.mcap"
    whole.write_bytes(data[: end + 9] + bytes(4) + data[end + 13 :])
    (damage,) = verify(whole).damage
    assert (damage.kind, damage.why) == ("DATA_END", "it has no checksum")
    footer, body = place(data, Opcode.FOOTER)
    whole.write_bytes(data[: footer + 25] + bytes(4) + data[footer + 29 :])
    assert len(body) == 29
    assert verify(whole).damage[0].kind == "index and footer"


def test_an_attachment_without_a_checksum_is_not_believed(record, tmp_path):
    path = record()
    at, body = place(path.read_bytes(), Opcode.ATTACHMENT, 2)
    bad = patched(path, tmp_path / "bad.mcap", at + len(body) - 4, bytes(4))
    assert verify(bad).damage[0].kind == "attachment"


def test_a_chunk_whose_times_are_not_its_messages_is_found(record, tmp_path):
    path = record()
    at, body = place(path.read_bytes(), Opcode.CHUNK)
    (start,) = struct.unpack_from("<Q", body, 9)
    bad = patched(path, tmp_path / "bad.mcap", at + 9, struct.pack("<Q", start + 1))
    (damage,) = verify(bad).damage
    assert damage.why == "its times are not those of its messages"


def test_what_follows_the_end_is_no_log(record, tmp_path):
    path = record()
    size = path.stat().st_size
    with path.open("ab") as stream:
        stream.write(b"more")
    (damage,) = verify(path).damage
    assert (damage.kind, damage.offset, damage.nbytes) == ("rest", size, 4)


def test_a_file_without_an_end_is_checked_as_far_as_it_goes(record, tmp_path):
    """A killed run has no checksum of everything: each record has its own, or a digest."""
    whole = record(steps=40, options=RecordOptions(compression="none"))
    data = whole.read_bytes()
    last, body = place(data, Opcode.CHUNK, -1)
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[: last + len(body) // 2])
    report = verify(cut)
    assert report.damage == [] and not report.ok
    assert "the file ends early: it was not closed, or cut" in report.problems[0]
    for kind, at, record_bytes in records(data):
        if at >= last:
            break
        middle = at + 9 + (len(record_bytes) - 9) // 2
        (damage,) = verify(flipped(cut, tmp_path / "bad.mcap", middle)).damage
        assert damage.offset == at, (kind, damage)


def test_a_changed_byte_of_a_later_file_is_named_with_it(record, tmp_path):
    options = RecordOptions(max_mb=0.02, compression="none")
    first = record(steps=600, num_envs=20, options=options)
    second = tmp_path / "log_0001.mcap"
    assert verify(first).ok
    data = second.read_bytes()
    for kind in (Opcode.ATTACHMENT, Opcode.METADATA, Opcode.CHUNK):
        at, body = place(data, kind)
        flipped(second, second, at + len(body) - 9)
        report = verify(first)
        (damage,) = report.damage
        assert (damage.file, damage.offset) == ("log_0001.mcap", at)
        assert report.steps == 0
        second.write_bytes(data)
    assert verify(first).ok


def test_a_recovered_log_is_covered_again(record, tmp_path):
    path = record(steps=30, options=RecordOptions(compression="none"))
    data = path.read_bytes()
    at, body = place(data, Opcode.ATTACHMENT, 2)
    last, chunk = place(data, Opcode.CHUNK, -1)
    broken = flipped(path, tmp_path / "broken.mcap", at + len(body) - 6)
    saved = tmp_path / "saved.mcap"
    assert recover(broken, saved).damage == "the attachment config.yaml is damaged"
    report = verify(saved)
    assert report.ok and report.damage == []
    assert report.notes == ["the log ends after step 29: the attachment config.yaml is damaged"]
    with recording.open(saved) as log:
        assert "config.yaml" not in log.header.attachments
    again = flipped(
        saved, tmp_path / "again.mcap", place(saved.read_bytes(), Opcode.METADATA)[0] + 99
    )
    assert verify(again).damage[0].kind == "metadata"


def test_logs_of_earlier_versions_verify_and_say_what_is_not_covered(record, tmp_path):
    old = as_before(record(), tmp_path / "old.mcap")
    data = old.read_bytes()
    nbytes = sum(
        len(body) - 9 for kind, _, body in records(data) if kind in (Opcode.HEADER, Opcode.METADATA)
    )
    report = verify(old)
    assert report.ok
    assert report.notes == [
        "an earlier version wrote this log, whose metadata have no digest: "
        f"a change in {nbytes} bytes of metadata and headers is not found"
    ]
    assert str(report).startswith("verified: 20 steps of 3 environments are identical to the bit\n")
    # what has a checksum is found as before, and the rest of what has one now
    for kind in (Opcode.ATTACHMENT, Opcode.CHUNK, Opcode.MESSAGE_INDEX, Opcode.DATA_END):
        at, body = place(data, kind)
        assert not verify(flipped(old, tmp_path / "bad.mcap", at + len(body) - 2)).ok, kind


@pytest.mark.parametrize("engine", ["evil", "mujoco_warp", "Mujoco", "mujoco 4.0.0", ""])
def test_an_unknown_engine_is_not_verified(record, tmp_path, engine):
    def metadata(name, values):
        return {**values, "engine": engine} if name == "embodichain" else values

    report = verify(rewrite(record(), tmp_path / "other.mcap", metadata=metadata))
    assert not report.ok and report.steps == 0
    assert report.problems == [
        f"it was recorded with {engine!r}, an engine that is not registered here; there are: "
        "mujoco, warp. A package that has it has an entry point of the group embodichain.engines"
    ]


def test_a_log_without_a_step_is_not_verified(record):
    report = verify(record(steps=0))
    assert not report.ok
    assert report.problems == ["the log has no control step: there is nothing to compare"]
    assert main(["replay", str(report.path), "--verify"]) == 1
