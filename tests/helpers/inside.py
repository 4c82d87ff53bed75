"""Looks for text in every byte of a folder, also inside of what is compressed or indexed."""

import gzip
import io
import zipfile
from collections.abc import Iterator
from pathlib import Path

import zstandard
from mcap.records import Attachment, Chunk
from mcap.stream_reader import StreamReader, get_chunk_data_stream


def places_of(text: str, folder: Path) -> list[str]:
    """Return files, and places in them, that have a text."""
    word, found = text.encode(), []
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        if text in name:
            found.append(f"the name {name}")
        if path.is_file():
            found += [where for where, data in _layers(name, path.read_bytes()) if word in data]
    return found


def _layers(name: str, data: bytes) -> Iterator[tuple[str, bytes]]:
    """Bytes, and what they are when they are unpacked, with names."""
    yield name, data
    if data.startswith(b"PK\x03\x04"):
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            for entry in archive.namelist():
                yield from _layers(f"{name}/{entry}", archive.read(entry))
    elif data.startswith(b"\x1f\x8b"):
        yield from _layers(f"{name} unpacked", gzip.decompress(data))
    elif data.startswith(b"\x28\xb5\x2f\xfd"):
        whole = zstandard.ZstdDecompressor().decompressobj().decompress(data)
        yield from _layers(f"{name} unpacked", whole)
    elif data.startswith(b"\x89MCAP"):
        yield from _records(name, data)
    elif data.startswith(b"\x89HDF"):
        yield from _hdf5(name, data)
    elif data.startswith(b"PAR1"):
        import pyarrow.parquet

        table = pyarrow.parquet.read_table(io.BytesIO(data))
        yield f"{name} as a table", f"{table.schema.metadata} {table.to_pylist()}".encode()


def _records(name: str, data: bytes) -> Iterator[tuple[str, bytes]]:
    for record in StreamReader(io.BytesIO(data), emit_chunks=True).records:
        if isinstance(record, Chunk):
            stream, size = get_chunk_data_stream(record, validate_crc=False)
            yield f"{name}: a chunk", stream.read(size)
        elif isinstance(record, Attachment):
            yield from _layers(f"{name}: {record.name}", record.data)
        else:
            yield f"{name}: {type(record).__name__}", repr(record).encode()


def _hdf5(name: str, data: bytes) -> Iterator[tuple[str, bytes]]:
    import h5py

    with h5py.File(io.BytesIO(data)) as file:
        found = [repr(dict(file.attrs))]
        file.visititems(lambda path, node: found.append(f"{path} {dict(node.attrs)}"))
        texts = (node for node in file.values() if isinstance(node, h5py.Dataset))
        found += [repr(node[...]) for node in texts if node.dtype.kind in "OS"]
    yield f"{name} as a tree", "\n".join(found).encode()
