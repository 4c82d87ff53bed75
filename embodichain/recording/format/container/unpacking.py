"""Unpacks compressed attachments of a log, no further than a limit that is known beforehand.

The limit is what the log's metadata states. A statement is believed only where the packed data
make it likely: a few bytes that unpack to gigabytes are refused before anything is unpacked. Logs
of earlier versions state nothing; theirs is that bound alone.
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
_ALWAYS = 2**28
"""Bytes to which data of any size may unpack."""
_RATIO = 1000
"""Times its own size to which larger data may unpack; models of shipped tasks reach 23."""
_LARGEST = 2**31
"""Bytes to which nothing may unpack, however large it is."""
_LARGEST_ZIP = 2**29
_WINDOW = 2**27
"""Bytes that zstd may keep of what it has unpacked before."""
_PIECE = 2**20
_KINDS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""Compressions within archives; the others unpack in steps that have no limit."""


def most_unpacked(packed: int, stated: int | None, largest: int = _LARGEST) -> int:
    """Bytes to which data may unpack.

    Args:
        packed: Their size.
        stated: The size that the log's metadata states; None if it states none.
        largest: A limit for data of any size.

    Raises:
        DamageError: If the statement is not likely.
    """
    bound = min(max(_ALWAYS, _RATIO * packed), largest)
    if stated is None:
        return bound
    if not 0 <= stated <= bound:
        raise DamageError(f"it is to unpack from {packed} bytes to {stated}: at most {bound}")
    return stated


def unpacked_size(name: str, data: bytes) -> int:
    """Bytes to which an attachment unpacks, for the metadata of a new log.

    Args:
        name: Its name, which says how it is packed.
        data: What the recorder packed.
    """
    if name.endswith(".zst"):
        size: int = zstandard.frame_content_size(data)
        return size
    if name.endswith(".mjz"):
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            return sum(info.file_size for info in archive.infolist())
    return len(data)


def listed(attachments: Iterable[tuple[str, str, bytes]]) -> dict[str, tuple[int, str]]:
    """Name to unpacked size and digest of the attachments of a new log, for its metadata.

    Args:
        attachments: Name, media type and content of each.
    """
    found = {}
    for name, _, data in attachments:
        size = unpacked_size(name, data)
        try:
            most_unpacked(len(data), size)
        except DamageError as error:
            _log.warning("the log cannot be verified: its attachment %s: %s", name, error)
        found[name] = size, digest_of(data)
    return found


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
        reader = zstandard.ZstdDecompressor(max_window_size=_WINDOW).stream_reader(data)
        content = _gathered(iter(lambda: reader.read(_PIECE), b""), announced)
    except zstandard.ZstdError as error:
        raise DamageError(str(error)) from error
    if len(content) != announced or stated not in (None, announced):
        wanted = announced if stated is None else stated
        raise DamageError(f"it has {len(content)} bytes where {wanted} are expected")
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
            return {info.filename: _file_of(archive, info) for info in infos}
    except (zipfile.BadZipFile, zlib.error, NotImplementedError, EOFError) as error:
        raise DamageError(repr(error)) from error
    except (RuntimeError, ValueError, OSError) as error:  # encrypted, or impossible offsets
        raise DamageError(repr(error)) from error


def _file_of(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> bytes:
    if info.compress_type not in _KINDS:
        raise DamageError(f"{info.filename} is packed in a way that no log has")
    with archive.open(info) as stream:
        # In pieces: at once, `read` unpacks everything before it looks at the announced size.
        return _gathered(iter(lambda: stream.read(_PIECE), b""), info.file_size)


def _gathered(pieces: Iterator[bytes], most: int) -> bytes:
    out = io.BytesIO()
    for piece in pieces:
        if out.tell() + len(piece) > most:
            raise DamageError(f"it unpacks to more than {most} bytes")
        out.write(piece)
    return out.getvalue()
