"""Measures the source tree: size, circles, inheritance, private accesses, files opened by a walk.

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
from collections import Counter
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
    """Lines of Python below folders of the repository, tracked files only."""
    return sum(path.read_bytes().count(b"\n") for path in sources(*folders))


def sources(*folders: str) -> list[Path]:
    """Tracked Python files below folders of the repository that exist."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--", *folders], cwd=REPO, check=True, capture_output=True
    ).stdout.decode()
    found = (REPO / name for name in listed.split("\0") if name.endswith(".py"))
    return [path for path in found if path.is_file() and not path.is_symlink()]


def circles(package: str = "embodichain") -> list[list[str]]:
    """Groups of modules that import each other, directly or around, largest first.

    Packages' ``__init__`` files count as modules.
    """
    graph = grimp.build_graph(package.partition(".")[0], cache_dir=None)
    modules = sorted(m for m in graph.modules if m == package or m.startswith(f"{package}."))
    number = {module: i for i, module in enumerate(modules)}
    edges = [
        (number[module], number[imported])
        for module in modules
        for imported in graph.find_modules_directly_imported_by(module)
        if imported in number
    ]
    rows, columns = np.array(edges or [(0, 0)]).T
    matrix = csr_array((np.ones(len(rows)), (rows, columns)), shape=(len(modules),) * 2)
    _, labels = connected_components(matrix, connection="strong")
    groups = [
        [m for m, of in zip(modules, labels, strict=True) if of == label]
        for label, count in Counter(labels.tolist()).items()
        if count > 1
    ]
    return sorted(groups, key=len, reverse=True)


def private_accesses() -> list[str]:
    """Every ``thing._name`` of another module of the package, as ``file:line: thing._name``."""
    trees = {path: ast.parse(path.read_text()) for path in sources("embodichain", "tasks")}
    own = {path: set(_defined(tree)) for path, tree in trees.items()}
    ours = set().union(*own.values())
    return [
        f"{path.relative_to(REPO)}:{node.lineno}: {ast.unparse(node)}"
        for path, tree in trees.items()
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute)
        and _is_private(node.attr)
        and node.attr in ours - own[path]
        and not _is_self(node.value)
    ]


def _is_private(name: str) -> bool:
    return name.startswith("_") and not name.startswith("__") and name not in _PUBLIC


def _is_self(node: ast.expr) -> bool:
    if isinstance(node, ast.Call):
        return isinstance(node.func, ast.Name) and node.func.id == "super"
    return isinstance(node, ast.Name) and node.id in ("self", "cls")


def _defined(tree: ast.Module) -> Iterator[str]:
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
    """Our classes that `BaseEnv` inherits from."""
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
        self._root = f"{PACKAGE}{'/'}"

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
        return self._last_returned if self._until and self._until(code) else None

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


def main() -> None:
    """Print the table."""
    package = lines("embodichain", "tasks")
    rooms = [p.relative_to(REPO) for p in sorted(PACKAGE.iterdir()) if p.is_dir()]
    terms = ("embodichain/lab/gym/envs/mdp", "embodichain/lab/gym/envs/managers")
    classes = sum(
        isinstance(node, ast.ClassDef)
        for path in sources(*terms)
        for node in ast.walk(ast.parse(path.read_text()))
    )
    groups = circles()
    walks = [walk_command(), walk_step(), walk_event()]
    rows = [
        ("lines of the package", package),
        *((f"  {room.name}", count) for room in rooms if (count := lines(str(room)))),
        ("files of recording", len(sources("embodichain/recording"))),
        ("lines of terms and their managers", lines(*terms)),
        ("classes among them", classes),
        ("files opened: command / step / event", " / ".join(str(len(w.files)) for w in walks)),
        ("functions called", " / ".join(str(len(w.functions)) for w in walks)),
        ("classes that BaseEnv inherits from", len(bases_of_env())),
        ("private accesses across modules", len(private_accesses())),
        ("circles of imports, files", ", ".join(str(len(group)) for group in groups) or "none"),
        ("tests a line of source", f"{lines('tests') / package:.2f}"),
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
