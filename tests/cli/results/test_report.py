"""`embodichain report`: one page about a run, as a browser shows it and as people use it."""

import html
import json
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from embodichain.cli import main
from embodichain.utils.errors import ConfigError
from tests.helpers.browser import chromium, needs_chromium

pytestmark = pytest.mark.slow

WILD = "Balance </pre><script>document.title = 'taken'</script> & more."


def made(folder: Path, *arguments: str) -> Path:
    """The only run that a command makes below a folder."""
    assert main([*arguments, f"output_dir={folder}", "--quiet"]) == 0
    return (folder / "latest").resolve()


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    task = ("task=cart_pole", f'task.description="{WILD}"', "task.max_episode_steps=5")
    extra = ("num_envs=2", "episodes=2", "video=true")
    return made(tmp_path_factory.mktemp("run"), "run", *task, *extra)


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    algo = ("algo.n_steps=16", "algo.batch_size=32", "num_envs=4", "eval.episodes=4", "seed=5")
    task = ("task=cart_pole", "task.max_episode_steps=20", "total_timesteps=256", "record=none")
    return made(tmp_path_factory.mktemp("training"), "train", *task, *algo)


def page(run: Path) -> str:
    assert main(["report", str(run), "--quiet"]) == 0
    return (run / "report.html").read_text(encoding="utf-8")


def table(text: str, section: str) -> dict[str, str]:
    """First and second column of a section's table."""
    part = text.partition(f'<h2 id="{section}">')[2].partition("<h2")[0]
    cells = re.findall(r"<tr><th>(.*?)</th><td>(.*?)</td>", part)
    return {html.unescape(name): html.unescape(value) for name, value in cells}


def commands(text: str) -> list[str]:
    part = text.partition('<h2 id="repeat">')[2].partition("<h2")[0]
    return [html.unescape(line) for line in re.findall(r"<pre>(.*?)</pre>", part)]


@needs_chromium
def test_the_page_is_whole_and_loads_nothing(simulated: Path, tmp_path: Path) -> None:
    page(simulated)
    sent = tmp_path / "elsewhere.html"  # nothing of the run is beside it
    shutil.move(simulated / "report.html", sent)
    with chromium() as visit:
        shown = visit("about:blank", 700, 900)
        asked: list[str] = []
        errors: list[str] = []
        shown.on("request", lambda request: asked.append(request.url.partition(",")[0]))
        shown.on("pageerror", lambda error: errors.append(str(error)))
        shown.on("console", lambda line: errors.append(line.text))
        shown.goto(sent.as_uri())
        shown.wait_for_function("document.querySelector('video').readyState >= 2")
        assert {url for url in asked if not url.startswith("data:")} == {sent.as_uri()}
        assert errors == []
        assert shown.title() == "cart_pole: run"
        assert WILD in shown.inner_text("body")
        assert shown.evaluate("document.images[0].naturalWidth") == 1280
        film = "document.querySelector('video')"
        assert shown.evaluate(f"{film}.videoWidth") == 640
        assert 0.15 < shown.evaluate(f"{film}.duration") < 0.3  # 10 steps of 0.02 s
        assert shown.evaluate("document.querySelectorAll('svg path').length") > 4
        assert shown.evaluate("document.documentElement.scrollWidth") <= 700


def test_results_and_rewards_are_those_of_the_summary(simulated: Path) -> None:
    text, summary = page(simulated), json.loads((simulated / "summary.json").read_text())
    results = table(text, "results")
    assert results["episodes"] == "4 of 4 (2 environments)"
    assert results["return"].startswith(f"{summary['return']['mean']:.4g} ± ")
    assert not any(name.startswith("reward") for name in results)
    assert table(text, "rewards") == {"alive": f"{summary['rewards']['alive']:.4g}"}
    ended = table(text, "log")["episodes that ended"]
    assert ended == "4, of which 4 count: the first of each environment"
    assert (
        table(text, "versions")["mujoco"]
        == json.loads((simulated / "versions.json").read_text())["mujoco"]
    )
    drawn = re.findall(r"<text [^>]*>([^<]+)</text>", text)
    assert {"mean reward of a control step", "return of each episode"} <= set(drawn)
    config = html.unescape(text.partition("Everything, resolved</summary>")[2])
    assert (simulated / "config.yaml").read_text() in config


def test_its_commands_repeat_the_run(
    simulated: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(simulated.parents[1])
    lines = {line.split()[1]: line for line in commands(page(simulated))}
    assert set(lines) == {"run", "replay", "view"}
    again = [line for line in commands(page(simulated)) if "seed=" in line]
    words = shlex.split(again[0])[1:]
    assert main([*words, f"output_dir={tmp_path}", "video=null", "scene_png=false"]) == 0
    first, second = (
        json.loads((run / "summary.json").read_text()) for run in (simulated, tmp_path / "latest")
    )
    assert first["return"] == second["return"] and first["rewards"] == second["rewards"]
    verify = next(line for line in commands(page(simulated)) if line.endswith("--verify"))
    assert main(shlex.split(verify)[1:]) == 0


def test_a_training_has_curves_of_every_reward_and_its_policy_plays(trained: Path) -> None:
    text = page(trained)
    drawn = re.findall(r"<text [^>]*>([^<]+)</text>", text)
    assert {"mean return", "success rate", "rewards by term"} <= set(drawn)
    assert table(text, "results")["eval episodes"].startswith("4 episodes")
    assert [line.split()[1] for line in commands(text)] == ["train", "eval", "run"]
    assert '<h2 id="film">' not in text and '<h2 id="log">' not in text


def test_an_evaluation_shows_its_intervals(trained: Path, tmp_path: Path) -> None:
    arguments = ("eval", str(trained), "episodes=4", "record=none")
    text = page(made(tmp_path, *arguments))
    found = json.loads((tmp_path / "latest" / "eval.json").read_text())
    assert "<title>cart_pole: evaluation</title>" in text
    assert table(text, "results")["return mean"].startswith(f"{found['returns']['mean']:.4g}")
    assert set(table(text, "rewards")) == {"alive"}


def copied(run: Path, to: Path) -> Path:
    folder = to / "12-00-00_cart_pole"
    shutil.copytree(run, folder)
    return folder


def test_a_run_that_failed_or_was_killed_has_a_page(simulated: Path, tmp_path: Path) -> None:
    run = copied(simulated, tmp_path)
    (run / "summary.json").write_text('{"task": "cart_pole", "status": "failed", "error": "no!"}')
    assert "failed: no!" in page(run)
    (run / "summary.json").unlink()
    assert "run, unfinished" in page(run)
    log = (run / "rollout.mcap").read_bytes()
    (run / "rollout.mcap").write_bytes(log[:-64])
    assert "log: incomplete" in page(run)
    (run / "rollout.mcap").write_bytes(b"nothing of this kind")
    assert "the log cannot be read" in page(run)


def test_a_log_without_states_has_no_curves(tmp_path: Path) -> None:
    run = ("run", "task=cart_pole", "max_steps=5", "record.state=none", "scene_png=false")
    text = page(made(tmp_path, *run))
    assert "no curves: " in text and "<svg" not in text
    assert table(text, "log")["environments"].startswith("4, seed ")


def test_films_that_are_too_large_are_named(simulated: Path, tmp_path: Path) -> None:
    run = copied(simulated, tmp_path)
    with (run / "second.mp4").open("wb") as film:
        film.truncate(65 * 2**20)
    text = page(run)
    assert "second.mp4 is not in the page" in text and len(text) < 5e6


def test_mistakes_are_reported(
    simulated: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = copied(simulated, tmp_path)
    (tmp_path / "mine.html").write_text("mine")
    (run / "summary.json").write_text("{")
    for arguments, message in (
        ([str(simulated), "-o", str(tmp_path / "mine.html")], "mine.html exists"),
        (["nowhere"], "there is no run 'nowhere'"),
        ([str(tmp_path)], "is not a run's folder: it has no config.yaml"),
        ([str(run)], "summary.json is damaged"),
    ):
        assert main(["report", *arguments]) == 2
        assert message in capsys.readouterr().err
    assert (tmp_path / "mine.html").read_text() == "mine"


def test_what_a_killed_training_left_of_its_first_checkpoint_is_removed(tmp_path: Path) -> None:
    from embodichain.config.run_folder import checkpoint_of
    from embodichain.utils.system.processes import own_process

    with subprocess.Popen([sys.executable, "-c", ""]) as ended:
        pass
    (tmp_path / "config.yaml").write_text("seed: 1\ntask: {}\n")
    (tmp_path / "checkpoints").mkdir()
    process = f"{own_process().place}-{ended.pid}-{own_process().began}"
    left = tmp_path / f"checkpoints/.step_000000000072.{process}-3.part.zip"
    left.write_bytes(b"half")
    main(["report", str(tmp_path)])
    assert not left.exists()
    left.write_bytes(b"half")
    with pytest.raises(ConfigError, match="it is not the folder of a finished training"):
        checkpoint_of(tmp_path)
    assert not left.exists()
