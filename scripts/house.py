"""Measure the source tree: size, circles, inheritance, private accesses, files opened by a walk.

`python scripts/house.py` prints a table. A walk counts the files of the package of which a function
runs, code that runs while a module is imported excluded, also that of import hooks:

- command: from `embodichain run task=cart_pole record=none` to the end of the first control step;
- step: one later control step of the same task;
- event: a term that randomizes a mass, from its parameters in YAML to the changed model.

Imports are read from the source by grimp, which import-linter uses: those inside of functions and
under ``if TYPE_CHECKING`` are counted.
"""

from __future__ import annotations

import ast
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import grimp
import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

REPO = Path(__file__).parents[1]
PACKAGE = REPO / "embodichain"
_PUBLIC = frozenset({"_asdict", "_field_defaults", "_fields", "_make", "_replace", "_predict"})
"""Documented names of named tuples and of Stable-Baselines3's policies."""
_IMPORTS = frozenset({"<module>", "_find_and_load"})
"""Functions of an import: a module's code, and importlib's that finds and loads it, with hooks."""
_OPTIMIZED = 0x1  # inspect.CO_OPTIMIZED: functions; not the bodies of modules and classes


def lines(*folders: str) -> int:
    """Count the lines of Python below folders of the repository, in tracked files only."""
    return sum(path.read_bytes().count(b"\n") for path in sources(*folders))


def sources(*folders: str) -> list[Path]:
    """List the tracked Python files below folders of the repository that exist."""
    command = ["git", "ls-files", "-z", "--", *folders]
    process = subprocess.run(command, cwd=REPO, check=True, capture_output=True)
    names = process.stdout.decode().split("\0")
    paths = [REPO / name for name in names if name.endswith(".py")]
    return [path for path in paths if path.is_file() and not path.is_symlink()]


def circles(package: str = "embodichain") -> list[list[str]]:
    """Find groups of modules that import each other, directly or not, largest first.

    Packages' ``__init__`` files count as modules.
    """
    graph = grimp.build_graph(package.partition(".")[0], cache_dir=None)
    modules = sorted(m for m in graph.modules if m == package or m.startswith(f"{package}."))
    number = {module: i for i, module in enumerate(modules)}
    edges: list[tuple[int, int]] = []
    for module in modules:
        for imported in graph.find_modules_directly_imported_by(module):
            if imported in number:
                edges.append((number[module], number[imported]))
    rows, columns = np.array(edges or [(0, 0)]).T
    shape = (len(modules), len(modules))
    matrix = csr_array((np.ones(len(rows)), (rows, columns)), shape=shape)
    _, labels = connected_components(matrix, connection="strong")
    modules_of: dict[int, list[str]] = {}
    for module, label in zip(modules, labels.tolist(), strict=True):
        modules_of.setdefault(label, []).append(module)
    groups = [group for group in modules_of.values() if len(group) > 1]
    return sorted(groups, key=len, reverse=True)


def private_accesses() -> list[str]:
    """List every ``thing._name`` of another module of the package, as ``file:line: thing._name``.

    Names that no module of the package defines are those of libraries.
    """
    trees = {path: ast.parse(path.read_text()) for path in sources("embodichain", "tasks")}
    names_of = {path: set(_defined_names(tree)) for path, tree in trees.items()}
    all_names = set().union(*names_of.values())
    accesses: list[str] = []
    for path, tree in trees.items():
        names_elsewhere = all_names - names_of[path]
        for node in ast.walk(tree):
            if not isinstance(node, ast.Attribute) or _is_self(node.value):
                continue
            if _is_private(node.attr) and node.attr in names_elsewhere:
                accesses.append(f"{path.relative_to(REPO)}:{node.lineno}: {ast.unparse(node)}")
    return accesses


def _is_private(name: str) -> bool:
    return name.startswith("_") and not name.startswith("__") and name not in _PUBLIC


def _is_self(node: ast.expr) -> bool:
    if isinstance(node, ast.Call):
        return isinstance(node.func, ast.Name) and node.func.id == "super"
    return isinstance(node, ast.Name) and node.id in ("self", "cls")


def _defined_names(tree: ast.Module) -> Iterator[str]:
    """Yield the names that a module defines, assigns or imports anywhere."""
    for node in ast.walk(tree):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
            yield node.name
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.attr
        elif isinstance(node, ast.alias):
            yield node.asname or node.name


def bases_of_env() -> list[str]:
    """List our classes that `BaseEnv` inherits from."""
    from embodichain.lab.gym.envs import BaseEnv

    return [c.__qualname__ for c in BaseEnv.__mro__[1:] if c.__module__.startswith("embodichain.")]


@cache
def _resolved(filename: str) -> str:
    """The path of a code's file with links resolved; empty for code without a file."""
    return str(Path(filename).resolve()) if filename[0] == "/" else ""


class Walk:
    """Which files and functions of the package run, imports excluded.

    Attributes:
        files: Files, in the order of their first call.
        functions: Code of the functions that were called.
    """

    def __init__(self) -> None:
        self.files: dict[str, None] = {}
        self.functions: set[CodeType] = set()
        self._importing = 0
        self._until: Callable[[CodeType], bool] | None = None
        self._root = f"{PACKAGE}/"

    @contextmanager
    def traced(self, until: Callable[[CodeType], bool] | None = None) -> Iterator[None]:
        """Count within the block, or until a function that ``until`` picks returns."""
        self._until = until
        before = sys.gettrace()  # of a debugger, or of coverage
        sys.settrace(self._call)
        try:
            yield
        finally:
            sys.settrace(before)

    def _call(self, frame: FrameType, event: str, arg: Any) -> Any:
        code = frame.f_code
        frame.f_trace_lines = False
        if code.co_name in _IMPORTS:
            self._importing += 1
            return self._module_returned
        if self._importing or not code.co_flags & _OPTIMIZED:
            return None
        path = _resolved(code.co_filename)
        if not path.startswith(self._root):
            return None
        self.files[path.removeprefix(self._root)] = None
        self.functions.add(code)
        if self._until and self._until(code):
            return self._last_returned
        return None

    def _module_returned(self, frame: FrameType, event: str, arg: Any) -> Any:
        if event == "return":
            self._importing -= 1
        return self._module_returned

    def _last_returned(self, frame: FrameType, event: str, arg: Any) -> Any:
        if event == "return":
            sys.settrace(None)
        return self._last_returned


def _is_step(code: CodeType) -> bool:
    return code.co_qualname == "BaseEnv.step"


def walk_command() -> Walk:
    """From the command line to the end of the first control step."""
    from embodichain.cli import main

    walk = Walk()
    with tempfile.TemporaryDirectory() as folder, walk.traced(until=_is_step):
        arguments = ["run", "task=cart_pole", "record=none", "num_envs=4", "max_steps=2"]
        if main([*arguments, "--quiet", f"output_dir={folder}"]):
            raise RuntimeError("the run failed")
    return walk


def walk_step() -> Walk:
    """One control step."""
    import torch

    import embodichain

    env = embodichain.make("cart_pole", num_envs=4)
    env.reset(seed=0)
    action = torch.from_numpy(env.action_space.sample())
    env.step(action)
    walk = Walk()
    with walk.traced():
        env.step(action)
    env.close()
    return walk


def walk_event() -> Walk:
    """A term that randomizes a mass: checked, built, fired."""
    import embodichain

    params = "{of: {uid: ur10}, mass: [0.9, 1.1], operation: scale}"
    event = f"{{mass: {{func: randomize, mode: reset, params: {params}}}}}"
    env = embodichain.make("random_reach", num_envs=4, overrides=[f"++task.events={event}"])
    env.reset(seed=0)
    events = env.event_manager
    walk = Walk()
    with walk.traced():
        events.set_params("mass", events.params("mass"))
        events.apply("reset", None)
    env.close()
    return walk


def _count_classes(paths: list[Path]) -> int:
    """Count the classes that files define."""
    count = 0
    for path in paths:
        nodes = ast.walk(ast.parse(path.read_text()))
        count += sum(isinstance(node, ast.ClassDef) for node in nodes)
    return count


def main() -> None:
    """Print the table."""
    package_lines = lines("embodichain", "tasks")
    terms = ("embodichain/lab/gym/envs/mdp", "embodichain/lab/gym/envs/managers")
    groups = circles()
    walks = [walk_command(), walk_step(), walk_event()]
    rows: list[tuple[str, object]] = [("lines of the package", package_lines)]
    for folder in sorted(PACKAGE.iterdir()):
        count = lines(str(folder.relative_to(REPO))) if folder.is_dir() else 0
        if count:
            rows.append((f"  {folder.name}", count))
    rows += [
        ("files of recording", len(sources("embodichain/recording"))),
        ("lines of terms and their managers", lines(*terms)),
        ("classes among them", _count_classes(sources(*terms))),
        ("files opened: command / step / event", " / ".join(str(len(w.files)) for w in walks)),
        ("functions called", " / ".join(str(len(w.functions)) for w in walks)),
        ("classes that BaseEnv inherits from", len(bases_of_env())),
        ("private accesses across modules", len(private_accesses())),
        ("circles of imports, files", ", ".join(str(len(group)) for group in groups) or "none"),
        ("tests a line of source", f"{lines('tests') / package_lines:.2f}"),
    ]
    width = max(len(name) for name, _ in rows)
    for name, value in rows:
        print(f"{name:<{width}}  {value}")
    if "-v" in sys.argv[1:]:
        print(*("\n" + "\n".join(group) for group in groups), sep="\n")
        print("", *private_accesses(), sep="\n")
        for walk in walks:
            print("", *walk.files, sep="\n")


if __name__ == "__main__":
    main()
