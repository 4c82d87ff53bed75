"""On a terminal whose encoding lacks a character, text degrades and nothing fails."""

import os
import pty
import re
import subprocess
import sys

import pytest

pytestmark = pytest.mark.slow

ASCII = {"PYTHONIOENCODING": "ascii"}
C_LOCALE = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
RUN = ("run", "task=cart_pole", "num_envs=2", "episodes=1", "record=none")
SHORT = ("task.max_episode_steps=20", "scene_png=false")


@pytest.mark.parametrize("env", [ASCII, C_LOCALE, {**ASCII, "LC_ALL": "C"}])
def test_a_finished_run_ends_with_0(embodichain, tmp_path, env):
    done = embodichain(*RUN, *SHORT, cwd=tmp_path, env=env)
    assert done.returncode == 0, done.stderr
    assert re.search(r"return .* \+- \d", done.stdout)
    assert done.stdout.isascii() and done.stderr.isascii()


def test_words_of_the_user_degrade(embodichain, tmp_path):
    folder = tmp_path / "conf" / "task"
    folder.mkdir(parents=True)
    text = 'defaults: [cart_pole]\ndescription: "Größe ≤ 1 µm → Ziel 立"\n'
    (folder / "wagen.yaml").write_text(text, encoding="utf-8")
    words = ["show", "--config-dir=conf", "task=wagen", "--config"]
    shown = embodichain(*words, cwd=tmp_path, env=ASCII)
    assert shown.returncode == 0, shown.stderr
    assert "Gr\\xf6\\xdfe <= 1 um -> Ziel \\u7acb" in shown.stdout
    wrong = embodichain("run", "task=größe", cwd=tmp_path, env=ASCII)
    assert wrong.returncode == 2
    assert "gr\\xf6\\xdfe" in wrong.stderr


@pytest.mark.parametrize("words", [RUN, ("report", "last"), ("run", "task=größe")])
def test_letters_that_are_no_text_are_refused_before_anything_is_made(embodichain, tmp_path, words):
    """Without UTF-8 at all, a path's letters cannot be written into a run's files."""
    cwd = tmp_path / ("plain" if "task=größe" in words else "grün")
    cwd.mkdir(exist_ok=True)
    done = embodichain(*words, cwd=cwd, env=C_LOCALE)
    assert done.returncode == 2
    assert done.stderr.endswith(" is not text in ascii: set LC_ALL=C.UTF-8, or PYTHONUTF8=1\n")
    assert list(cwd.iterdir()) == []
    assert embodichain("list", "--help", cwd=cwd, env=C_LOCALE).returncode == 0


def test_bars_and_curves_of_a_training_degrade(tmp_path):
    """In a pseudo terminal, where rich draws."""
    words = ["train", "task=cart_pole", "num_envs=2", "total_timesteps=256", "record=none"]
    words += ["eval.episodes=2", "task.max_episode_steps=20", "algo.n_steps=32"]
    parent, child = pty.openpty()
    running = subprocess.Popen(
        [sys.executable, "-m", "embodichain", *words],
        cwd=tmp_path,
        env={**os.environ, **ASCII, "TERM": "xterm", "COLUMNS": "120"},
        stdin=subprocess.DEVNULL,
        stdout=child,
        stderr=child,
    )
    os.close(child)
    shown = b""
    with os.fdopen(parent, "rb", buffering=0) as screen:
        while True:
            try:
                part = screen.read(4096)
            except OSError:  # Linux: the other end was closed
                break
            if not part:
                break
            shown += part
    assert running.wait(60) == 0, shown.decode()
    assert shown.isascii()
    assert b"steps/s" in shown and b"Error" not in shown
