"""`video`: a film of a run, its settings, and what is said about it meanwhile."""

import importlib.util
import json
from importlib.machinery import ModuleSpec
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import embodichain
from embodichain.cli import main
from embodichain.cli.jobs import job as jobs
from embodichain.config.composition.composed import compose
from embodichain.config.keys.schema import VideoCfg
from embodichain.config.resolved import resolve
from tests.recording.film.test_film import pictures

pytestmark = pytest.mark.slow

TINY = ["task=cart_pole", "policy=zero", "num_envs=1", "max_steps=40", "seed=1", "scene_png=false"]


def test_a_run_is_filmed_as_it_says(tmp_path: Path, capsys, monkeypatch) -> None:
    # It is said only of films that take seconds.
    monkeypatch.setattr(jobs, "_SAY_AFTER", 0.0)
    film = ["video=true", "video.size=[96,64]", "video.every=2", "video.max_seconds=0.4"]
    assert main(["run", *TINY, *film, "episodes=50", f"output_dir={tmp_path}"]) == 0
    out, err = capsys.readouterr()
    assert "film: 2/10 pictures  step 2  left " in err
    (path,) = tmp_path.glob("*/*/rollout.mp4")
    assert str(path.name) in out.replace("\n", "")
    about, frames = pictures(path)
    assert (about["size"], about["fps"], len(frames)) == ((96, 64), 25.0, 10)
    assert not (path.parent / "scene.png").exists()


def test_a_gif_is_a_film_too_and_is_in_the_report(tmp_path: Path, capsys) -> None:
    film = ["video.format=gif", "video.size=[48,32]"]
    assert main(["run", *TINY, *film, "max_steps=9", f"output_dir={tmp_path}", "--quiet"]) == 0
    folder = (tmp_path / "latest").resolve()
    with Image.open(folder / "rollout.gif") as gif:  # 50 steps a second: every second one
        assert (gif.size, gif.n_frames, gif.info["duration"]) == ((48, 32), 5, 40)
    assert main(["report", str(folder), "--quiet"]) == 0
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert '<img src="data:image/gif;base64,' in page and "<video" not in page


def test_a_plain_installation_makes_a_gif(tmp_path: Path, capsys, monkeypatch) -> None:
    """`video=true` needs no extra; a format that needs one is refused by name."""
    find_spec = importlib.util.find_spec

    def without_encoder(name: str) -> ModuleSpec | None:
        return None if name == "imageio_ffmpeg" else find_spec(name)

    # The encoder is installed here.
    monkeypatch.setattr(importlib.util, "find_spec", without_encoder)
    where = f"output_dir={tmp_path}"
    assert main(["run", *TINY, "max_steps=3", "video=true", "--json", where]) == 0
    film = Path(json.loads(capsys.readouterr().out)["video"])
    with Image.open(film) as gif:
        assert (film.name, gif.size, gif.n_frames) == ("rollout.gif", (640, 480), 2)
    assert "embodichain[video]" in (film.parent / "run.log").read_text(encoding="utf-8")
    assert main(["run", *TINY, "video.format=mp4", where]) == 2
    assert "imageio-ffmpeg" in capsys.readouterr().err
    assert main(["replay", str(film.parent), "--video", str(tmp_path / "a.mp4")]) == 2
    assert "or a.gif" in " ".join(capsys.readouterr().err.split())


def test_a_film_shows_the_halo_of_a_goal(tmp_path: Path) -> None:
    """It is in the log's model, which is drawn after the run."""
    shares = []
    for halo in ("null", "{radius: 0.3}"):
        folder = tmp_path / str(len(shares))
        task = ["task=reach", "policy=zero", "num_envs=1", "max_steps=1", "seed=1"]
        film = ["video.format=gif", "video.size=[64,48]", f"task.objects.goal.halo={halo}"]
        words = [*task, *film, "scene_png=false", f"output_dir={folder}", "--quiet"]
        assert main(["run", *words]) == 0
        with Image.open(folder / "latest" / "rollout.gif") as gif:
            colors = np.asarray(gif.convert("RGB")).astype(int)
        is_orange = colors[..., 0] - colors[..., 2] > 25
        shares.append(is_orange.mean())
    assert shares[0] < 0.01 and shares[1] > 0.05


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        ([], None),
        (["video=true"], True),
        (["video.every=3"], VideoCfg(every=3)),
        (["video.every=3", "video=true"], VideoCfg(every=3)),
        (["video=true", "video.every=3"], VideoCfg(every=3)),
        (["video.every=3", "video=false"], False),
        (["video={size: [32, 16]}", "video.max_seconds=2"], VideoCfg([32, 16], None, 2.0)),
    ],
    ids=str,
)
def test_settings_of_a_film_turn_it_on(lines: list[str], expected: object) -> None:
    assert resolve(compose(["task=cart_pole", *lines]), "run").root.video == expected


def test_json_names_the_film(tmp_path: Path, capsys) -> None:
    where = f"output_dir={tmp_path}"
    assert main(["run", *TINY, "max_steps=3", "video.size=[32,32]", "--json", where]) == 0
    found = json.loads(capsys.readouterr().out)
    assert len(pictures(found["video"])[1]) == 3


def test_the_picture_of_a_run_is_of_its_start(tmp_path: Path) -> None:
    """It is drawn at the end, when everything has moved."""
    assert main(["run", *TINY, "scene_png=true", "--quiet", f"output_dir={tmp_path}"]) == 0
    (path,) = tmp_path.glob("*/*/scene.png")
    env = embodichain.make("cart_pole", num_envs=1, overrides=["seed=1"])
    env.reset()
    start = env.sim.render(0, "default", 1280, 960)
    env.sim.update(step=50)
    end = env.sim.render(0, "default", 1280, 960)
    env.close()
    with Image.open(path) as picture:
        np.testing.assert_array_equal(np.asarray(picture), start)
    assert not np.array_equal(start, end)
