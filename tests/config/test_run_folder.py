"""Run folders: claimed once however many ask, never overwritten, complete, found again."""

import json
import os
from concurrent.futures import ThreadPoolExecutor
from datetime import datetime
from pathlib import Path

import pytest
import yaml

from embodichain.config import adopt, claim, find_run, resolve, thaw, write_record
from embodichain.utils.errors import ConfigError
from embodichain.utils.system.atomic import write_text
from tests.config.conftest import WriteTask

NOW = datetime(2026, 11, 21, 4, 5, 6)


def test_name_and_latest() -> None:
    folder = claim("outputs", "reach", NOW)
    assert folder == Path("outputs/2026-11-21/04-05-06_reach")
    assert os.readlink("outputs/latest") == "2026-11-21/04-05-06_reach"
    second = claim("outputs", "reach", NOW)
    assert second == Path("outputs/2026-11-21/04-05-06_reach_2")
    assert find_run("last") == second.resolve()


def test_odd_names_stay_inside() -> None:
    assert claim("outputs", "../my task", NOW) == Path("outputs/2026-11-21/04-05-06_..-my-task")


def test_threads_that_claim_at_once_get_a_folder_each() -> None:
    with ThreadPoolExecutor(8) as pool:
        folders = list(pool.map(lambda _: claim("outputs", "race", NOW), range(64)))
    assert len(set(folders)) == 64
    assert Path("outputs/latest").resolve() in {folder.resolve() for folder in folders}
    assert {p.name for p in Path("outputs").iterdir()} == {"2026-11-21", "latest"}


def test_a_folder_called_latest_is_not_replaced() -> None:
    Path("outputs/latest").mkdir(parents=True)
    with pytest.raises(ConfigError, match="latest is not a link; move it away"):
        claim("outputs", "reach", NOW)
    assert Path("outputs/latest").is_dir()


def test_no_place_for_outputs() -> None:
    Path("outputs").write_text("a file")
    with pytest.raises(ConfigError, match="cannot make a run folder in outputs"):
        claim("outputs", "reach", NOW)


def test_a_sweeps_folder_is_adopted_once() -> None:
    assert adopt("sweeps/0") == Path("sweeps/0")
    with pytest.raises(ConfigError, match="sweeps/0 contains a run already"):
        adopt("sweeps/0")


def test_what_it_holds(write_task: WriteTask) -> None:
    write_task()
    resolved = resolve(["task=mine", "num_envs=3", "seed=1"])
    folder = claim("outputs", resolved.task_name, NOW)
    write_record(folder, resolved, ["embodichain", "run", "task=mine", "policy={func: zero}"])

    assert {p.name for p in folder.iterdir()} == {
        "config.yaml",
        "overrides.yaml",
        "command.txt",
        "versions.json",
    }
    assert yaml.safe_load((folder / "config.yaml").read_text()) == thaw(resolved.tree)
    assert yaml.safe_load((folder / "overrides.yaml").read_text()) == [
        "task=mine",
        "num_envs=3",
        "seed=1",
    ]
    assert (folder / "command.txt").read_text().splitlines()[1] == (
        "embodichain run task=mine 'policy={func: zero}'"
    )
    versions = json.loads((folder / "versions.json").read_text())
    assert {"embodichain", "python", "mujoco", "torch", "platform"} <= set(versions)


def test_a_full_disk_is_said_loudly(write_task: WriteTask, monkeypatch: pytest.MonkeyPatch) -> None:
    write_task()
    resolved = resolve(["task=mine", "seed=1"])
    folder = claim("outputs", "mine", NOW)

    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    # A disk that is full, which a test cannot make.
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(ConfigError, match=r"cannot write .*config.yaml: .*No space left on device"):
        write_record(folder, resolved)
    assert list(folder.iterdir()) == []


def test_a_failed_write_keeps_the_old_file(monkeypatch: pytest.MonkeyPatch) -> None:
    path = Path("summary.json")
    write_text(path, "old")

    def fails(descriptor: int) -> None:
        raise OSError(5, "Input/output error")

    # A disk that fails, which a test cannot make.
    monkeypatch.setattr(os, "fsync", fails)
    with pytest.raises(OSError, match="Input/output error"):
        write_text(path, "new")
    assert path.read_text() == "old"
    assert [p.name for p in Path().glob("*summary*")] == ["summary.json"]


def test_a_run_that_does_not_exist() -> None:
    with pytest.raises(ConfigError, match=r"no run 'last' \(outputs/latest does not exist\)"):
        find_run("last")
    with pytest.raises(ConfigError, match="no run 'nowhere'"):
        find_run("nowhere")
