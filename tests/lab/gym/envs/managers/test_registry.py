"""Terms are found by name or import path, and mistakes name what exists."""

import subprocess
import sys
from pathlib import Path

import pytest

from embodichain.lab.gym.envs.managers.terms.registry import (
    KINDS,
    LEADING,
    TERMS,
    describe_term,
    import_object,
    register_term,
    resolve_term,
)
from embodichain.utils.errors import ConfigError

MODULE = '''
def push(env, env_ids, force: float = 1.0):
    """Pushes."""

def short(env):
    pass

class Counter:
    def __init__(self, env, start: int = 0):
        self.count = start
    def __call__(self, env, env_ids):
        self.count += 1

number = 3
'''


@pytest.fixture
def user_module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    (tmp_path / "user_terms_for_test.py").write_text(MODULE)
    monkeypatch.syspath_prepend(tmp_path)
    yield "user_terms_for_test"
    sys.modules.pop("user_terms_for_test", None)


def test_every_kind_has_builtin_terms_with_documentation() -> None:
    assert set(TERMS) == set(KINDS)
    for kind in KINDS:
        assert TERMS[kind], kind
        for name, spec in TERMS[kind].items():
            assert (spec.name, spec.kind) == (name, kind)
            assert len(spec.doc) > 20, f"{kind} {name} has no docstring"


def test_every_parameter_of_a_builtin_term_is_typed() -> None:
    for kind in KINDS:
        for spec in TERMS[kind].values():
            hints = spec.hints()
            for name, parameter in spec.params.items():
                assert parameter.annotation is not parameter.empty, f"{spec.label}: {name}"
                assert name in hints


@pytest.mark.unmeasured
def test_listing_terms_imports_neither_torch_nor_mujoco() -> None:
    script = (
        "from embodichain.lab.gym.envs.managers import TERMS\n"
        "for kind in TERMS:\n"
        "    for spec in TERMS[kind].values(): spec.hints()\n"
    )
    done = subprocess.run(
        [sys.executable, "-X", "importtime", "-c", script],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    names = {line.rpartition("|")[2].strip().partition(".")[0] for line in done.stderr.splitlines()}
    assert "pydantic" in names
    assert names & {"torch", "mujoco", "tensordict"} == set()


def test_a_user_function_is_found_by_path(user_module: str) -> None:
    spec = resolve_term("event", f"{user_module}:push")
    assert list(spec.params) == ["force"]
    assert spec.doc == "Pushes."
    assert not spec.is_class


def test_a_user_class_gets_its_parameters_in_init(user_module: str) -> None:
    spec = resolve_term("event", f"{user_module}:Counter")
    assert list(spec.params) == ["start"]
    assert spec.is_class


@pytest.mark.parametrize(
    ("func", "message"),
    [
        ("randomise_rigid_object_pose", "Did you mean 'randomize_rigid_object_pose'?"),
        ("within_distance", "'within_distance' is a term of kind reward, termination, metric"),
        ("no_such_package_here:push", "cannot import 'no_such_package_here'"),
        ("user_terms_for_test:pusch", "has no 'pusch'. Did you mean 'push'?"),
        ("user_terms_for_test:short", "must take (env, env_ids, ...) first"),
        ("user_terms_for_test:number", "is not a function or class"),
        ("a b:c", "is not of the form package.module:function"),
    ],
)
def test_a_wrong_name_is_a_config_error(user_module: str, func: str, message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        resolve_term("event", func)
    assert message in str(caught.value)


def test_imports_can_be_forbidden(user_module: str) -> None:
    with pytest.raises(ConfigError, match="would be imported"):
        resolve_term("event", f"{user_module}:push", allow_import=False)
    assert user_module not in sys.modules


def test_a_name_cannot_be_taken_twice() -> None:
    with pytest.raises(ValueError, match="'last_action' is registered already"):

        @register_term("observation", name="last_action")
        def other(env, obs):
            pass


def test_an_unknown_kind_is_refused() -> None:
    with pytest.raises(ValueError, match="unknown kind"):
        register_term("rewards")
    with pytest.raises(ValueError, match="unknown kind"):
        register_term()


def test_leading_arguments_may_have_any_name() -> None:
    spec = describe_term("reward", lambda a, b, c, d, scale=1.0: None, "r")
    assert list(spec.params) == ["scale"]
    assert len(LEADING["reward"]) == 4


def test_an_attribute_of_a_class_can_be_imported() -> None:
    assert import_object("pathlib:Path.cwd") == Path.cwd
