"""Words and numbers that YAML 1.1 does not read as written, and circles of files."""

from pathlib import Path

import pytest
import yaml
from omegaconf import OmegaConf

from embodichain.config import compose, validate, validate_file
from embodichain.config.composition.yaml_words import compose_nodes
from tests.config.conftest import GOOD, WriteTask

FILE = "conf/task/mine.yaml"


def said(*overrides: str, verb: str = "run") -> list[str]:
    """The report of the task `mine`."""
    return [str(problem) for problem in validate(compose(["task=mine", *overrides], verb))]


@pytest.mark.parametrize(
    ("word", "read"),
    [
        ("on", "true"),
        ("off", "false"),
        ("No", "false"),
        ("yes", "true"),
        ("true", "true"),
        ("012", "10"),
        ("1:30", "90"),
        ("1e3", "1000.0"),
        ("0x1F", "31"),
        ("null", "null"),
    ],
)
def test_a_key_is_refused_at_its_line(write_task: WriteTask, word: str, read: str) -> None:
    write_task("  box:", f"  {word}:")
    key = f"task.objects.{word}"
    message = f"YAML 1.1 reads the key {word} as {read}: write '{word}', with the quotes"
    assert said() == [f"{FILE}:10: {key}: {message}"]


@pytest.mark.parametrize("word", ["'on'", '"012"', "'1e3'", "y", "n", "7", "08", "on_"])
def test_a_key_that_is_read_as_written(write_task: WriteTask, word: str) -> None:
    write_task("  box:", f"  {word}:")
    assert said() == []
    objects = compose(["task=mine"]).tree["task"]["objects"]
    assert list(objects) == ["ball", word.strip("'\"")]


def test_the_relation_on_is_read_as_written(write_task: WriteTask) -> None:
    layout = "{func: arrange_objects, mode: reset, params: {objects: {ball: {on: table}}}}"
    write_task("events:", f"events:\n  layout: {layout}")
    assert said() == []
    changed = compose(["task=mine", "task.events.layout.params.objects.ball.on=arm"])
    assert changed.tree["task"]["events"]["layout"]["params"] == {
        "objects": {"ball": {"on": "arm"}}
    }
    # Other flags are no relations, and neither is a name outside of a term.
    write_task("events:", f"events:\n  layout: {layout.replace('on:', 'yes:')}")
    assert "YAML 1.1 reads the key yes as true" in said()[0]


def test_a_refused_name_is_known_to_the_other_checks(write_task: WriteTask) -> None:
    write_task(text=GOOD.replace("  ball:", "  off:").replace("uid: ball", "uid: 'off'"))
    (report,) = said()
    assert report.startswith(f"{FILE}:9: task.objects.off: YAML 1.1 reads the key off as false")


def test_names_that_yaml_makes_one(write_task: WriteTask) -> None:
    write_task(
        "  success:",
        "  1: {func: episode_time}\n  on:",
    )
    assert [line.partition(": Y")[0] for line in said()] == [f"{FILE}:33: task.metrics.on"]


@pytest.mark.parametrize(
    ("old", "new", "line", "key", "expected", "got"),
    [
        ("description: A small task.", "description: on", 1, "description", "text", "true"),
        ("uid: arm", "uid: 1e3", 5, "robot.uid", "text", "1000.0"),
        (
            *("uid: ball}}", "uid: no}}", 22),
            *("events.move.params.entity_cfg.uid", "text", "false"),
        ),
        (
            *("[ee_link]", "[yes]", 28),
            *("rewards.near.params.source_entity_cfg.link_names.0", "text", "true"),
        ),
    ],
)
def test_text_needs_quotes(
    write_task: WriteTask, old: str, new: str, line: int, key: str, expected: str, got: str
) -> None:
    text = GOOD.replace(old, new, 1)
    if key.startswith("rewards"):  # the metric takes the same parameters in
        text = text.partition("metrics:")[0]
    write_task(text=text)
    word = new.split()[-1].strip("{[]}")
    (found,) = [report for report in said() if f" task.{key}: " in report]
    assert found == (
        f"{FILE}:{line}: task.{key}: expected {expected}, got {got}. YAML 1.1 reads {word} as "
        f"{got}: for the text write '{word}', with the quotes."
    )


@pytest.mark.parametrize(
    ("written", "number", "base"), [("010", "8", 8), ("1:30", "90", 60), ("1:30.5", "90.5", 60)]
)
def test_numbers_in_another_base_are_refused(
    write_task: WriteTask, written: str, number: str, base: int
) -> None:
    write_task("max_episode_steps: 50", f"max_episode_steps: {written}")
    assert said() == [
        f"{FILE}:3: task.max_episode_steps: YAML 1.1 reads {written} as {number}, in base {base}: "
        f"write {number} for the number, '{written}' with the quotes for the text"
    ]


def test_flags_and_numbers_stay(write_task: WriteTask) -> None:
    write_task("max_episode_steps: 50", "max_episode_steps: 1e2\nignore_terminations: on")
    composed = compose(["task=mine"])
    assert validate(composed) == []
    assert composed.tree["task"]["max_episode_steps"] == 100
    assert composed.tree["task"]["ignore_terminations"] is True


@pytest.mark.parametrize(
    "text",
    [
        *(
            "on",
            "Off",
            "y",
            "n",
            "NO",
            "true",
            "null",
            "~",
            "",
            "012",
            "0o17",
            "0x1F",
            "0b11",
            "1_000",
        ),
        *(
            "1:30",
            "1:30.5",
            "1e3",
            "1E-3",
            "-1e+3",
            "+1.5",
            "1.",
            ".5",
            ".5e3",
            ".5e+3",
            "1.5e3",
            "1_0.5",
        ),
        *(".inf", "-.INF", ".nan", "2026-11-27", "2026-11-27 10:00:00", "08", "1.2.3"),
    ],
)
def test_scalars_are_read_as_omegaconf_reads_them(text: str) -> None:
    read = OmegaConf.to_container(OmegaConf.create(f"key: {text}\n"))["key"]
    node = compose_nodes(f"key: {text}\n")
    mine = yaml.SafeLoader("").construct_object(node.value[0][1])
    assert type(mine) is type(read)
    assert mine == read or mine != mine  # nan


def test_files_that_a_task_takes_in_and_dumps(write_task: WriteTask) -> None:
    write_task(name="base", old="interval_step: 5", new="interval_step: 05")
    write_task(text="defaults: [base, _self_]\n")
    Path("conf/sim").mkdir()
    Path("conf/sim/one.yaml").write_text("num_threads: 0_1\n")
    where = ["conf/task/base.yaml:21: task.events.move", "conf/sim/one.yaml:1: sim.num_threads"]
    for line, place in zip(sorted(said("sim=one"), reverse=True), where, strict=True):
        assert line.startswith(place)
    Path("whole.yaml").write_text("task:\n  objects: {on: {}}\n")
    assert [p.source for p in validate_file("whole.yaml")] == ["whole.yaml:2"]


def test_the_command_line(write_task: WriteTask) -> None:
    write_task()
    assert said("task.description=1e3") == [
        "command line: task.description: expected text, got 1000.0. For the text write "
        "task.description=\"'1e3'\"."
    ]
    assert said("task.description=\"'1e3'\"") == []
    assert said("task.ignore_terminations=off") == [
        "command line: task.ignore_terminations: expected true or false, got 'off'. Write "
        "task.ignore_terminations=false."
    ]
    assert said("num_envs=on") == ["command line: num_envs: expected an integer, got 'on'"]
    assert said("+task.metrics={true: {func: distance}}")[0] == (
        "command line: task.metrics.true: the key true is not read as text: write "
        "+task.metrics.true.KEY=VALUE"
    )


@pytest.mark.parametrize("name", ["10", "nan", "1e3", "on", "true"])
def test_a_task_may_have_any_name(write_task: WriteTask, name: str) -> None:
    write_task(name=name)
    composed = compose([f"task={name}"])
    assert validate(composed) == []
    assert composed.choices["task"] == name
    write_task(text=f"defaults: ['{name}', _self_]\n")
    assert said() == []


def test_a_name_in_a_defaults_list(write_task: WriteTask) -> None:
    write_task(name="10")
    write_task(text="defaults:\n  - 10\n  - /viewer: off\n  - _self_\n")
    assert said() == [
        f"{FILE}:2: defaults: expected a name. 10 is not text in YAML: for the text write '10', "
        "with the quotes.",
        f"{FILE}:3: defaults: expected a name. YAML 1.1 reads off as false: for the text write "
        "'off', with the quotes.",
    ]


def test_an_option_that_an_inherited_file_has_chosen(write_task: WriteTask) -> None:
    write_task(text="defaults: [reach, /scene@scene: lab, _self_]\n")
    (mistake,) = said()
    assert mistake.startswith(f"{FILE}:1: defaults: ")
    assert mistake.endswith(
        "conf/task/reach.yaml:3 chooses an option already: write `override /scene@scene: lab`"
    )
    write_task(text="defaults: [reach, override /scene@scene: lab, _self_]\n")
    assert said() == []
    assert said("+experiment=quick_reach") == [
        "command line: experiment: an option is chosen already: write experiment=NAME, without +"
    ]


def test_files_in_a_circle(write_task: WriteTask) -> None:
    write_task(text="defaults:\n  - second\n  - _self_\n")
    write_task(name="second", text="defaults: [/task@_here_: mine]\n")
    assert said() == [
        "conf/task/second.yaml:1: defaults: a circle of files that include each other: "
        "task/mine -> task/second -> task/mine"
    ]


def test_a_number_from_the_environment(
    write_task: WriteTask, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("STEPS", raising=False)
    write_task("max_episode_steps: 50", "max_episode_steps: ${oc.env:STEPS,40}")
    hint = "A variable of the environment is text: write ${oc.decode:${oc.env:STEPS,40}}."
    message = f"expected an integer, got '40'. {hint}"
    assert said() == [f"{FILE}:3: task.max_episode_steps: {message}"]
    assert said("max_steps=${oc.env:STEPS,40}")[1] == f"command line: max_steps: {message}"
    write_task("max_episode_steps: 50", "max_episode_steps: ${oc.decode:${oc.env:STEPS,40}}")
    assert said() == []


def test_a_gym_config(empty_cwd: Path) -> None:
    Path("gym.yaml").write_text("id: Own-v1\nenv:\n  events: {}\n  extensions: {off: 1, a: 012}\n")
    said = [str(p) for p in validate_file("gym.yaml")]
    key, number = "env.extensions.off", "env.extensions.a"
    assert any(line.startswith(f"gym.yaml:4: {key}: YAML 1.1 reads the key off") for line in said)
    assert any(line.startswith(f"gym.yaml:4: {number}: YAML 1.1 reads 012 as 10") for line in said)
