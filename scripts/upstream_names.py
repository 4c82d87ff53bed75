"""Lists the public names of a release of EmbodiChain: `embodichain/compat/upstream_names.json`.

`python scripts/upstream_names.py CHECKOUT`: reads the syntax of every module below
`CHECKOUT/embodichain`, runs nothing of it, and keeps names only. A module has what it defines at
its top level; a package also what it imports from its own modules.
"""

from __future__ import annotations

import ast
import json
import sys
from pathlib import Path

OUT = Path(__file__).parents[1] / "embodichain" / "compat" / "upstream_names.json"
ROOT = "embodichain"
_NO_API = ("all", "logger")  # a misspelt `__all__`, and each module's own logger


class Modules:
    """The modules of a checkout by dotted name, and what can be imported from each."""

    def __init__(self, checkout: Path) -> None:
        self.trees: dict[str, ast.Module] = {}
        self.packages: set[str] = set()
        self._known: dict[str, set[str]] = {}
        for file in sorted((checkout / ROOT).rglob("*.py")):
            parts = file.relative_to(checkout).with_suffix("").parts
            if parts[-1] in ("__main__", "conf"):
                continue
            name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
            if parts[-1] == "__init__":
                self.packages.add(name)
            self.trees[name] = ast.parse(file.read_text(encoding="utf-8"))
        for name in list(self.trees):  # folders without an `__init__.py`
            parents = name.split(".")[:-1]
            for count in range(1, len(parents) + 1):
                parent = ".".join(parents[:count])
                self.packages.add(parent)
                self.trees.setdefault(parent, ast.parse(""))

    def names(self, module: str) -> set[str]:
        """Public names that a module defines, and a package imports from its own modules."""
        if module not in self._known:
            self._known[module] = set()  # of a circle of imports, what is known so far
            tree = self.trees.get(module, ast.parse(""))
            found = {name for node in tree.body for name in _defined(node)}
            if module in self.packages:
                found |= {
                    name
                    for node in tree.body
                    if isinstance(node, ast.ImportFrom)
                    for name in self._imported(module, node)
                }
            self._known[module] = {n for n in found if not n.startswith("_") and len(n) > 1}
        modules = {name for name in self._known[module] if f"{module}.{name}" in self.trees}
        return self._known[module] - modules - set(_NO_API)

    def _imported(self, package: str, node: ast.ImportFrom) -> set[str]:
        parts = package.split(".")
        base = parts[: len(parts) - node.level + 1] if node.level else []
        source = ".".join([*base, *(node.module or "").split(".")]).strip(".")
        if source.split(".")[0] != ROOT:
            return set()
        names = {alias.asname or alias.name for alias in node.names}
        if "*" not in names:
            return {n for n in names if f"{source}.{n}" not in self.trees}
        listed = _listed(self.trees.get(source, ast.parse("")))
        return self.names(source) if listed is None else listed


def _defined(node: ast.stmt) -> list[str]:
    if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
        return [node.name]
    targets = (
        node.targets
        if isinstance(node, ast.Assign)
        else [node.target]
        if isinstance(node, ast.AnnAssign)
        else []
    )
    return [target.id for target in targets if isinstance(target, ast.Name)]


def _listed(tree: ast.Module) -> set[str] | None:
    for node in tree.body:
        if "__all__" in _defined(node) and isinstance(node, ast.Assign):
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
