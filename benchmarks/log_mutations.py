"""Mutated logs for `log_fuzz`: one file and a number give one damaged file, always the same.

Some mutations are accidents (cuts, flipped bits, blocks of zeros), others lie: lengths, sizes,
chunks that unpack to gigabytes, messages and metadata changed under checksums that are right.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from random import Random

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.opcode import Opcode

from embodichain.recording.format.container.mcap_records import chunk_content, parse
from embodichain.recording.format.log_error import DamageError
from embodichain.recording.format.seals import SEAL, sealed
from embodichain.recording.read.chunks import MAGIC

__all__ = ["KINDS", "mutate"]

_HEAD = struct.Struct("<BQ")
_LIES = (0, 1, 7, 2**16, 2**28, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**63 - 1, 2**64 - 1)
_MESSAGE_HEAD = 800
"""About as many bytes of a message are no arrays."""
_BOMB_BYTES = 3 * 2**30
_BOMBS: dict[str, bytes] = {}

Mutation = Callable[[bytes, Random], bytes]


def mutate(data: bytes, seed: int) -> tuple[str, bytes]:
    """Damage a log; returns the kind of damage and the new file."""
    kind = list(KINDS)[seed % len(KINDS)]
    mutated = KINDS[kind](data, Random(seed))
    return kind, _sealed(mutated) if kind in _LYING else mutated


def _sealed(data: bytes) -> bytes:
    """The file with the right digests of its metadata, and the right checksum in DATA_END."""
    out = bytearray(MAGIC)
    for at, opcode, length in _records(data):
        body = data[at + _HEAD.size : at + _HEAD.size + length]
        if opcode == Opcode.METADATA:
            body = _resealed(body)
        elif opcode == Opcode.DATA_END:
            body = struct.pack("<I", zlib.crc32(out))
        out += _HEAD.pack(opcode, len(body)) + body
    return bytes(out + MAGIC)


def _resealed(body: bytes) -> bytes:
    """A metadata record with its digest made anew; as it is where it can no longer be read."""
    try:
        found = parse(Opcode.METADATA, body)
    except DamageError:
        return body
    if SEAL not in found.metadata:
        return body
    seal = sealed(found.name, found.metadata)[SEAL]
    return body.replace(found.metadata[SEAL].encode(), seal.encode())


def _records(data: bytes) -> list[tuple[int, int, int]]:
    """(offset, opcode, length of the content) of every record of a whole file."""
    found, at = [], len(MAGIC)
    while at < len(data) - len(MAGIC):
        opcode, length = _HEAD.unpack_from(data, at)
        found.append((at, opcode, length))
        at += _HEAD.size + length
    return found


def _cut(data: bytes, rng: Random) -> bytes:
    return data[: rng.randrange(len(data))]


def _flip(data: bytes, rng: Random) -> bytes:
    out = bytearray(data)
    for _ in range(rng.randint(1, 8)):
        out[rng.randrange(len(out))] ^= 1 << rng.randrange(8)
    return bytes(out)


def _overwrite(data: bytes, rng: Random) -> bytes:
    at, size = rng.randrange(len(data)), rng.choice((1, 9, 512, 4096))
    filler = bytes(size) if rng.random() < 0.5 else rng.randbytes(size)
    return data[:at] + filler + data[at + size :]


def _shuffle(data: bytes, rng: Random) -> bytes:
    """Drop, repeat or move a record."""
    pieces = [data[at : at + _HEAD.size + n] for at, _, n in _records(data)]
    one, other = rng.randrange(len(pieces)), rng.randrange(len(pieces))
    what = rng.randrange(3)
    if what:
        pieces.insert(other, pieces[one])
    if what < 2:
        del pieces[one]
    return MAGIC + b"".join(pieces) + MAGIC


def _lie_about_a_record(data: bytes, rng: Random) -> bytes:
    at, opcode, length = rng.choice(_records(data))
    lie = rng.choice((*_LIES, max(0, length - 1), length + 1))
    return data[:at] + _HEAD.pack(opcode, lie) + data[at + _HEAD.size :]


def _lie_within_a_record(data: bytes, rng: Random) -> bytes:
    """Overwrite four or eight bytes with a number, where lengths of texts, maps and data stand."""
    out = bytearray(data)
    for _ in range(rng.randint(1, 3)):
        at, _, length = rng.choice(_records(data))
        layout = rng.choice(("<I", "<Q"))
        room = min(length, 200) - struct.calcsize(layout)
        if room >= 0:
            lie = rng.choice(_LIES) % 2 ** (8 * struct.calcsize(layout))
            struct.pack_into(layout, out, at + _HEAD.size + rng.randint(0, room), lie)
    return bytes(out)


def _chunks(data: bytes) -> list[tuple[int, int]]:
    return [(at, n) for at, opcode, n in _records(data) if opcode == Opcode.CHUNK]


def _replace_chunk(
    data: bytes, place: tuple[int, int], compression: str, packed: bytes, size: int, crc: int
) -> bytes:
    at, length = place
    times = data[at + _HEAD.size : at + _HEAD.size + 16]
    name = compression.encode()
    body = times + struct.pack("<QII", size, crc, len(name)) + name
    body += struct.pack("<Q", len(packed)) + packed
    rest = data[at + _HEAD.size + length :]
    return data[:at] + _HEAD.pack(Opcode.CHUNK, len(body)) + body + rest


def _bomb(data: bytes, rng: Random) -> bytes:
    """A chunk that unpacks to gigabytes, or says so, or says the opposite."""
    compression = rng.choice(("lz4", "zstd"))
    size = rng.choice((_BOMB_BYTES, 2**20, 2**27, 2**64 - 1, 0))
    packed = _bomb_of(compression)
    if rng.random() < 0.3:  # the frame's own statement of its size lies too
        packed = packed[:6] + rng.randbytes(4) + packed[10:]
    return _replace_chunk(data, rng.choice(_chunks(data)), compression, packed, size, 0)


def _bomb_of(compression: str) -> bytes:
    """Gigabytes of zeros, packed; made once."""
    if compression not in _BOMBS:
        block, count = bytes(2**24), _BOMB_BYTES // 2**24
        if compression == "zstd":
            packer = zstandard.ZstdCompressor().compressobj(size=_BOMB_BYTES)
            parts = [packer.compress(block) for _ in range(count)]
            _BOMBS[compression] = b"".join([*parts, packer.flush()])
        else:
            with lz4.frame.LZ4FrameCompressor() as lz:
                parts = [lz.begin(_BOMB_BYTES), *(lz.compress(block) for _ in range(count))]
                _BOMBS[compression] = b"".join([*parts, lz.flush()])
    return _BOMBS[compression]


def _forge_messages(data: bytes, rng: Random) -> bytes:
    """Change bytes of a chunk, half of them where messages begin; the checksum is right."""
    place = rng.choice(_chunks(data))
    start = place[0] + _HEAD.size
    compression, found = chunk_content(data[start : start + place[1]])
    content = bytearray(found)
    begins = _messages(found)
    for _ in range(rng.randint(1, 4)):
        at = rng.randrange(len(content))
        if begins and rng.random() < 0.5:
            at = min(len(content) - 1, rng.choice(begins) + rng.randrange(_MESSAGE_HEAD))
        content[at] = rng.choice((content[at] ^ 1 << rng.randrange(8), 0, 255, rng.randrange(256)))
    raw = bytes(content)
    packers = {"lz4": lz4.frame.compress, "zstd": zstandard.compress, "none": bytes}
    name = "" if compression == "none" else compression
    return _replace_chunk(data, place, name, packers[compression](raw), len(raw), zlib.crc32(raw))


def _messages(content: bytes) -> list[int]:
    """Where the messages of a chunk begin."""
    found, at = [], 0
    while at < len(content):
        opcode, length = _HEAD.unpack_from(content, at)
        if opcode == Opcode.MESSAGE:
            found.append(at + _HEAD.size)
        at += _HEAD.size + length
    return found


def _forge_metadata(data: bytes, rng: Random) -> bytes:
    """Replace a digit of the metadata record by another, or any byte, of a name in it say."""
    places = [(at, n) for at, opcode, n in _records(data) if opcode == Opcode.METADATA]
    at, length = places[0]
    body = data[at + _HEAD.size : at + _HEAD.size + length]
    digits = [i for i, byte in enumerate(body) if chr(byte).isdigit()]
    where = rng.choice(digits if rng.random() < 0.5 else range(len(body)))
    new = rng.choice((*(b"%d" % i for i in range(10)), b"-", b"e", b"[", b'"'))
    start, stop = at + _HEAD.size, at + _HEAD.size + length
    return data[:start] + body[:where] + new + body[where + 1 :] + data[stop:]


def _grow_number(data: bytes, rng: Random) -> bytes:
    """Write a huge number of environments, columns or steps into the metadata."""
    name = rng.choice((b"num_envs", b"nstate", b"substeps", b"start_ns", b"control_dt"))
    value = rng.choice((b"1000000000000", b"-1", b"0", b"16777216", b"1e400", b"NaN", b"null"))
    places = [(at, n) for at, opcode, n in _records(data) if opcode == Opcode.METADATA]
    at, length = places[0]
    body = data[at + _HEAD.size : at + _HEAD.size + length]
    key = body.index(struct.pack("<I", len(name)) + name) + 4 + len(name)
    (old,) = struct.unpack_from("<I", body, key)
    map_at = 4 + struct.unpack_from("<I", body)[0]
    (total,) = struct.unpack_from("<I", body, map_at)
    new = body[:key] + struct.pack("<I", len(value)) + value + body[key + 4 + old :]
    new = new[:map_at] + struct.pack("<I", total + len(value) - old) + new[map_at + 4 :]
    head = _HEAD.pack(Opcode.METADATA, len(new))
    return data[:at] + head + new + data[at + _HEAD.size + length :]


KINDS: dict[str, Mutation] = {
    "cut": _cut,
    "flipped bits": _flip,
    "overwritten": _overwrite,
    "records moved": _shuffle,
    "lying record length": _lie_about_a_record,
    "lying numbers": _lie_within_a_record,
    "compression bomb": _bomb,
    "forged messages": _forge_messages,
    "forged metadata": _forge_metadata,
    "forged sizes": _grow_number,
}
_LYING = ("compression bomb", "forged messages", "forged metadata", "forged sizes")
"""Mutations after which all checksums but the index's are right, so that readers go on."""
