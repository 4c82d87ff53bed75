"""Odd files and names are input that is wrong: exit code 2, and the file or the key is named."""

from pathlib import Path

import pytest

from embodichain.cli import main

DEEP = "description: " + "[" * 5000 + "]" * 5000
ITSELF = "description: x\nevents: &a\n  <<: *a\n  push: 1\n"


@pytest.mark.parametrize("text", [DEEP, ITSELF], ids=["deep", "itself"])
@pytest.mark.parametrize("name", ["task=mine", "conf/task/mine.yaml"])
def test_a_file_that_nests_without_end(text, name, capsys):
    Path("conf/task").mkdir(parents=True)
    Path("conf/task/mine.yaml").write_text(text)
    assert main(["validate", name]) == 2
    said = capsys.readouterr().err
    assert "conf/task/mine.yaml" in said
    assert "nested too deeply, or an alias contains itself" in said


@pytest.mark.parametrize("name", ["task=mine", "conf/task/mine.yaml"])
def test_an_empty_task(name, capsys):
    Path("conf/task").mkdir(parents=True)
    Path("conf/task/mine.yaml").write_text("# nothing yet\n")
    assert main(["validate", name]) == 2
    assert "conf/task/mine.yaml: task: the file is empty" in capsys.readouterr().err


@pytest.mark.parametrize("key", ["hydra.run.dir", "output_dir"])
def test_a_folder_whose_name_is_too_long(key, capsys):
    assert main(["run", "task=reach", "max_steps=1", f"{key}={'x' * 300}"]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"error: {key}: cannot make") and "too long" in said


def test_a_key_that_is_too_long(capsys):
    assert main(["validate", "task=reach", f"{'k' * 5000}=1"]) == 2
    assert "unknown key" in capsys.readouterr().err


def test_why_a_folder_has_no_log(capsys):
    run = Path("run")
    run.mkdir()
    for text, why in (
        (None, "it is not the folder of a run"),
        ("record: {format: none}\n", "it was run with record=none"),
        ("record: {format: mcap}\n", "was killed, before its log began"),
    ):
        if text is not None:
            (run / "config.yaml").write_text(text)
        assert main(["replay", str(run)]) == 2
        assert why in capsys.readouterr().err
