"""The source tree has no circles of imports, and no module reaches into another's private names."""

import importlib
import sys
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType

import pytest

from embodichain.config.gymnasium_ids import task_id
from embodichain.lab.gym.envs import BaseEnv
from tests.helpers.house import house

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]


def test_no_modules_import_each_other() -> None:
    """Imports inside of functions and under `if TYPE_CHECKING` count."""
    assert house().circles() == []


def test_a_circle_would_be_found(tmp_path: Path) -> None:
    package = tmp_path / "circular"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "one.py").write_text("from circular import two\n")
    (package / "two.py").write_text("def late():\n    from circular import one\n")
    (package / "three.py").write_text("import circular.one\n")
    sys.path.insert(0, str(tmp_path))
    try:
        assert house().circles("circular") == [["circular.one", "circular.two"]]
    finally:
        sys.path.remove(str(tmp_path))


def test_private_names_stay_in_their_modules() -> None:
    assert house().private_accesses() == []


def test_the_environment_is_one_class_with_mixins() -> None:
    ours = [c for c in BaseEnv.__mro__[1:] if c.__module__.startswith("embodichain.")]
    assert {c.__name__: c.__bases__ for c in ours} == {c.__name__: (object,) for c in ours}


def test_imports_are_no_part_of_a_walk() -> None:
    """Neither a module's code nor a hook, such as that which follows `import gymnasium`."""

    class Hook(MetaPathFinder, Loader):
        def find_spec(self, name: str, path: object, target: object = None) -> ModuleSpec | None:
            return ModuleSpec(name, self) if name == "hooked" else None

        def exec_module(self, module: ModuleType) -> None:
            task_id("reach")

    walk, hook = house().Walk(), Hook()
    sys.meta_path.insert(0, hook)
    try:
        with walk.traced():
            importlib.import_module("hooked")
            assert walk.files == {}
            task_id("reach")
    finally:
        sys.meta_path.remove(hook)
        sys.modules.pop("hooked", None)
    assert list(walk.files) == ["config/gymnasium_ids.py"]
