"""Old import paths of public modules."""

import importlib
import pickle
import subprocess
import sys
from collections.abc import Iterator

import pytest

from embodichain.compat.moved import MOVED

OLD, NEW = "embodichain.recording.collection", "embodichain.recording.demos.collection"
EXTRAS = {"embodichain.learning.rsl_rl_ppo", "embodichain.learning.skrl_ppo"}


@pytest.fixture(autouse=True)
def forgotten() -> Iterator[None]:
    """Each test imports the old paths for the first time."""
    for old in MOVED:
        sys.modules.pop(old, None)
    yield
    for old in MOVED:
        sys.modules.pop(old, None)


@pytest.mark.parametrize("old", sorted(MOVED))
def test_an_old_path_has_the_names_of_the_new_one(old: str) -> None:
    if old in EXTRAS:
        pytest.importorskip(old.rpartition(".")[2].removesuffix("_ppo"))
    with pytest.warns(DeprecationWarning, match=f"^{old} is {MOVED[old]} now"):
        module = importlib.import_module(old)
    new = importlib.import_module(MOVED[old])
    names = [name for name in vars(new) if not name.startswith("__")]
    assert names
    assert {name: getattr(module, name) for name in names} == {n: getattr(new, n) for n in names}


def test_the_warning_is_of_the_line_that_imports() -> None:
    with pytest.warns(DeprecationWarning) as caught:
        from embodichain.recording.collection import is_collection
    new = importlib.import_module(NEW)
    assert is_collection is new.is_collection
    assert [warning.filename for warning in caught] == [__file__]


def test_a_plain_import_sets_the_attribute_of_the_package() -> None:
    code = f"import {OLD}; print({OLD}.is_collection.__module__)"
    done = subprocess.run(
        [sys.executable, "-W", "default", "-c", code], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == NEW
    assert f"{OLD} is {NEW} now" in done.stderr


def test_an_object_pickled_under_an_old_path_is_found() -> None:
    name = "embodichain.lab.sim.configs.solver_cfg"
    old = "embodichain.lab.sim.solver_cfg"
    cls = importlib.import_module(name).SolverCfg
    data = f"c{old}\nSolverCfg\n.".encode()  # protocol 0: a global
    with pytest.warns(DeprecationWarning):
        assert pickle.loads(data) is cls


def test_new_paths_do_not_warn() -> None:
    code = f"import {NEW}, embodichain.lab.sim.configs.solver_cfg"
    only_ours = "error:embodichain.:DeprecationWarning"  # messages that begin with an old path
    subprocess.run([sys.executable, "-W", only_ours, "-c", code], check=True)


def test_an_unknown_module_is_still_an_error() -> None:
    with pytest.raises(ModuleNotFoundError):
        importlib.import_module("embodichain.recording.collections")
