"""What `train` leaves in its folder besides what was learned: the evaluation at its end."""

import base64
import importlib.util
import io
import json
import os
import re
import signal
from pathlib import Path

import pytest
from PIL import Image

from embodichain.cli import main
from embodichain.cli.jobs.job import execute
from embodichain.cli.jobs.work.train_job import train_job
from embodichain.config import resolve
from embodichain.recording import inspect, verify

pytestmark = pytest.mark.slow

TINY = (
    *("task=reach", "num_envs=4", "total_timesteps=64", "algo.n_steps=8", "algo.batch_size=16"),
    *("seed=5", "task.max_episode_steps=12", "sim.num_threads=1"),
)


def told(capsys, *arguments):
    assert main([*arguments, "--json"]) == 0, capsys.readouterr().err
    return json.loads(capsys.readouterr().out)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """The folder of a training of `reach`, evaluated on six episodes."""
    root = tmp_path_factory.mktemp("trained")
    assert main(["train", *TINY, "--quiet", "eval.episodes=6", f"output_dir={root}"]) == 0
    return next(path.parent for path in root.glob("*/*/config.yaml"))


def test_a_training_is_evaluated_as_eval_would(trained, capsys):
    summary = json.loads((trained / "summary.json").read_text())
    whole = json.loads((trained / "eval.json").read_text())
    again = told(capsys, "eval", str(trained), "episodes=6", "record=none")
    drawn = whole["per_episode"].pop("drawn")  # it is read from the log, which `again` has not
    assert {name: len(draws) for name, draws in drawn.items()} == {"place_goal.position": 6}
    apart = ("folder", "log", "seconds")
    assert {k: v for k, v in whole.items() if k not in apart} == {
        k: v for k, v in again.items() if k not in apart
    }
    assert "per_episode" not in summary["eval"] and len(whole["per_episode"]["return"]) == 6
    assert summary["eval"].items() <= whole.items()
    low, high = summary["eval"]["returns"]["mean_interval"]
    assert low < summary["eval"]["returns"]["mean"] < high
    assert summary["objective"] == summary["eval"]["success"]["rate"]


def test_the_evaluation_is_logged(trained, capsys):
    log = trained / "rollout.mcap"
    assert json.loads((trained / "eval.json").read_text())["log"] == str(log)
    assert len(inspect(log).episodes) == 8  # two of all four environments
    assert verify(log).ok
    assert not list(trained.glob("*.mp4"))


def test_what_a_sweeper_gets(tmp_path):
    """Success rate, or the mean return of a task that knows no success."""
    without = "~task.metrics.success"
    for lines in ([], [without], [without, "eval.episodes=0"]):
        overrides = [*TINY, "eval.episodes=3", "quiet=true", f"output_dir={tmp_path}", *lines]
        found = execute(resolve(overrides, "train"), train_job, ["embodichain", "train"])
        folder = tmp_path / "latest"
        summary = json.loads((folder / "summary.json").read_text())
        assert found == summary["objective"]
        if not lines:
            assert found == summary["eval"]["success"]["rate"]
        elif len(lines) == 1:
            assert found == summary["eval"]["returns"]["mean"]
        else:
            assert found == summary["mean_return"] and summary["eval"] is None
            assert not (folder / "eval.json").exists() and not (folder / "rollout.mcap").exists()


def test_the_table_names_the_evaluation(capsys, tmp_path: Path):
    assert main(["train", *TINY, "eval.episodes=2", "record=none"]) == 0
    text = capsys.readouterr().out
    assert "eval success" in text and "0 of 2" in text and "eval return mean" in text
    assert not list(Path("outputs").rglob("*.mcap"))


def test_what_the_evaluation_cannot_show_is_said_before_it_trains(capsys):
    assert main(["train", *TINY, "eval.episodes=2", "record.view_envs=[3]"]) == 2
    assert "record.view_envs: no such environments: [3]" in capsys.readouterr().err
    assert not list(Path("outputs").rglob("checkpoints"))


def test_what_goes_on_is_evaluated_as_it_is_asked_for(trained, capsys):
    """The run's own flags of output do not count: it was quiet."""
    lines = ("total_timesteps=96", "record=none", "eval.episodes=3", "output_dir=outputs")
    assert main(["train", f"resume={trained}", *lines]) == 0
    text = capsys.readouterr().out
    assert "eval success" in text and "of 3" in text
    folder = Path("outputs/latest")
    summary = json.loads((folder / "summary.json").read_text())
    assert (summary["env_steps"], summary["eval"]["episodes"]) == (96, 3)
    assert summary["resumed_from"] == str(trained / "checkpoints/final.zip")
    assert not (folder / "rollout.mcap").exists() and (folder / "eval.json").is_file()


def test_an_interrupted_evaluation_is_told_as_such(capsys, monkeypatch):
    from embodichain.learning.evaluation import evaluation

    real = evaluation.evaluate

    def interrupted(*args, **kwargs):
        os.kill(os.getpid(), signal.SIGINT)  # Ctrl-C comes as the evaluation begins
        return real(*args, **kwargs)

    # A signal from outside would come at another moment each time.
    monkeypatch.setattr(evaluation, "evaluate", interrupted)
    assert main(["train", *TINY, "--quiet", "record=none"]) == 130
    assert "interrupted (SIGINT); outputs" in capsys.readouterr().err
    folder = Path("outputs/latest")
    summary = json.loads((folder / "summary.json").read_text())
    assert (summary["status"], summary["eval"]["complete"]) == ("finished", False)
    assert summary["eval"]["episodes"] == 0
    assert (folder / "checkpoints/final.zip").is_file()


def test_recurrent_policies_from_end_to_end(capsys):
    pytest.importorskip("sb3_contrib")
    lines = ("algo=recurrent_ppo", "algo.policy_kwargs={lstm_hidden_size: 8, net_arch: [8]}")
    found = told(capsys, "train", *TINY, *lines, "eval.episodes=5", "record=none")
    assert found["algo"] == "recurrent_ppo" and found["eval"]["episodes"] == 5
    again = told(capsys, "eval", "last", "episodes=5", "record=none")
    assert again["returns"]["mean"] == found["eval"]["returns"]["mean"]
    played = ("policy=last", "task=reach", "task.max_episode_steps=4", "num_envs=2", "record=none")
    played += ("allow_changed=true",)
    assert told(capsys, "run", *played)["episodes"] == 2
    assert main(["export", "policy", "last", "-o", "p.onnx"]) == 2
    assert "is recurrent: a file without memory cannot act as it does" in capsys.readouterr().err
    assert not Path("p.onnx").exists()


def test_films(trained, capsys, monkeypatch):
    pytest.importorskip("imageio_ffmpeg")
    lines = ("video=true", "episodes=1")
    found = told(capsys, "eval", str(trained), *lines)
    film = Path(found["folder"]) / "rollout.mp4"
    assert found["video"] == str(film) and film.read_bytes()[4:8] == b"ftyp"
    assert "video" not in json.loads((film.parent / "eval.json").read_text())
    found = told(capsys, "train", *TINY, "eval.episodes=1", "video=true")
    assert found["eval"]["episodes"] == 1
    assert (Path(found["folder"]) / "rollout.mp4").is_file()
    assert main(["train", *TINY, "eval.episodes=0", "video=true"]) == 2
    assert "video: there is no evaluation to film" in capsys.readouterr().err
    find_spec = importlib.util.find_spec
    # Both are installed here.
    absent = {"imageio", "imageio_ffmpeg"}
    monkeypatch.setattr(
        "importlib.util.find_spec", lambda name: None if name in absent else find_spec(name)
    )
    before = len(list(Path("outputs").rglob("checkpoints")))
    assert main(["train", *TINY, "video.format=mp4"]) == 2
    assert "pip install 'embodichain[video]'" in capsys.readouterr().err
    assert len(list(Path("outputs").rglob("checkpoints"))) == before


def test_a_training_that_dies_leaves_a_summary(tmp_path, monkeypatch, capsys):
    from embodichain.learning.training import session

    def broken(self, *arguments):
        raise RuntimeError("the network has gone")

    # No config makes a learner fail in the middle of its updates.
    monkeypatch.setattr(session.Session, "learn", broken)
    assert main(["train", *TINY, "--quiet", "eval.episodes=0", f"output_dir={tmp_path}"]) == 1
    (path,) = tmp_path.glob("*/*/summary.json")
    summary = json.loads(path.read_text())
    assert (summary["status"], summary["task"], summary["seed"]) == ("failed", "reach", 5)
    assert summary["error"] == "RuntimeError('the network has gone')"
    assert main(["report", str(path.parent)]) == 0
    assert "the network has gone" in (path.parent / "report.html").read_text()


def test_the_report_says_which_episodes_of_the_log_count(trained, tmp_path):
    page = tmp_path / "page.html"
    assert main(["report", str(trained), "-o", str(page), "--no-film"]) == 0
    text = page.read_text()
    assert text.count("8, of which 6 count: the first of each environment") == 2
    assert "<th>counted</th>" in text
    assert "drawn from the log" not in text and text.count("<figcaption>step ") == 5
    # Why the result differs from where the curves end.
    assert "The evaluation plays the mean action" in text
    summary = trained / "eval.json"
    drawn = json.loads(summary.read_text()) | {"deterministic": False}
    (tmp_path / "drawn").mkdir()
    for path in trained.glob("*.*"):
        if path.suffix != ".mcap":
            (tmp_path / "drawn" / path.name).write_bytes(path.read_bytes())
    (tmp_path / "drawn/eval.json").write_text(json.dumps(drawn))
    assert main(["report", str(tmp_path / "drawn"), "-q"]) == 0
    assert "plays the mean action" not in (tmp_path / "drawn/report.html").read_text()


def test_the_report_films_an_episode_of_the_policy(trained, tmp_path, capsys, monkeypatch):
    find_spec = importlib.util.find_spec
    # It is installed here: without it, the film is a GIF.
    monkeypatch.setattr(
        "importlib.util.find_spec", lambda name: None if "ffmpeg" in name else find_spec(name)
    )
    page = tmp_path / "page.html"
    assert main(["report", str(trained), "-o", str(page)]) == 0
    assert "drawing an episode: --no-film leaves it out" in capsys.readouterr().err
    text = page.read_text()
    assert "drawn from the log for this page: environment " in text
    (film,) = re.findall(r'<img src="data:image/gif;base64,([^"]+)"', text)
    with Image.open(io.BytesIO(base64.b64decode(film))) as gif:
        # 12 steps of 0.02 s, at most 25 pictures a second
        assert (gif.size, gif.n_frames, gif.info["duration"]) == ((480, 360), 6, 40)
    assert not list(trained.glob("*.gif"))
