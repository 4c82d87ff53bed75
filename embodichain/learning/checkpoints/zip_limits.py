"""How far the zips of policies and trainings may unpack; it is checked before they are read.

This package, Stable-Baselines3, PyTorch and numpy store the files of their zips without packing
them. A zip that somebody packed may unpack to a multiple of its size, and readers would unpack it
into memory, whatever size it announces.
"""

from __future__ import annotations

import io
import struct
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO

__all__ = ["check_unpacked"]

_ALWAYS_ALLOWED = 2**26
"""Bytes to which the packed files of a zip of any size may unpack."""
_LARGEST_RATIO = 100
"""Times its own size to which a larger one may unpack."""
_LARGEST = 2**30
"""Bytes beyond which packed files may not unpack in any zip."""
_PIECE = 2**20
"""Bytes unpacked at once."""
_INNER_ZIPS = (".pth", ".pt")
"""Files that are zips too, of PyTorch."""
_LOCAL_HEADER = struct.Struct("<4s22xHH")
"""Signature, and lengths of the name and of the extra field, which come before the data."""


def check_unpacked(path: Path) -> None:
    """Check that a zip, and the zips of PyTorch in it, unpack to no more than a limit.

    Packed files are unpacked piece by piece; of these only zips in zips are kept.

    Args:
        path: The zip.

    Raises:
        zipfile.BadZipFile: If it is not a zip, is damaged, or would unpack further.
        OSError: If it cannot be read.
    """
    with path.open("rb") as stream:
        _check(stream)


def _check(stream: IO[bytes]) -> None:
    try:
        with zipfile.ZipFile(stream) as archive:
            infos = archive.infolist()
            packed = sum(info.compress_size for info in infos)
            if packed > stream.seek(0, io.SEEK_END):
                raise zipfile.BadZipFile("its files overlap")
            remaining = min(max(_ALWAYS_ALLOWED, _LARGEST_RATIO * packed), _LARGEST)
            for info in infos:
                if info.compress_type != zipfile.ZIP_STORED:
                    remaining -= _check_packed(stream, info, remaining)
                elif info.file_size != info.compress_size:
                    raise zipfile.BadZipFile(f"{info.filename} announces another size than it has")
                elif info.filename.endswith(_INNER_ZIPS):
                    _check_inner(io.BytesIO(archive.read(info)))
    except (zlib.error, struct.error, NotImplementedError, RuntimeError, ValueError) as error:
        raise zipfile.BadZipFile(str(error)) from error


def _check_packed(stream: IO[bytes], info: zipfile.ZipInfo, most: int) -> int:
    """Check a packed file; returns its size."""
    if info.compress_type != zipfile.ZIP_DEFLATED:  # others unpack in steps without a limit
        raise zipfile.BadZipFile(f"{info.filename} is packed in a way that no policy is")
    inner = io.BytesIO()
    size = 0
    for piece in _unpacked(stream, info):
        size += len(piece)
        if size > most:
            message = f"{info.filename} unpacks to more than {most} bytes, which no policy does"
            raise zipfile.BadZipFile(message)
        if info.filename.endswith(_INNER_ZIPS):
            inner.write(piece)
    if size != info.file_size:
        raise zipfile.BadZipFile(f"{info.filename} announces another size than it has")
    _check_inner(inner)
    return size


def _unpacked(stream: IO[bytes], info: zipfile.ZipInfo) -> Iterator[bytes]:
    """Unpack a file in pieces, to its end.

    `ZipFile.open` stops at the size that the zip announces, which other readers look at later.
    """
    stream.seek(info.header_offset)
    _, name_length, extra_length = _LOCAL_HEADER.unpack(stream.read(_LOCAL_HEADER.size))
    stream.seek(name_length + extra_length, io.SEEK_CUR)
    remaining = info.compress_size
    inflate = zlib.decompressobj(-zlib.MAX_WBITS)
    while remaining and not inflate.eof:
        packed = stream.read(min(remaining, _PIECE))
        if not packed:
            raise zipfile.BadZipFile(f"{info.filename} is cut")
        remaining -= len(packed)
        while packed and not inflate.eof:
            yield inflate.decompress(packed, _PIECE)
            packed = inflate.unconsumed_tail


def _check_inner(stream: IO[bytes]) -> None:
    """Check a zip in a zip, if it is one."""
    if zipfile.is_zipfile(stream):
        _check(stream)
