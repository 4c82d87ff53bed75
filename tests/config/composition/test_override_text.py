"""Overrides with letters that Hydra's lexer does not know, its search path and resolvers."""

from datetime import datetime
from pathlib import Path

import pytest

from embodichain.config import compose, validate
from embodichain.config.composition.override_text import readable
from tests.config.conftest import GOOD, WriteTask


@pytest.mark.parametrize(
    ("typed", "key", "value"),
    [
        ("output_dir=größe", "output_dir", "größe"),
        ("output_dir=/data/jörg/日本語", "output_dir", "/data/jörg/日本語"),
        ("output_dir=Übung 1/a", "output_dir", "Übung 1/a"),
        ("output_dir='ö'", "output_dir", "ö"),
        ("output_dir=sweeps/seed=0/1", "output_dir", "sweeps/seed=0/1"),
        ("output_dir=~/C#1", "output_dir", "~/C#1"),
        ("dataset=[ä,b,'c é']", "dataset", ["ä", "b", "c é"]),
        ("dataset=${oc.env:NO_SUCH_NAME,o}/ü", "dataset", "o/ü"),
        ("wandb={project: Größe, tags: [é]}", "wandb", {"project": "Größe", "tags": ["é"]}),
    ],
)
def test_other_letters(write_task: WriteTask, typed: str, key: str, value: object) -> None:
    write_task()
    composed = compose(["task=mine", typed], "train")
    assert composed.problems == ()
    assert composed.tree[key] == value


def test_sweeps_and_functions_stay() -> None:
    assert readable("a=ö,b,'c,é'") == "a='ö',b,'c,é'"
    assert readable("a=choice(ö,b)") == "a=choice('ö',b)"
    assert readable("a=sort(1,2,reverse=true)") == "a=sort(1,2,reverse=true)"
    assert readable("+a.b={func: f, params: {x: 1}}") == "+a.b={func: f, params: {x: 1}}"


def test_a_key_with_other_letters(write_task: WriteTask) -> None:
    write_task()
    (problem,) = compose(["task=mine", "+task.objects.größe={}"]).problems
    message = "names of keys are ASCII letters here; others can be written in a file"
    assert message in str(problem)


def test_hydras_search_path(write_task: WriteTask, tmp_path: Path) -> None:
    write_task()
    theirs = tmp_path / "shared"
    (theirs / "task").mkdir(parents=True)
    (theirs / "task" / "theirs.yaml").write_text(GOOD)
    (theirs / "task" / "mine.yaml").write_text("description: theirs\n")
    for place in (f"file://{theirs}", str(theirs)):
        path = f"hydra.searchpath=[{place}]"
        assert validate(compose(["task=theirs", path])) == []
        assert compose(["task=mine", path]).tree["task"]["description"] == "theirs"
    assert compose(["task=mine"]).tree["task"]["description"] == "A small task."
    for place, message in {
        "[nowhere]": f"no such folder or package: file://{Path.cwd()}/nowhere",
        "[pkg://nowhere.at.all]": "no such folder or package: pkg://nowhere.at.all",
        "5": "expected a list of folders: hydra.searchpath=[file:///path/to/conf]",
    }.items():
        (problem,) = validate(compose(["task=mine", f"hydra.searchpath={place}"]))
        assert str(problem) == f"command line: hydra.searchpath: {message}"


def test_the_date_in_a_folder(write_task: WriteTask) -> None:
    write_task()
    composed = compose(["task=mine", "output_dir=runs/${now:%Y}/a"])
    assert composed.problems == ()
    assert composed.tree["output_dir"] == f"runs/{datetime.now():%Y}/a"


@pytest.mark.parametrize(
    ("value", "shown"), [("null", "null"), ("", "''"), ("[a]", "['a']"), ("{a: 1}", "{'a': 1}")]
)
def test_folders_that_are_none(write_task: WriteTask, value: str, shown: str) -> None:
    write_task()
    for key in ("hydra.run.dir", "hydra.sweep.dir", "hydra.sweep.subdir"):
        assert [str(p) for p in compose(["task=mine", f"{key}={value}"]).problems] == [
            f"command line: {key}: expected the name of a folder, got {shown}"
        ]
