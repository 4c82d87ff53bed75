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
_COMPUTING_NAMESPACES = ("aten", "prim", "quantized")
"""Namespaces of operations that compute, apart from the following ones."""
_NOT_COMPUTING = ("aten::save", "aten::from_file", "prim::PythonOp")
_CALLS = ("prim::CallMethod", "prim::CallFunction")
"""Calls that are not inlined: what they do is not known before they are made."""
_REMOTE_CALL = "prim::rpc_"
_GRAPH_ATTRIBUTE = "g"


def code_at_loading(stream: BinaryIO) -> list[str]:
    """Return what would be run when a TorchScript file is loaded; rewinds the stream.

    Args:
        stream: The file; it is read as torch reads it.

    Raises:
        RuntimeError: If it is not an archive of torch.
    """
    stream.seek(0)
    archive: Any = torch._C.PyTorchFileReader(stream)
    code_files = [name for name in archive.get_all_records() if name.startswith(_CODE)]
    run_at_loading = [name for name in code_files if _AT_LOADING in archive.get_record(name)]
    stream.seek(0)
    return [f"{_AT_LOADING.decode()} in {name}" for name in run_at_loading]


def operations_beyond(module: torch.jit.ScriptModule) -> list[str]:
    """Return the operations of a loaded module that do more than compute, or are not known to.

    Args:
        module: The module; nothing of it is run.
    """
    names: list[str] = []
    for submodule in module.modules():
        compiled: Any = getattr(submodule, "_c", None)
        if compiled is None:
            continue
        for method in compiled._method_names():
            graph = compiled._get_method(method).inlined_graph
            names += [name for name in _operations(graph) if not _only_computes(name)]
    return list(dict.fromkeys(names))


def _only_computes(operation: str) -> bool:
    namespace = operation.partition("::")[0]
    if namespace not in _COMPUTING_NAMESPACES:
        return False
    if operation in _NOT_COMPUTING or operation in _CALLS:
        return False
    return not operation.startswith(_REMOTE_CALL)


def _operations(block: Any) -> Iterator[str]:
    """Yield the operations of a graph or block, of blocks in it, and of graphs in attributes."""
    for node in block.nodes():
        yield node.kind()
        for inner in node.blocks():
            yield from _operations(inner)
        for name in node.attributeNames():
            if node.kindOf(name) == _GRAPH_ATTRIBUTE:
                yield from _operations(node.g(name))
