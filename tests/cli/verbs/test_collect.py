"""`collect`: episodes until enough succeeded, listed, in a log that replays; again after a kill."""

import json
import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest

import embodichain.recording as recording
from embodichain.cli import main
from embodichain.recording.check.verification import verify
from embodichain.recording.demos.collection import read_collection
from tests.helpers.commands import Commands

pytestmark = pytest.mark.slow

REACH = ("task=reach", "policy=random", "collect.success_steps=1", "seed=1", "-q")
GUARD = 240.0
"""Seconds after which something hangs."""


def collect(*words: str, code: int = 0) -> Path:
    assert main(["collect", *words]) == code
    return Path("outputs/latest").resolve()


def content(folder: Path) -> list[tuple[object, ...]]:
    """What does not depend on where in the logs an episode is."""
    found = read_collection(folder, failures=True)
    return [(e.attempt, e.steps, e.total_reward, e.success, e.failure) for e in found]


@pytest.fixture(scope="module")
def collection(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("collected")
    return collect(*REACH, "episodes=4", "num_envs=4", f"output_dir={root}") and next(
        root.glob("*/*_reach")
    )


def test_the_lists_say_what_is_in_the_log(collection: Path) -> None:
    episodes = read_collection(collection, failures=True)
    assert len(read_collection(collection)) == 4
    assert [e.attempt for e in episodes] == list(range(len(episodes)))
    with recording.open(collection) as log:
        logged = {(e.env, e.episode): e for e in log.episodes}
    for listed in episodes:
        found = logged[listed.env, listed.episode]
        assert (found.first_step, found.steps) == (listed.first_step, listed.steps)
        assert found.metrics["success"] == listed.success
        assert found.total_reward == pytest.approx(listed.total_reward)
        assert (listed.failure is None) == listed.success
        assert found.truncated
        assert found.counted
    others = logged.keys() - {(e.env, e.episode) for e in episodes}
    assert others  # environments that were still at work when it was complete
    assert not any(logged[key].counted for key in others)
    assert recording.inspect(collection).counted == len(episodes)
    assert verify(collection / "rollout.mcap").ok


def test_the_summary_counts_them(collection: Path) -> None:
    summary = json.loads((collection / "summary.json").read_text())
    episodes = read_collection(collection, failures=True)
    assert summary["status"] == "finished" and summary["successes"] == 4
    assert summary["failures"] == len(episodes) - 4
    assert summary["yield"] == 4 / len(episodes)
    assert sum(summary["failed_in"].values()) == len(episodes) - 4
    assert summary["failed_in"]["ran out of time"] > 0
    assert summary["logs"] == ["rollout.mcap"]


def test_a_report_says_how_it_went(collection: Path, tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    assert main(["report", str(collection), "-o", str(page)]) == 0
    text = page.read_text()
    assert "reach: collection" in text and "failed in: ran out of time" in text
    assert f"embodichain collect resume={collection}" in text


def test_the_number_of_environments_changes_nothing(collection: Path) -> None:
    assert content(collect(*REACH, "episodes=4", "num_envs=1")) == content(collection)


def test_more_later_into_the_same_folder(collection: Path) -> None:
    folder = collect(*REACH, "episodes=2", "num_envs=3")
    config = (folder / "config.yaml").read_text()
    collect(f"resume={folder}", "episodes=3", "num_envs=2", "-q")
    collect("resume=last", "episodes=4", "-q")
    assert content(folder) == content(collection)
    episodes = read_collection(folder, failures=True)
    logs = {"rollout.mcap", "rollout-2.mcap", "rollout-3.mcap"}
    assert {e.log for e in episodes} == logs
    assert set(json.loads((folder / "summary.json").read_text())["logs"]) == logs
    assert (folder / "config.yaml").read_text() == config


@pytest.mark.unmeasured
def test_a_killed_collection_goes_on(commands: Commands, collection: Path) -> None:
    words = [*REACH, "episodes=4", "num_envs=2"]
    process = commands.start("collect", *words)
    deadline = time.monotonic() + GUARD
    while time.monotonic() < deadline and process.poll() is None:
        lists = [*Path("outputs").glob("*/*_reach/*.jsonl")]
        if sum(path.stat().st_size for path in lists):
            process.kill()
        time.sleep(0.002)
    process.communicate()
    folder = Path("outputs/latest").resolve()
    before = content(folder)
    assert before
    for episode in read_collection(folder, failures=True):
        with recording.open(folder / episode.log) as log:
            actions = log.read("actions", episode.env, episode=episode.episode)["actions"]
            assert len(actions) == episode.steps
    if len(read_collection(folder)) < 4:
        collect("resume=last", "-q")
    assert content(folder) == content(collection)


def test_ctrl_c_ends_it_cleanly(commands: Commands) -> None:
    words = ["task=hold_still", "policy=random", "num_envs=2", "collect.give_up_after=null"]
    process = commands.start("collect", *words, "--json")
    deadline = time.monotonic() + GUARD
    while time.monotonic() < deadline and process.poll() is None:
        if any(path.stat().st_size for path in Path("outputs").glob("*/*/failures.jsonl")):
            process.send_signal(signal.SIGINT)
            break
        time.sleep(0.01)
    out, err = process.communicate(timeout=GUARD)
    assert process.returncode == 130 and "interrupted (SIGINT)" in err
    summary = json.loads(out)
    assert summary["status"] == "interrupted" and summary["failures"] > 0
    folder = Path("outputs/latest").resolve()
    assert len(content(folder)) == summary["failures"]
    assert verify(folder / "rollout.mcap").ok


def test_a_planned_policy_says_what_failed() -> None:
    words = ("task=hold_still", "policy={func: 'tests.cli.verbs.planned:Planned'}", "seed=2", "-q")
    folder = collect(
        *words, "episodes=6", "num_envs=4", "collect.success_steps=20", "collect.wait_steps=3"
    )
    episodes = read_collection(folder, failures=True)
    failed = [e for e in episodes if not e.success]
    assert failed and len(episodes) - len(failed) == 6
    assert {e.failure for e in failed} == {"step 2, grasp cube: the fingers closed on nothing"}
    assert {e.steps for e in failed} == {7}
    # A pose that is held is a success in every step: after 20 of them, or when the policy is done.
    assert {e.steps for e in episodes if e.success} == {10, 21}
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["failed_in"] == {"step 2, grasp cube": len(failed)}


def test_it_gives_up(capsys: pytest.CaptureFixture[str]) -> None:
    never = "task.metrics.success.shape.below=-1.0"
    words = ("task=reach", "policy=zero", never, "num_envs=5", "task.max_episode_steps=5")
    folder = collect(*words, "collect.give_up_after=20", code=1)
    printed = capsys.readouterr()
    assert "gave up after 20 failures in a row, most of all: ran out of time" in printed.err
    assert "gave up: too many failures in a row" in printed.out
    assert len(read_collection(folder, failures=True)) == 20


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["task=reach", "policy=zero", "record=none"], "a collection is a log: must not be none"),
        (["task=reach", "policy=zero", "record.every=2"], "must be 1, got 2"),
        (["task=cart_pole", "policy=zero", "~task.metrics.success"], "what success is"),
        (["resume=last"], "there is no collection to resume yet"),
        (["resume=nowhere"], "'nowhere' is not a collection's folder"),
        (["resume=nowhere", "seed=3"], "seed: a resumed collection keeps its config"),
        (["task=reach", "collect.success_step=3"], "Did you mean 'success_steps'?"),
    ],
)
def test_mistakes(words: list[str], says: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["collect", *words]) == 2
    assert says in capsys.readouterr().err
    assert not Path("outputs").exists()


def test_validate_checks_it(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["validate", "--collect", "task=cart_pole", "policy=zero"]
    assert main(words) == 0
    assert main([*words, "record=none"]) == 2
    assert "a collection is a log" in capsys.readouterr().err


def test_a_complete_collection_is_finished(
    collection: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A loop that resumes until the command succeeds ends."""
    before = {path: path.stat().st_mtime_ns for path in collection.iterdir()}
    assert main(["collect", f"resume={collection}"]) == 0
    said = capsys.readouterr().err
    assert "finished already" in said and "has 4 successful episodes: episodes=N" in said
    assert {path: path.stat().st_mtime_ns for path in collection.iterdir()} == before


def test_a_full_disk_is_loud(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write = os.write

    def full(descriptor: int, data: bytes) -> int:
        if b'"attempt"' in bytes(data[:20]):
            raise OSError(28, "No space left on device")
        return write(descriptor, data)

    with monkeypatch.context() as patched:
        patched.setattr(os, "write", full)
        folder = collect(*REACH, "episodes=2", code=1)
    assert "No space left on device: " in capsys.readouterr().err
    assert content(folder) == []
    assert json.loads((folder / "summary.json").read_text())["status"] == "failed"
    collect("resume=last", "-q")
    assert len(read_collection(folder)) == 2
    assert np.all([e.log == "rollout-2.mcap" for e in read_collection(folder)])


def test_a_complete_collection_that_could_not_say_so_is_summed_up(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    """Its process ended after the last success, before its summary."""
    folder = collect(*REACH, "episodes=2", "num_envs=2", f"output_dir={tmp_path}") and next(
        tmp_path.glob("2*/*_reach")
    )
    before = json.loads((folder / "summary.json").read_text())
    (folder / "summary.json").unlink()
    assert main(["collect", f"resume={folder}", "-q"]) == 0
    after = json.loads((folder / "summary.json").read_text())
    for key in ("status", "successes", "failures", "yield", "mean_length", "logs"):
        assert after[key] == before[key]
    assert after["control_steps"] == 0
    capsys.readouterr()
    assert main(["collect", f"resume={folder}", "-q"]) == 0
    assert capsys.readouterr().err.startswith("finished already: ")
