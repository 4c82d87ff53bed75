"""`embodichain view`: how a log is opened, and that it opens."""

import json
import os
import re
import signal
import socket
import stat
import threading
import time

import pytest

from embodichain.cli import main
from embodichain.recording import McapRecorder
from embodichain.recording.format.options import RecordOptions
from embodichain.recording.read.recover import recover
from embodichain.recording.viewers import foxglove
from embodichain.recording.viewers.foxglove import FoxgloveServer, declare_channels, stream_log
from tests.recording.scene import SmallEnv
from tests.recording.viewers.test_foxglove import Client


@pytest.fixture
def log(tmp_path):
    env = SmallEnv(length=100)
    options = RecordOptions(view_envs=[1], view_hz=1000)
    env.add_observer(McapRecorder(tmp_path / "rollout.mcap", env, options=options))
    env.reset()
    for _ in range(10):
        env.step()
    env.close()
    return tmp_path / "rollout.mcap"


@pytest.fixture
def broken(log):
    data = log.read_bytes()
    log.write_bytes(data[: int(len(data) * 0.9)])
    return log


def test_two_lines_say_what_to_open(log, capsys):
    layout = log.with_name("foxglove_layout.json")
    expected = (
        f"Foxglove or Lichtblick: Open local file, {log}\n"
        f"then Layouts, Import from file, {layout}\n"
    )
    before = layout.read_bytes()
    assert main(["view", str(log)]) == 0
    assert capsys.readouterr() == (expected, "")
    layout.unlink()  # a log that was copied without it
    assert main(["view", str(log.parent), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {
        "file": str(log), "layout": str(layout), "complete": True,
    }  # fmt: skip
    assert layout.read_bytes() == before


def test_of_a_broken_log_it_says_how_to_save_it(broken, capsys):
    assert main(["view", str(broken)]) == 0
    out, err = capsys.readouterr()
    saved = broken.with_name("rollout_saved.mcap")
    assert out.startswith(f"embodichain recover {broken} {saved}, and Open local file, {saved}")
    assert "warning" in err and "incomplete" in err
    recover(broken, saved)
    assert main(["view", str(saved)]) == 0
    assert capsys.readouterr().out.startswith("Foxglove or Lichtblick: Open local file, ")


def test_the_desktop_is_asked_to_open_it(log, tmp_path, monkeypatch, capsys):
    folder = tmp_path / "bin"
    folder.mkdir()
    monkeypatch.setenv("PATH", str(folder))
    assert main(["view", str(log), "--open"]) == 2
    assert "no xdg-open here" in capsys.readouterr().err
    program = folder / "xdg-open"
    program.write_text(f'#!/bin/sh\necho "$1" > {tmp_path}/asked\n')
    program.chmod(program.stat().st_mode | stat.S_IEXEC)
    assert main(["view", str(log), "--open"]) == 0
    assert (tmp_path / "asked").read_text().strip() == str(log)


@pytest.mark.parametrize("name", ["log", "broken"])
def test_it_is_played_to_who_looks_and_again(name, request):
    path = request.getfixturevalue(name)
    server, stop = FoxgloveServer("127.0.0.1", 0), threading.Event()
    topics = declare_channels(path, server)
    assert "/sim/steps" not in topics and {"/tf", "/env_1/scene", "/env_1/metrics"} <= set(topics)
    player = threading.Thread(target=stream_log, args=(path, server, stop.is_set), daemon=True)
    player.start()
    try:
        for _ in range(2):  # a later subscriber is sent the scene as well
            with Client(server) as client:
                client.meet(len(topics))
                client.subscribe("/tf", "/env_1/scene")
                assert client.until("/env_1/scene")[2].entities
                times = [client.until("/tf")[1] for _ in range(3)]
                assert times == sorted(set(times))
    finally:
        stop.set()
        player.join()
        server.close()


def test_the_verb_serves_until_it_is_interrupted(log, capsys, monkeypatch):
    def interrupted(path, server, stopped, speed):
        assert (path, speed) == (log, 2.0)
        with Client(server) as client:
            client.meet(5)
        os.kill(os.getpid(), signal.SIGINT)
        while not stopped():
            time.sleep(0.01)

    # A server that is stopped at once; its own tests have clients.
    monkeypatch.setattr(foxglove, "stream_log", interrupted)
    assert main(["view", str(log), "--serve", "--port", "0", "--speed", "2"]) == 0
    assert "playing it at ws://127.0.0.1:" in capsys.readouterr().out


def test_the_verb_says_who_may_connect(log, capsys, monkeypatch):
    def tried(path, server, stopped, speed):
        with Client(server, origin="http://lichtblick.example") as client:
            client.meet(5)

    # The server ends with the log: a client has to come while it is streamed.
    monkeypatch.setattr(foxglove, "stream_log", tried)
    words = ["view", str(log), "--serve", "--port", "0"]
    origin = ["--allow-origin", "http://lichtblick.example"]
    assert main([*words, *origin, "--token", "of-mine"]) == 0
    assert re.search(r"ws://127.0.0.1:\d+/\?token=of-mine: Open", capsys.readouterr().out)
    assert main([*words, *origin, "--token", "none"]) == 0
    assert "token" not in capsys.readouterr().out
    assert main([*words, "--token", "none", "--host", "0.0.0.0"]) == 2
    assert "viewer.token: none is for an address that only this" in capsys.readouterr().err


def test_wrong_words_are_refused(log, capsys):
    assert main(["view", str(log), "--serve", "--speed", "0"]) == 2
    assert main(["view", str(log.with_name("none.mcap"))]) == 2
    assert "does not exist" in capsys.readouterr().err


def test_a_run_says_where_it_is_shown(capsys):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    short = ("task=random_reach", "num_envs=2", "max_steps=3", "record=none", "viewer=foxglove")
    short += ("viewer.wait_s=0",)
    assert main(["run", *short, f"viewer.port={port}", "viewer.env=1"]) == 0
    said = capsys.readouterr().err
    assert re.search(rf"viewer: ws://127.0.0.1:{port}/\?token=\S+ \(Foxglove, Lichtblick: ", said)
    assert main(["run", *short, f"viewer.port={port}", "viewer.host=0.0.0.0"]) == 0
    assert (
        f"warning: other machines reach the viewer at 0.0.0.0:{port}; who has its token can watch "
        "the run. Nothing is encrypted; HTTPS needs a proxy\n"
    ) in capsys.readouterr().err
    with socket.create_server(("127.0.0.1", port)):
        assert main(["run", *short, f"viewer.port={port}"]) == 2
    assert f"viewer.port: cannot listen on 127.0.0.1:{port}" in capsys.readouterr().err
