"""`replay --video` and `export --format mp4`, as they are typed."""

import json

import pytest

from embodichain.cli.app import call
from embodichain.utils.errors import ConfigError
from tests.recording.film.test_film import pictures


def test_a_film_of_an_episode(record, tmp_path, capsys):
    path, out = record(), tmp_path / "film.mp4"
    part = ["--env", "2", "--episode", "1", "--from", "10", "--to", "16"]
    how = ["--size", "96x64", "--speed", "0.5"]
    assert call(["replay", str(path), "--video", str(out), *part, *how]) == 0
    assert capsys.readouterr().out == f"{out}: 6 pictures, 0.00 MB\n"
    about, frames = pictures(out)
    assert len(frames) == 6
    assert (about["size"], about["fps"]) == ((96, 64), 25.0)


def test_a_film_of_a_cut_log_warns(record, tmp_path, capsys):
    whole = record(steps=150, num_envs=64)
    cut, out = tmp_path / "cut.mcap", tmp_path / "film.mp4"
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size * 2 // 3])
    options = ["--video", str(out), "--size", "32x32", "--speed", "30", "--json"]
    assert call(["replay", str(cut), *options]) == 0
    streams = capsys.readouterr()
    assert "incomplete" in streams.err
    assert 0 < json.loads(streams.out)["pictures"] == len(pictures(out)[1]) < 15


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--size", "32x32"], "--size needs --video"),
        (["--speed", "2"], "--speed needs --video"),
        (["--port", "0"], "--port needs --view"),
        (["--video", "a.mp4", "--verify"], "--verify and --video exclude each other"),
        (["--video", "a.mp4", "--size", "32"], "--size is WIDTHxHEIGHT"),
    ],
    ids=str,
)
def test_options_that_do_not_go_together(record, options, message):
    with pytest.raises(ConfigError, match=message):
        call(["replay", str(record()), *options])


def test_mp4_is_a_format_to_export(record, tmp_path, capsys):
    out = tmp_path / "a.mp4"
    options = ["--format", "mp4", "-o", str(out), "--env", "1", "--episode", "2", "--from", "17"]
    assert call(["export", str(record()), *options]) == 0
    about, frames = pictures(out)
    assert len(frames) == 3  # environment 1 has episodes of 8 steps: the third is cut after 4
    assert about["size"] == (640, 480)
