"""What a TorchScript file does besides computing, found without running it.

TorchScript is a language: its programs can write files (``torch.save``, ``torch.from_file``), and a
class with ``__setstate__`` runs while the file is loaded.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, BinaryIO

import torch

__all__ = ["code_at_loading", "operations_beyond"]

_CODE = "code/"
_AT_LOADING = b"__setstate__"
_COMPUTING = ("aten", "prim", "quantized")
"""Namespaces of operations that compute."""
_BEYOND = ("aten::save", "aten::from_file", "prim::PythonOp")
_CALLS = ("prim::CallMethod", "prim::CallFunction")
"""Calls that are not inlined: what they do is not known before they are made."""
_REMOTE = "prim::rpc_"
_GRAPHS = "g"


def code_at_loading(stream: BinaryIO) -> list[str]:
    """Return what would be run when a TorchScript file is loaded; rewinds the stream.

    Args:
        stream: The file; it is read as torch reads it.

    Raises:
        RuntimeError: If it is no archive of torch.
    """
    stream.seek(0)
    archive: Any = torch._C.PyTorchFileReader(stream)
    records = [name for name in archive.get_all_records() if name.startswith(_CODE)]
    found = [name for name in records if _AT_LOADING in archive.get_record(name)]
    stream.seek(0)
    return [f"{_AT_LOADING.decode()} in {name}" for name in found]


def operations_beyond(module: torch.jit.ScriptModule) -> list[str]:
    """Return the operations of a loaded module that do more than compute, or are not known to.

    Args:
        module: The module; nothing of it is run.
    """
    names: dict[str, None] = {}
    for part in module.modules():
        compiled: Any = getattr(part, "_c", None)
        for name in compiled._method_names() if compiled is not None else ():
            graph = compiled._get_method(name).inlined_graph
            names |= dict.fromkeys(kind for kind in _kinds(graph) if _is_beyond(kind))
    return list(names)


def _is_beyond(kind: str) -> bool:
    unknown = kind.partition("::")[0] not in _COMPUTING
    return unknown or kind in (*_BEYOND, *_CALLS) or kind.startswith(_REMOTE)


def _kinds(block: Any) -> Iterator[str]:
    """The operations of a graph or block, of blocks inside it, and of graphs in attributes."""
    for node in block.nodes():
        yield node.kind()
        for inner in node.blocks():
            yield from _kinds(inner)
        for name in node.attributeNames():
            if node.kindOf(name) == _GRAPHS:
                yield from _kinds(node.g(name))
