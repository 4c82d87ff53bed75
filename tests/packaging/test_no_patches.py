"""No module, class or function of another package is changed.

Python's own library does not count: `sys.excepthook`, `warnings.showwarning` and the like are there
for programs to set.
"""

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

pytestmark = pytest.mark.unmeasured

ALLOWED = {
    # Only in the process that serves one page; the function's docstring says why.
    "recording/viewers/page/web_guard.py: web_server.serve",
    # Warp's own settings, which it documents as to be set.
    "lab/sim/engine/warp/warp_support.py: warp.config.log_level",
}


def patches(source: str) -> Iterator[str]:
    """Assignments to attributes of what is imported from another package, and `setattr` of it."""
    tree = ast.parse(source)
    foreign: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names = [alias for alias in node.names if _is_foreign(alias.name)]
            foreign |= {alias.asname or alias.name.partition(".")[0] for alias in names}
        elif isinstance(node, ast.ImportFrom) and _is_foreign(node.module or ""):
            foreign |= {alias.asname or alias.name for alias in node.names}
    for node in ast.walk(tree):
        targets: list[ast.expr] = []
        if isinstance(node, ast.Assign | ast.Delete):
            targets = node.targets
        elif isinstance(node, ast.AugAssign | ast.AnnAssign):
            targets = [node.target]
        elif isinstance(node, ast.Call) and ast.unparse(node.func) in ("setattr", "delattr"):
            targets = [ast.Attribute(node.args[0], ast.unparse(node.args[1]))]
        for target in (part for whole in targets for part in _parts(whole)):
            if isinstance(target, ast.Attribute) and ast.unparse(target).split(".")[0] in foreign:
                yield ast.unparse(target)


def _is_foreign(module: str) -> bool:
    top = module.partition(".")[0]
    return top != "embodichain" and top not in sys.stdlib_module_names


def _parts(target: ast.expr) -> list[ast.expr]:
    return list(target.elts) if isinstance(target, ast.Tuple | ast.List) else [target]


def test_nothing_of_another_package_is_patched(repo: Path) -> None:
    package = repo / "embodichain"
    found = {
        f"{path.relative_to(package)}: {target}"
        for path in package.rglob("*.py")
        for target in patches(path.read_text())
    }
    assert found == ALLOWED


@pytest.mark.parametrize(
    "line",
    [
        "mcap.writer.zstandard = ours",
        "mcap.writer.zstandard, x = ours, 1",
        "del mcap.writer.Message",
        "setattr(mcap.writer, 'Message', ours)",
        "mcap.writer.count += 1",
    ],
)
def test_a_patch_would_be_found(line: str) -> None:
    assert list(patches(f"import mcap.writer\n{line}\n"))
    assert not list(patches(f"mcap = Ours()\n{line}\n"))
