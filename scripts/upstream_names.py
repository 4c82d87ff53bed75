"""List the public names of a release of EmbodiChain: `embodichain/compat/upstream_names.json`.

`python scripts/upstream_names.py CHECKOUT` parses every module below `CHECKOUT/embodichain`, and
runs none. The names of a module are those that it defines at its top level; a package also has
those that it imports from its own modules.
"""

from __future__ import annotations

import ast
import json
import sys
from pathlib import Path

OUT = Path(__file__).parents[1] / "embodichain" / "compat" / "upstream_names.json"
ROOT = "embodichain"
_NO_API = ("all", "logger")
"""Names of no use to others: a misspelt `__all__`, and the logger of each module."""


class Modules:
    """The modules of a checkout by dotted name, and what can be imported from each."""

    def __init__(self, checkout: Path) -> None:
        self.trees: dict[str, ast.Module] = {}
        self.packages: set[str] = set()
        self._names: dict[str, set[str]] = {}
        for file in sorted((checkout / ROOT).rglob("*.py")):
            if file.stem in ("__main__", "conf"):
                continue
            path = file.relative_to(checkout).with_suffix("")
            if file.stem == "__init__":
                path = path.parent
            name = ".".join(path.parts)
            if file.stem == "__init__":
                self.packages.add(name)
            self.trees[name] = ast.parse(file.read_text(encoding="utf-8"))
        # Folders without an `__init__.py` are packages too.
        for name in list(self.trees):
            parents = name.split(".")[:-1]
            for count in range(1, len(parents) + 1):
                parent = ".".join(parents[:count])
                self.packages.add(parent)
                self.trees.setdefault(parent, ast.parse(""))

    def names(self, module: str) -> set[str]:
        """Public names that a module defines, and a package imports from its own modules."""
        if module not in self._names:
            # Where imports go in a circle, a module has the names that were read so far.
            self._names[module] = set()
            names = self._read_names(module)
            self._names[module] = {n for n in names if not n.startswith("_") and len(n) > 1}
        modules = {name for name in self._names[module] if f"{module}.{name}" in self.trees}
        return self._names[module] - modules - set(_NO_API)

    def _read_names(self, module: str) -> set[str]:
        """Names at the top level of a module, private ones included."""
        names: set[str] = set()
        for node in self.trees.get(module, ast.parse("")).body:
            names.update(_defined_names(node))
            if module in self.packages and isinstance(node, ast.ImportFrom):
                names |= self._imported_names(module, node)
        return names

    def _imported_names(self, package: str, node: ast.ImportFrom) -> set[str]:
        """Names that a package imports from modules of EmbodiChain; modules are left out."""
        parts = package.split(".")
        base: list[str] = []
        if node.level:
            base = parts[: len(parts) - node.level + 1]
        source = ".".join([*base, *(node.module or "").split(".")]).strip(".")
        if source.split(".")[0] != ROOT:
            return set()
        names = {alias.asname or alias.name for alias in node.names}
        if "*" not in names:
            return {n for n in names if f"{source}.{n}" not in self.trees}
        exported = _exported_names(self.trees.get(source, ast.parse("")))
        return self.names(source) if exported is None else exported


def _defined_names(node: ast.stmt) -> list[str]:
    """Names that a statement defines."""
    if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
        return [node.name]
    targets: list[ast.expr] = []
    if isinstance(node, ast.Assign):
        targets = node.targets
    elif isinstance(node, ast.AnnAssign):
        targets = [node.target]
    return [target.id for target in targets if isinstance(target, ast.Name)]


def _exported_names(tree: ast.Module) -> set[str] | None:
    """The names in ``__all__``; None if a module has none that can be read."""
    for node in tree.body:
        if "__all__" in _defined_names(node) and isinstance(node, ast.Assign):
            try:
                return set(ast.literal_eval(node.value))
            except ValueError:
                return None
    return None


def main(checkout: Path) -> None:
    """Write the list, a module a line."""
    modules = Modules(checkout)
    lines = [
        f"  {json.dumps(name)}: {json.dumps(sorted(modules.names(name)))}"
        for name in sorted(modules.trees)
    ]
    OUT.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
