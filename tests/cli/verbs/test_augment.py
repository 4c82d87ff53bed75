"""`augment`: a few successful episodes of a task become many, in starts of their own."""

import json
from pathlib import Path

import numpy as np
import pytest

import embodichain.recording as recording
from embodichain.cli import main
from embodichain.recording.check.verification import verify
from embodichain.recording.demos.collection import read_collection
from embodichain.recording.demos.segments import read_sources

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def few(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two successful episodes."""
    root = tmp_path_factory.mktemp("few")
    words = ["task=pick_place", "episodes=2", "seed=4", "-q", f"output_dir={root}"]
    assert main(["collect", *words]) == 0
    return next(root.glob("*/*_pick_place"))


def augment(*words: str) -> Path:
    assert main(["augment", *words, "-q"]) == 0
    return Path("outputs/latest").resolve()


def content(folder: Path) -> list[tuple[object, ...]]:
    return [(e.attempt, e.steps, e.total_reward, e.success) for e in read_collection(folder)]


def test_segments_end_where_the_gripper_acts_and_act_on_what_is_near(few: Path) -> None:
    names, sources = read_sources(few, most=5)
    assert len(sources) == 2
    for source in sources:
        (segments,) = source.segments
        assert [names[s.target] for s in segments[:2]] == ["cube", "stand"]
        assert segments[0].start == 0 and segments[-1].stop == len(source.actions)
        assert all(a.stop == b.start for a, b in zip(segments, segments[1:], strict=False))
        closed = source.actions[:, -1] < 0
        grasp, release = segments[0].stop, segments[1].stop
        assert closed[grasp] and not closed[release - 1]
        at = source.tools[0, :, :3]
        assert np.linalg.norm(at[grasp] - source.targets[names.index("cube"), grasp, :3]) < 0.02


def test_two_episodes_become_eight_in_other_starts(few: Path) -> None:
    folder = augment(str(few), "episodes=8", "seed=9")
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["successes"] == 8 and summary["yield"] > 0.7
    assert verify(folder / "rollout.mcap").ok
    starts = []
    for listed in read_collection(folder):
        with recording.open(folder / listed.log) as log:
            starts.append(log.read("qpos", listed.env, episode=listed.episode)["qpos"][0])
    assert len(np.unique(np.round(starts, 4), axis=0)) == 8
    # Fewer at a time, and interrupted: the same episodes.
    again = augment(str(few), "episodes=3", "num_envs=2", "seed=9")
    assert main(["collect", f"resume={again}", "episodes=8", "-q"]) == 0
    assert content(again) == content(folder)


def test_any_log_of_a_task_will_do(few: Path) -> None:
    words = ["task=pick_place", "policy=expert", "num_envs=1", "episodes=1", "seed=8", "-q"]
    assert main(["run", *words, "scene_png=false"]) == 0
    folder = augment("last", "episodes=2", "seed=1")
    assert len(read_collection(folder)) == 2


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["last"], "no run in outputs has a log yet"),
        (["nowhere"], "there is no 'nowhere'"),
        (["FEW", "policy=zero"], "policy: an augmented collection keeps its config"),
        (["FEW", "resume=last"], "embodichain collect resume=FOLDER"),
        (["FEW", "pick_place"], "values are given as key=value: pick_place"),
        (["FEW", "task.evens.push=1"], "Did you mean 'events'?"),
    ],
)
def test_mistakes(
    few: Path, words: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["augment", *(str(few) if word == "FEW" else word for word in words)]) == 2
    assert says in capsys.readouterr().err
    assert not Path("outputs").exists()


def test_a_log_without_successes_has_nothing_to_repeat(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["task=pick_place", "policy=zero", "task.max_episode_steps=3", "num_envs=1"]
    assert main(["run", *words, "episodes=1", "scene_png=false", "-q"]) == 0
    assert main(["augment", "last", "episodes=2"]) == 2
    assert "has no successful episode" in capsys.readouterr().err


def test_what_another_arm_holds_is_followed() -> None:
    assert main(["collect", "task=hand_over", "episodes=1", "seed=3", "-q"]) == 0
    few = Path("outputs/latest").resolve()
    names, (source,) = read_sources(few, most=1)
    split = [[(names[s.target], s.follows) for s in segments] for segments in source.segments]
    giving, taking = sorted(split, key=lambda segments: segments[0][1])
    assert giving[0] == ("bar", False)
    assert giving[1] in [("world", False), ("table", False)]  # neither moves
    assert taking[0] == ("bar", True)
    assert len(read_collection(augment(str(few), "episodes=2", "seed=6"))) == 2
