"""`embodichain report`: one page about a run, as a browser shows it and as people use it."""

import html
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from embodichain import recording
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


SHORT = (
    *("task.max_episode_steps=8", "algo.n_steps=16", "algo.batch_size=32", "eval.episodes=0"),
    "~task.rewards.near",
)


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    algo = ("algo.n_steps=16", "algo.batch_size=32", "num_envs=4", "eval.episodes=4", "seed=5")
    task = ("task=cart_pole", "task.max_episode_steps=20", "total_timesteps=256", "record=none")
    second = "+task.rewards.effort={func: action, shape: [l2], weight: -0.01}"
    return made(tmp_path_factory.mktemp("training"), "train", *task, second, *algo)


def page(run: Path) -> str:
    assert main(["report", str(run), "--quiet"]) == 0
    return (run / "report.html").read_text(encoding="utf-8")


def table(text: str, section: str) -> dict[str, str]:
    """First and second column of a section's table."""
    part = re.split(r"<h2|</details>", text.partition(f' id="{section}">')[2])[0]
    cells = re.findall(r"<tr><th>(.*?)</th><td[^>]*>(.*?)</td>", part)
    return {html.unescape(name): html.unescape(value) for name, value in cells}


def tiles(text: str) -> dict[str, list[str]]:
    """What the page begins with: name -> value, and the lines about it."""
    found = {}
    for tile in text.split('<div class="tile">')[1:]:
        name, *lines = re.findall(r'<div class="(?:what|value|about)">(.*?)</div>', tile)
        found[html.unescape(name)] = [html.unescape(line) for line in lines]
    return found


def titles(text: str) -> set[str]:
    """The titles of all figures."""
    return {html.unescape(title) for title in re.findall(r"<figcaption><b>(.*?)</b>", text)}


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
    assert tiles(text)["success"][0] == f"{summary['success_rate']:.1%}"
    assert tiles(text)["return"][0] == f"{summary['return']['mean']:.4g}"
    ended = table(text, "log")["episodes that ended"]
    assert ended == "4, of which 4 count: the first of each environment"
    assert (
        table(text, "versions")["mujoco"]
        == json.loads((simulated / "versions.json").read_text())["mujoco"]
    )
    assert titles(text) >= {"mean reward of a control step", "return", "length in control steps"}
    config = html.unescape(text.partition("Everything, resolved</p>")[2])
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
    assert titles(text) >= {"mean return", "success rate", "rewards by term"}
    assert " · ppo, seed 5, 4 environments<" in text
    results = table(text, "results")
    assert results["eval episodes"].startswith("4 episodes")
    # Neither a row without a value nor a share as a bare number.
    assert "demonstrations" not in results and "resumed from" not in results
    assert results["success rate"].endswith("%")
    assert [line.split()[1] for line in commands(text)] == ["train", "eval", "run"]
    assert "no pictures: the run has no log" in text and ' id="log">' not in text


def test_an_evaluation_shows_its_intervals(trained: Path, tmp_path: Path) -> None:
    arguments = ("eval", str(trained), "episodes=4", "record=none")
    text = page(made(tmp_path, *arguments))
    found = json.loads((tmp_path / "latest" / "eval.json").read_text())
    assert "<title>cart_pole: evaluation</title>" in text
    assert table(text, "results")["return mean"].startswith(f"{found['returns']['mean']:.4g}")
    low, high = found["success"]["interval"]
    assert tiles(text)["success"] == [
        f"{found['success']['rate']:.1%}",
        f"95 % interval {low:.1%} to {high:.1%}",
        f"{found['success']['count']} of 4 episodes",
    ]
    # The seed that was typed, or would have been: environments of an evaluation have another.
    again = next(line for line in commands(text) if " seed=" in line)
    assert f" seed={found['seed']}" in again
    assert set(table(text, "rewards")) == {"alive", "effort"}


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
    assert "no curves: " in text and "no pictures of the log: " in text
    assert "mean reward" not in text
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
    (tmp_path / "empty").mkdir()
    (run / "summary.json").write_text("{")
    for arguments, message in (
        ([str(simulated), "-o", str(tmp_path / "mine.html")], "mine.html exists"),
        (["nowhere"], f"there is no run 'nowhere': no folder {Path.cwd() / 'nowhere'}; 'last' is"),
        ([str(tmp_path / "empty")], "has no run: there is no config.yaml of one"),
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


@pytest.fixture(scope="module")
def failing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Environments that differ: in some the pole falls, in others the time ends."""
    task = ("task=cart_pole", "task.max_episode_steps=25", "seed=3")
    extra = ("num_envs=4", "episodes=2", "scene_png=false")
    return made(tmp_path_factory.mktemp("failing"), "run", *task, *extra)


def pictures(text: str) -> list[tuple[str, str]]:
    """Content and caption of each JPEG of a page."""
    images = re.findall(r'<img src="(data:image/jpeg;base64,[^"]+)" alt="([^"]*)"', text)
    return [(source, html.unescape(caption)) for source, caption in images]


def test_a_log_has_a_strip_and_the_ends_of_failed_episodes(failing: Path) -> None:
    text = page(failing)
    shown = pictures(text)
    strip = [caption for _, caption in shown if caption.startswith("step ")]
    assert strip[0] == "step 0" and len(strip) == 5
    with recording.open(failing) as log:
        failed = [episode for episode in log.episodes if episode.counted and not episode.success]
    captions = [caption for _, caption in shown if caption.startswith("environment ")]
    assert len(captions) == min(len(failed), 8) and failed
    for episode in failed[:8]:
        words = f"environment {episode.env}, episode {episode.episode}, {episode.steps} steps: "
        end = ", ".join(episode.reasons) or "time limit"
        assert words + end in captions
    assert f"{len(failed)} of 8 episodes failed" in text
    assert len({source for source, _ in shown}) == len(shown)


def test_rows_are_folded_and_the_distribution_has_each_episode(failing: Path) -> None:
    text = page(failing)
    folded = text.partition('<details id="rows">')[2].partition("</details>")[0]
    assert folded.count("<tr>") == 9 and text.count("<th>ended by</th>") == 1
    figure = text.partition("<b>length in control steps</b>")[2].partition("</figure>")[0]
    counts = re.findall(r"<title>(\d+) episodes?, ", figure)
    assert sum(map(int, counts)) == 8


def test_without_a_renderer_the_page_says_so(
    failing: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("EMBODICHAIN_RENDERER", "rays")
    text = page(copied(failing, tmp_path))
    assert pictures(text) == []
    assert "no pictures of the log: colours need OpenGL" in text
    assert "no pictures of failed episodes: colours need OpenGL" in text
    assert "length in control steps" in titles(text)


def test_a_run_without_ends_shows_what_its_log_has(failing: Path, tmp_path: Path) -> None:
    run = made(tmp_path, "run", "task=cart_pole", "max_steps=6", "scene_png=false", "num_envs=1")
    (run / "summary.json").unlink()
    text = page(run)
    assert "run, unfinished" in text and "environment 0, episode 0, 6 control steps" in text
    assert [caption for _, caption in pictures(text)][-1] == "step 5"


def test_a_curve_that_says_nothing_is_left_out(tmp_path: Path) -> None:
    """The reward of the only term, and a length that never changes."""
    run = made(tmp_path, "train", "task=reach", "num_envs=4", "total_timesteps=128", *SHORT)
    assert titles(page(run)) & {"rewards by term", "mean length (control steps)"} == set()


def test_figures_need_no_package(
    trained: Path, failing: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert "rewards by term" in titles(page(trained))
    assert "mean reward of a control step" in titles(page(failing))


def test_a_command_with_the_link_latest_is_repeated_with_the_path(
    trained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root = tmp_path / "outputs"
    shutil.copytree(trained.parents[1], root, symlinks=True)
    monkeypatch.chdir(tmp_path)
    run = Path("outputs") / os.readlink("outputs/latest")
    assert main(["eval", "outputs/latest", "episodes=2", "record=none", "-q"]) == 0
    typed = (root / "latest" / "command.txt").read_text().splitlines()[-1]
    assert typed.startswith(f"embodichain eval {run} ")
    # A record of an older version has the word; the config says what it was.
    (root / "latest" / "command.txt").write_text("cd /\nembodichain eval last episodes=2\n")
    text = page((root / "latest").resolve())
    assert commands(text)[0] == f"embodichain eval {run} episodes=2"
    assert "It was run in /." in text


def test_a_job_of_a_sweep_is_repeated_alone(trained: Path, tmp_path: Path) -> None:
    job = copied(trained, tmp_path)
    (job / "command.txt").write_text("cd /\nembodichain train -m task=cart_pole seed=1,2\n")
    typed = "[hydra.mode=MULTIRUN, task=cart_pole, ++seed=2, ++algo.gamma=0.9]\n"
    (job / "overrides.yaml").write_text(typed)
    assert commands(page(job))[0] == "embodichain train task=cart_pole seed=2 algo.gamma=0.9"


@needs_chromium
def test_a_page_runs_no_script_that_is_not_its_own(simulated: Path, tmp_path: Path) -> None:
    """If a text were not escaped, the policy would still stop it."""
    script = "<script>document.title = 'taken'</script>"
    picture = """<img src="x" onerror="document.title = 'taken'">"""
    broken = tmp_path / "broken.html"
    broken.write_text(page(simulated).replace("<header>", f"<header>{script}{picture}"))
    with chromium() as visit:
        shown = visit("about:blank", 700, 900)
        errors: list[str] = []
        shown.on("console", lambda line: errors.append(line.text))
        shown.goto(broken.as_uri())
        shown.wait_for_timeout(300)
        assert shown.title() == "cart_pole: run"
        assert sum("Content Security Policy" in error for error in errors) == 3


@needs_chromium
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_is_readable_on_every_screen(failing: Path, scheme: str) -> None:
    page(failing)
    with chromium() as visit:
        shown = visit("about:blank", 400, 900)
        shown.emulate_media(color_scheme=scheme)
        shown.goto((failing / "report.html").as_uri())
        assert shown.evaluate("document.documentElement.scrollWidth") <= 400
        color, back = shown.evaluate(
            "[getComputedStyle(document.body).color, getComputedStyle(document.body).background]"
        )
        text, ground = (sum(map(int, re.findall(r"\d+", part)[:3])) for part in (color, back))
        assert text - ground > 400 if scheme == "dark" else ground - text > 400
        shown.emulate_media(media="print", color_scheme=scheme)
        back = shown.evaluate("getComputedStyle(document.body).background")
        assert back.startswith("rgb(255, 255, 255)")
