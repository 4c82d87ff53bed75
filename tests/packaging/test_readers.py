"""No module uses a reader that runs code of a file, but for those that are named here."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import embodichain

ROOT = Path(embodichain.__file__).parent
FOLDERS = (ROOT, ROOT.parent / "tasks", ROOT.parent / "plugins", ROOT.parent / "scripts")

ALLOWED = {
    # Reads names as stand-ins: nothing of a pickle is imported or called.
    ("learning/checkpoints/inert_pickle.py", "pickle.Unpickler"),
    # Only with trust=true, after the names that it would run were logged.
    ("learning/policies/policy.py", "algorithm.load"),
    # Weights alone, which its `load_data=False` and torch's `weights_only` say.
    ("learning/sb3/training_state.py", "load_from_zip_file"),
    # After its operations were listed; see `script_check`.
    ("learning/policies/exported.py", "torch.jit.load"),
    # Only written.
    ("recording/export/hdf5_files.py", "h5py.File"),
    # What this process has pickled itself, for a process that it has started.
    ("cli/sweeps/clusters/ray.py", "pickle.loads"),
    # Classes made of PyYAML's safe one.
    ("compat/gym_config/file.py", "yaml.load(_Loader)"),
    ("config/composition/yaml_words.py", "yaml.load(_Loader)"),
}
"""(file, call) that are safe, and why."""
PICKLES = ("pickle", "cPickle", "_pickle", "cloudpickle", "dill", "joblib", "shelve", "marshal")

MODELS = ("algorithm", "model", "cls", "PPO", "SAC", "TD3", "A2C")
UNSAFE = (
    *("torch.jit.load", "torch.package.PackageImporter", "load_from_zip_file", "h5py.File"),
    *("yaml.unsafe_load", "yaml.full_load", "pd.read_pickle", "pandas.read_pickle"),
    *("eval", "exec", "__import__"),
)


def name_of(node: ast.expr) -> str:
    """``a.b.c`` of a name or attribute; an empty string for anything else."""
    if isinstance(node, ast.Name):
        return node.id
    if isinstance(node, ast.Attribute):
        owner = name_of(node.value)
        return f"{owner}.{node.attr}" if owner else node.attr
    return ""


def keyword(call: ast.Call, name: str) -> object:
    """The constant that a call gives to a keyword; None if it gives none."""
    found = [k.value for k in call.keywords if k.arg == name]
    return found[0].value if found and isinstance(found[0], ast.Constant) else None


def unsafe_calls(source: str) -> Iterator[str]:
    """The calls of a module that may run code of what they read."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ClassDef):
            yield from (n for n in map(name_of, node.bases) if n.endswith("Unpickler"))
        if isinstance(node, ast.ImportFrom) and node.module in PICKLES:
            yield from (f"{node.module}.{a.name}" for a in node.names if "load" in a.name.lower())
        if isinstance(node, ast.Call) and is_unsafe(node):
            loader = f"({loader_of(node)})" if name_of(node.func) == "yaml.load" else ""
            yield name_of(node.func) + loader


def is_unsafe(call: ast.Call) -> bool:
    """Whether a call may run code of what it reads."""
    name = name_of(call.func)
    owner, _, last = name.rpartition(".")
    if name == "torch.load":
        return keyword(call, "weights_only") is not True
    if name in ("np.load", "numpy.load"):
        return keyword(call, "allow_pickle") is not False
    if name == "yaml.load":
        return loader_of(call) not in ("yaml.SafeLoader", "yaml.CSafeLoader")
    pickles = owner in PICKLES and last in ("load", "loads", "Unpickler")
    models = owner in MODELS and last == "load"
    return pickles or models or name in UNSAFE


def loader_of(call: ast.Call) -> str:
    """The loader of a call of `yaml.load`."""
    by_name = [k.value for k in call.keywords if k.arg == "Loader"]
    loader = [*call.args[1:2], *by_name]
    return name_of(loader[0]) if loader else "no loader"


def modules() -> Iterator[Path]:
    """Every module of the package, and of what is beside it."""
    for folder in FOLDERS:
        yield from (p for p in sorted(folder.rglob("*.py")) if "__pycache__" not in p.parts)


def test_every_reader_is_one_that_runs_no_code() -> None:
    found = set()
    for path in modules():
        where = path.relative_to(ROOT) if path.is_relative_to(ROOT) else path
        found |= {(where.as_posix(), call) for call in unsafe_calls(path.read_text("utf-8"))}
    assert found - ALLOWED == set()
    assert ALLOWED - found == set(), "these are not there any more"


@pytest.mark.parametrize(
    ("line", "call"),
    [
        ("pickle.load(f)", "pickle.load"),
        ("cloudpickle.loads(b)", "cloudpickle.loads"),
        ("joblib.load(p)", "joblib.load"),
        ("from pickle import loads", "pickle.loads"),
        ("class A(pickle.Unpickler): pass", "pickle.Unpickler"),
        ("torch.load(p)", "torch.load"),
        ("torch.load(p, weights_only=False)", "torch.load"),
        ("torch.jit.load(p)", "torch.jit.load"),
        ("np.load(p, allow_pickle=True)", "np.load"),
        ("np.load(p)", "np.load"),
        ("yaml.load(t, yaml.UnsafeLoader)", "yaml.load(yaml.UnsafeLoader)"),
        ("yaml.load(t)", "yaml.load(no loader)"),
        ("yaml.unsafe_load(t)", "yaml.unsafe_load"),
        ("algorithm.load(p)", "algorithm.load"),
        ("eval(t)", "eval"),
    ],
)
def test_an_unsafe_reader_is_found(line: str, call: str) -> None:
    assert list(unsafe_calls(line)) == [call]


@pytest.mark.parametrize(
    "line",
    [
        "torch.load(p, weights_only=True)",
        "np.load(p, allow_pickle=False)",
        "yaml.safe_load(t)",
        "json.loads(t)",
        "yaml.load(t, yaml.CSafeLoader)",
    ],
)
def test_a_safe_reader_is_none(line: str) -> None:
    assert list(unsafe_calls(line)) == []
