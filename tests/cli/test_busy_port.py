"""A port that another program has: the message names the key, and nothing is left behind."""

import socket

import pytest

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("viewer", ["web", "foxglove"])
def test_a_busy_port_names_the_key(embodichain, tmp_path, viewer):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        words = ["run", "task=cart_pole", "num_envs=1", "episodes=1", f"viewer={viewer}"]
        done = embodichain(*words, f"viewer.port={port}", cwd=tmp_path)
    assert done.returncode == 2
    assert f"viewer.port: cannot listen on 127.0.0.1:{port}" in done.stderr
    assert "viewer.port=N is another" in done.stderr
    assert "--port" not in done.stderr
    assert not list(tmp_path.glob("outputs"))


@pytest.mark.parametrize(
    "words", [["replay", "last", "--view", "web"], ["view", "last", "--serve"]]
)
def test_where_the_port_is_a_flag_the_message_names_the_flag(embodichain, tmp_path, words):
    run = ["run", "task=cart_pole", "num_envs=1", "max_steps=2", "scene_png=false"]
    assert embodichain(*run, cwd=tmp_path).returncode == 0
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        done = embodichain(*words, "--port", str(port), cwd=tmp_path)
    assert done.returncode == 2
    assert f"error: --port: cannot listen on 127.0.0.1:{port}" in done.stderr
    assert "--port N is another" in done.stderr
    assert "viewer.port" not in done.stderr
