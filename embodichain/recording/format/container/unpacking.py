"""Unpacks compressed attachments of a log, no further than a limit that is known beforehand.

The limit is the size that the log's metadata states. That size is trusted only if the packed data
make it likely: a few bytes that unpack to gigabytes are refused before anything is unpacked. Logs
of earlier versions do not state a size; their limit is that bound alone.
"""

from __future__ import annotations

import io
import logging
import zipfile
import zlib
from collections.abc import Iterable, Iterator

import zstandard

from embodichain.recording.format.log_error import DamageError
from embodichain.recording.format.seals import digest_of

__all__ = ["listed", "most_unpacked", "unpack_zip", "unpack_zstd", "unpacked_size"]

_log = logging.getLogger(__name__)
_ALWAYS_ALLOWED = 2**28
"""Size in bytes to which data of any size may unpack."""
_LARGEST_RATIO = 1000
"""Factor by which larger data may grow when unpacked; models of shipped tasks reach 23."""
_LARGEST = 2**31
"""Size in bytes above which data of any size is refused."""
_LARGEST_ZIP = 2**29
_LARGEST_WINDOW = 2**27
"""Bytes of unpacked data to which zstd may refer back."""
_PIECE_BYTES = 2**20
_ZIP_COMPRESSIONS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""Compressions within archives; the others unpack in steps that have no limit."""


def most_unpacked(packed: int, stated: int | None, largest: int = _LARGEST) -> int:
    """Bytes to which data may unpack.

    Args:
        packed: Their size.
        stated: The size that the log's metadata states; None if it states none.
        largest: A limit for data of any size.

    Raises:
        DamageError: If the stated size is not likely.
    """
    bound = min(max(_ALWAYS_ALLOWED, _LARGEST_RATIO * packed), largest)
    if stated is None:
        return bound
    if not 0 <= stated <= bound:
        raise DamageError(
            f"it should unpack from {packed} bytes to {stated}; at most {bound} are allowed"
        )
    return stated


def unpacked_size(name: str, data: bytes) -> int:
    """Bytes to which an attachment unpacks, for the metadata of a new log.

    Args:
        name: Its name, whose suffix says how it is packed.
        data: Its content, from the recorder.
    """
    if name.endswith(".zst"):
        size: int = zstandard.frame_content_size(data)
        return size
    if name.endswith(".mjz"):
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            return sum(info.file_size for info in archive.infolist())
    return len(data)


def listed(attachments: Iterable[tuple[str, str, bytes]]) -> dict[str, tuple[int, str]]:
    """Name -> unpacked size and digest of the attachments of a new log, for its metadata.

    Args:
        attachments: Name, media type and content of each.
    """
    entries = {}
    for name, _, data in attachments:
        size = unpacked_size(name, data)
        try:
            most_unpacked(len(data), size)
        except DamageError as error:
            _log.warning("the log cannot be verified: its attachment %s: %s", name, error)
        entries[name] = (size, digest_of(data))
    return entries


def unpack_zstd(data: bytes, stated: int | None) -> bytes:
    """Unpack a zstd frame.

    Args:
        data: The frame.
        stated: Its size according to the log's metadata; None if it states none.

    Raises:
        DamageError: If it is damaged, or larger than stated, or than it may be.
    """
    most = most_unpacked(len(data), stated)
    try:
        announced = zstandard.frame_content_size(data)
        if not 0 <= announced <= most:
            raise DamageError(f"it announces {announced} bytes, at most {most} are unpacked")
        decompressor = zstandard.ZstdDecompressor(max_window_size=_LARGEST_WINDOW)
        reader = decompressor.stream_reader(data)
        content = _join_pieces(iter(lambda: reader.read(_PIECE_BYTES), b""), announced)
    except zstandard.ZstdError as error:
        raise DamageError(str(error)) from error
    if len(content) != announced or stated not in (None, announced):
        expected = announced if stated is None else stated
        raise DamageError(f"it has {len(content)} bytes where {expected} are expected")
    return content


def unpack_zip(data: bytes, stated: int | None) -> dict[str, bytes]:
    """Unpack the files of an archive, by name.

    Args:
        data: The archive.
        stated: Size of all its files according to the log's metadata; None if it states none.

    Raises:
        DamageError: If it is damaged, or larger than stated, or than it may be.
    """
    most = most_unpacked(len(data), stated, _LARGEST_ZIP)
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            infos = archive.infolist()
            announced = sum(info.file_size for info in infos)
            if announced > most:
                raise DamageError(f"it announces {announced} bytes, at most {most} are unpacked")
            return {info.filename: _unpack_file(archive, info) for info in infos}
    except (zipfile.BadZipFile, zlib.error, NotImplementedError, EOFError) as error:
        raise DamageError(repr(error)) from error
    except (RuntimeError, ValueError, OSError) as error:  # encrypted, or impossible offsets
        raise DamageError(repr(error)) from error


def _unpack_file(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> bytes:
    if info.compress_type not in _ZIP_COMPRESSIONS:
        raise DamageError(f"{info.filename} has a compression that logs do not use")
    with archive.open(info) as stream:
        # In pieces: a single `read` unpacks everything before it looks at the announced size.
        return _join_pieces(iter(lambda: stream.read(_PIECE_BYTES), b""), info.file_size)


def _join_pieces(pieces: Iterator[bytes], most: int) -> bytes:
    out = io.BytesIO()
    for piece in pieces:
        if out.tell() + len(piece) > most:
            raise DamageError(f"it unpacks to more than {most} bytes")
        out.write(piece)
    return out.getvalue()
