import dataclasses
import re
import sys
from pathlib import Path
from typing import Any

import pytest

import embodichain
from embodichain.cli import main
from embodichain.cli.app import load_verb
from embodichain.cli.verb import VERBS
from embodichain.cli.words import EVERYDAY_KEYS
from embodichain.config.keys.schema import RootCfg

KINDS = (
    "{tasks|embodiments|objects|scenes|variations|studies|suites|robots|policies|terms|formats"
    "|viewers|learners|steps|engines|renderers}"
)


@pytest.mark.parametrize("arguments", [[], ["--help"], ["-h"], ["help"]])
def test_overview_names_every_verb(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 0
    text = capsys.readouterr().out
    assert all(re.search(rf"^  {verb} +\w", text, re.MULTILINE) for verb in VERBS)


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.startswith(f"embodichain {embodichain.__version__} (Python ")


def test_every_verb_has_one_module_in_one_folder() -> None:
    verbs = Path(embodichain.__file__).parent / "cli/verbs"
    modules = {f"{path.parent.name}/{path.stem}" for path in verbs.glob("*/[a-z]*.py")}
    listed = [f"{entry.folder}/{name.replace('-', '_')}" for name, entry in VERBS.items()]
    assert sorted(listed) == sorted(modules)


@pytest.mark.parametrize("verb", VERBS)
def test_help_of_every_verb_shows_its_options_and_examples(
    verb: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([verb, "--help"]) == 0
    text = capsys.readouterr().out
    assert text.startswith(f"Usage: embodichain {verb} ")
    assert VERBS[verb].description in " ".join(text.split())
    assert "--json" in text
    examples = load_verb(verb).examples
    assert examples
    for example, what in examples:
        assert f"embodichain {example}" in text
        assert what in text


def test_keys_that_help_names_exist() -> None:
    assert set(EVERYDAY_KEYS) <= {field.name for field in dataclasses.fields(RootCfg)}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["ru"], "no such verb: 'ru'. Did you mean 'run'? There are: demo, run, train, "),
        (["zzz"], "no such verb: 'zzz'. There are: demo, run, train, "),
        (["--verbose"], "No such option '--verbose'. Did you mean '--version'?"),
        (["task=reach", "seed=1"], "a verb comes first: embodichain run task=reach seed=1"),
        (["-m", "seed=1,2"], "a verb comes first: embodichain run -m seed=1,2"),
        (["run", "--qiet"], "No such option '--qiet'. Did you mean '--quiet'?"),
        (["run", "--task", "reach"], "there is no option --task: write task=reach, without dashes"),
        (["run", "reach", "--num_envs", "4"], "there is no option --num_envs: write num_envs=4,"),
        (["train", "reach", "--num-envs=4"], "there is no option --num-envs: write num_envs=4,"),
        (["validate", "--seed", "task=reach"], "there is no option --seed: write seed=VALUE,"),
        (["show", "--task.reward_floor", "0"], "there is no option --task.reward_floor: write "),
        (
            ["run", "reach", "task.rewards.new={func:", "distance}"],
            "put quotes around it for your shell: 'task.rewards.new={func: distance}'; a new entry "
            "is +task.rewards.new=...",
        ),
        (
            ["show", "reach", "+task.x=[a,", "'b]',", "c]", "seed=1"],
            "put quotes around it for your shell: \"+task.x=[a, 'b]', c]\"",
        ),
        (["run", "reach", "task.x={a: b"], "'task.x={a: b' has a bracket without its other one"),
        (["list", "tasks", "--jsn"], "No such option '--jsn'. Did you mean '--json'?"),
        (
            ["list"],
            f"Missing argument '{KINDS}'. Choose from:",
        ),
        (
            ["list", "task"],
            f"Invalid value for '{KINDS}': 'task' is not one of 'tasks', ",
        ),
        (["list", "tasks", "robots"], "Got unexpected extra argument (robots)"),
        (["run", "one", "two"], "one task at a time: one, two."),
        (["-sc", "instal=bash"], "-sc takes install=SHELL or uninstall=SHELL"),
        (["bench", "task=reach", "num_envs=1,x"], "num_envs: must be one or more positive"),
        (
            ["bench", "task=reach", "--rounds", "0"],
            "Invalid value for '--rounds': 0 is not in the range x>=1.",
        ),
        (
            ["bench", "task=reach", "--rounds", "many"],
            "Invalid value for '--rounds': 'many' is not",
        ),
        (["replay"], "Missing argument 'FILE'."),
    ],
)
def test_what_was_mistyped_is_named_with_exit_code_2(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 2
    out, err = capsys.readouterr()
    assert err.startswith(f"error: {message}")
    assert "Traceback" not in err
    assert out == ""


@pytest.mark.parametrize("verb", VERBS)
def test_options_of_every_verb_have_a_field_for_each_typed_value(verb: str) -> None:
    """A frozen dataclass; click fills it, and no value of the command line is lost."""
    command = load_verb(verb)
    options = command.options
    assert dataclasses.is_dataclass(options)
    with pytest.raises(dataclasses.FrozenInstanceError):
        options.__setattr__(object.__new__(options), "json", True)
    values = {parameter.name for parameter in command.params if parameter.expose_value}
    assert {field.name for field in dataclasses.fields(options)} == values
    assert "Attributes:" in str(options.__doc__)


def leave(obs: Any, env: Any, code: Any = None) -> None:
    """A policy that ends the program, as code of a user may."""
    sys.exit(code)


@pytest.mark.parametrize(
    ("code", "expected", "text"),
    [("null", 0, ""), ("3", 3, ""), ("'no arm is connected'", 1, "no arm is connected\n")],
)
def test_a_program_that_ends_itself_says_why(
    code: str, expected: int, text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    policy = f"policy={{func: 'tests.cli.test_app:leave', params: {{code: {code}}}}}"
    words = ["task=cart_pole", policy, "num_envs=1", "record=none", "scene_png=false", "--quiet"]
    assert main(["run", *words, f"output_dir={tmp_path}"]) == expected
    assert capsys.readouterr().err == text
