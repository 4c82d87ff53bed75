"""Typed keys of something that is off are named once, and change nothing."""

from pathlib import Path

import pytest

from embodichain.cli import main
from embodichain.config import resolve


def named(*lines: str, verb: str = "run") -> list[str]:
    """The keys that are said to change nothing."""
    resolved = resolve(["task=cart_pole", *lines], verb)  # type: ignore[arg-type]
    return [note.path for note in resolved.notes if "changes nothing: " in note.message]


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        (["viewer.port=8099"], ["viewer.port"]),
        (["viewer.host=0.0.0.0", "viewer.env=0"], ["viewer.host", "viewer.env"]),
        (["viewer=web", "viewer.port=8099", "viewer.env=0"], []),
        (["viewer=native", "viewer.port=8099", "viewer.env=0"], ["viewer.port"]),
        (["video.every=2"], []),
        (["video.every=2", "video=false"], ["video.every"]),
        (["record=none", "record.every=2"], ["record.every"]),
        (["record.format=none", "record.max_mb=2"], ["record.max_mb"]),
        (["record=none", "viewer=foxglove", "record.view_envs=[0]"], []),
        (["record=none", "record.view_envs=[0]"], ["record.view_envs"]),
        (["record.keyframe_every=5"], ["record.keyframe_every"]),
        (["record.state=keyframes", "record.keyframe_every=5"], []),
        (["record.every=2", "viewer=none", "record=mcap"], []),
    ],
)
def test_in_a_run(lines: list[str], expected: list[str]) -> None:
    assert named(*lines) == expected


def test_in_a_training() -> None:
    train = ("algo=ppo", "total_timesteps=64")
    assert named(*train, "wandb.project=arms", verb="train") == ["wandb.project"]
    assert named(*train, "wandb.project=arms", "wandb.mode=offline", verb="train") == []
    assert named(*train, "eval.episodes=0", "video=true", verb="train") == ["video"]
    assert named(*train, "eval.episodes=0", "record=none", verb="train") == []
    assert named(*train, "video=true", verb="train") == []
    page = ("viewer=web", "viewer.wait_s=3")
    assert named(*page) == []
    assert named(*train, *page, verb="train") == ["viewer.wait_s"]


def test_a_file_may_set_them(capsys: pytest.CaptureFixture[str]) -> None:
    folder = Path("conf/viewer")
    folder.mkdir(parents=True)
    (folder / "mine.yaml").write_text("name: none\nport: 8099\n")
    assert named("viewer=mine") == []


def test_it_is_said_once(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["task=cart_pole", "max_steps=2", "record=none", "scene_png=false", "--quiet"]
    assert main(["run", *words, "viewer.port=8099"]) == 0
    err = capsys.readouterr().err
    assert err.count("viewer.port: changes nothing: no viewer is chosen: viewer=web") == 1
    assert main(["validate", "task=cart_pole", "viewer.port=8099"]) == 0
    out, err = capsys.readouterr()
    assert (out + err).count("viewer.port: changes nothing") == 1
