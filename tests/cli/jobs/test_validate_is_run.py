"""`run` refuses a config exactly if `validate` does, and says the same of a single mistake.

Of several, `validate` says also those that others hide from `run`, which builds nothing then.

Tried on one bad config of each kind of the table, and on every registered term: the parameters of
its example are spoiled, all terms of a kind at once; a term of several kinds is tried as one of
them. What the config alone shows is taken out first, so that the constructors of the rest see what
they get.
"""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from embodichain.cli import main
from embodichain.cli.results.terms import SECTION_OF, all_entries
from embodichain.config import compose, validate
from tests.config.checks.bad_configs import BAD
from tests.config.conftest import WriteTask, write_task  # noqa: F401  (a fixture)
from tests.helpers.example_scene import write_task as write_scene
from tests.lab.gym.envs.mdp.test_examples import ENTRIES, example_of

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]

Params = dict[str, Any]


def said(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str]:
    """Exit code and what was said on stderr.

    Notes come first and in one order: `run` says some of them earlier, as warnings. Links that
    overlap in many postures, and what begins in the ground, are left out: notes of `validate`
    alone.
    """
    capsys.readouterr()
    code = main(list(arguments))
    lines = capsys.readouterr().err.splitlines(keepends=True)
    lines = [re.sub("^(note|warning): ", "note: ", line) for line in lines]
    notes = sorted(line for line in lines if line.startswith("note: "))
    of_validate = ("in many of 200 postures", "below the ground")
    notes = [note for note in notes if not any(words in note for words in of_validate)]
    return code, "".join([*notes, *(line for line in lines if not line.startswith("note: "))])


def refused_alike(capsys: pytest.CaptureFixture[str], lines: list[str], verb: str = "run") -> str:
    """What both say of a config; empty if both take it."""
    train = ["--train"] if verb == "train" else []
    checked = said(capsys, "validate", *train, *lines)
    done = said(capsys, verb, *lines)
    assert checked == done
    return checked[1] if checked[0] else ""


def refused_by_both(capsys: pytest.CaptureFixture[str], lines: list[str]) -> str:
    """What `run` says of a config, which `validate` says too; empty if both take it."""
    code, checked = said(capsys, "validate", *lines)
    again, done = said(capsys, "run", *lines)
    assert code == again
    mistakes = [line for line in done.splitlines() if not line.endswith(" mistakes:")]
    assert {line.removeprefix("error: ").strip() for line in mistakes} <= {
        line.removeprefix("error: ").strip() for line in checked.splitlines()
    }
    return done if code else ""


THROUGH_BOTH = (
    *("unknown key in a task", "a root key in a task", "unknown key at the root", "no task"),
    *("text for an integer", "wrong choice in a group", "unavailable device", "unknown policy"),
    *("malformed overrides", "malformed YAML, and more", "unknown term", "unknown link"),
    *("malformed URDF", "several at once", "a seed that training cannot use"),
)
"""One of each kind; what is said of the others is compared word for word in `test_bad_configs`."""


@pytest.mark.parametrize("name", THROUGH_BOTH)
def test_the_table_of_bad_configs(name: str, write_task: WriteTask, capsys: Any) -> None:  # noqa: F811
    case = BAD[name]
    write_task(case.old, case.new)
    Path("broken.urdf").write_text('<robot name="x"><link name="a"></robot>')
    lines = [*([f"task={case.task}"] if case.task else []), *case.overrides]
    lines = lines or ["seed=1"]  # `validate` alone has nothing to check
    assert refused_alike(capsys, lines, case.verb)


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        (
            "+task.events.look={func: randomize_visual_material, "
            "params: {entity_cfg: {uid: ball}}}",
            "task.events.look.params.base_color_range: missing: give this",
        ),
        ("+task.robot.control_parts={arm: []}", "task.robot.control_parts.arm: names no joint"),
        (
            "+task.robot.control_parts={arm: [Elbow]}",
            "task.robot.control_parts.arm: no joint matches 'Elbow'; there are: Joint1",
        ),
        (
            "task.actions.arm.params.entity_cfg={uid: arm, control_parts: []}",
            "task.actions.arm.params.entity_cfg.control_parts: picks no joint of 'arm'",
        ),
        (
            "+task.observations.tool={func: get_robot_eef_pose, params: {part_name: hand}}",
            "task.observations.tool.params.part_name: no control part of 'arm' matches 'hand'",
        ),
        (
            "+task.observations.q={func: joint_position, scale: [1, 2], "
            "params: {entity_cfg: {uid: arm}}}",
            "task.observations.q.scale: ",
        ),
        (
            'task.rewards.near.params.source_entity_cfg.link_names=[".*"]',
            "task.rewards.near.params.source_entity_cfg.link_names: one link of 'arm' is wanted",
        ),
        ("policy=nowhere:policy", "policy: cannot import 'nowhere'"),
    ],
)
def test_what_only_building_shows(
    wrong: str,
    says: str,
    write_task: WriteTask,  # noqa: F811
    capsys: Any,
) -> None:
    write_task()
    found = refused_alike(capsys, ["task=mine", "quiet=true", "max_steps=1", wrong])
    assert f"command line: {says}" in found


def test_what_is_right_is_right(write_task: WriteTask, capsys: Any) -> None:  # noqa: F811
    write_task()
    assert refused_alike(capsys, ["task=mine", "quiet=true", "max_steps=1"]) == ""


def test_validate_leaves_nothing_behind(write_task: WriteTask, capsys: Any) -> None:  # noqa: F811
    write_task()
    before = sorted(Path.cwd().rglob("*"))
    assert said(capsys, "validate", "task=mine", "viewer=native") == (0, "")
    assert sorted(Path.cwd().rglob("*")) == before


def _references(value: Any, other: Params) -> Any:
    """A parameter whose references are replaced by another one."""
    if isinstance(value, dict):
        return other if "uid" in value else {k: _references(v, other) for k, v in value.items()}
    return [_references(v, other) for v in value] if isinstance(value, list) else value


def _nonsense(value: Any) -> Any:
    """A text that names nothing, and rows of zeros: of the right types, often of no sense."""
    if isinstance(value, str):
        return "nonsense"
    if isinstance(value, list) and value and isinstance(value[0], (int, float)):
        return [0.0] * len(value)
    return value


SPOILED: dict[str, Callable[[Params], Params]] = {
    "an object": lambda params: _references(params, {"uid": "cube"}),
    "many links": lambda params: _references(params, {"uid": "panda", "link_names": [".*"]}),
    "nonsense": lambda params: {name: _nonsense(value) for name, value in params.items()},
    "references only": lambda params: {
        name: value for name, value in params.items() if isinstance(value, dict) and "uid" in value
    },
}
BUILT = {"action", "event", "reward"}
"""Kinds whose terms of an object certainly have mistakes which only building shows."""


def test_every_registered_term_has_an_example() -> None:
    own = [e for e in all_entries() if e.spec.func.__module__.startswith("embodichain.")]
    assert len(ENTRIES) == len(own) > 100


@pytest.mark.slow
@pytest.mark.parametrize("kind", sorted({entry.kinds[0] for entry in ENTRIES}))
def test_every_term_with_spoiled_parameters(kind: str, tmp_path: Path, capsys: Any) -> None:
    """All of them in one scene: building it takes most of the time."""
    section = SECTION_OF[kind]
    terms: dict[str, Params] = {}
    for entry in ENTRIES:
        if kind == entry.kinds[0]:
            for how, spoil in SPOILED.items():
                term = example_of(entry, kind)
                terms[f"{entry.name}-{how}"] = {**term, "params": spoil(term.get("params", {}))}
    lines = ["task=everything", "max_steps=1", "num_envs=2", "seed=1", "quiet=true", "record=none"]
    lines.append(f"output_dir={tmp_path / 'outputs'}")
    write_scene(section, terms, tmp_path / "all")
    shown = {p.path for p in validate(compose(lines, config_dir=tmp_path / "all"))}
    if shown:
        assert refused_by_both(capsys, [*lines, "--config-dir", str(tmp_path / "all")])
    rest = {
        name: term
        for name, term in terms.items()
        if not any(f"{path}.".startswith(f"task.{section}.{name}.") for path in shown)
    }
    write_scene(section, rest, tmp_path / "rest")
    found = refused_by_both(capsys, [*lines, "--config-dir", str(tmp_path / "rest")])
    if kind in BUILT:
        assert len(re.findall(rf": task\.{section}\.\w+-an object", found)) >= 5
