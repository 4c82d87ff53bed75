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
