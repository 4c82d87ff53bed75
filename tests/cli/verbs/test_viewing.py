"""`viewer=web` on the command line: where the page is, what is warned of, what is refused."""

import json
import socket

import pytest

from embodichain.cli import main

SHORT = ("task=random_reach", "num_envs=2", "max_steps=3", "record=none", "viewer.wait_s=0")


def test_a_run_says_where_its_page_is(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", *SHORT, "viewer=web", "viewer.env=1"]) == 0
    assert "\nviewer: http://127.0.0.1:80" in capsys.readouterr().err


def test_json_is_json_and_other_addresses_are_warned_of(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["run", *SHORT, "viewer=web", "viewer.host=0.0.0.0", "--json"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["status"] == "max_steps"
    port = err.partition("viewer at 0.0.0.0:")[2].partition(";")[0]
    assert int(port) >= 8080
    assert (
        f"warning: other machines reach the viewer at 0.0.0.0:{port}; who has its token can watch "
        "the run and use its controls. Nothing is encrypted; HTTPS needs a proxy\n"
    ) in err


def test_a_port_that_is_taken_is_the_users_mistake(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert main(["run", *SHORT, "viewer=web", f"viewer.port={port}"]) == 2
    err = capsys.readouterr().err
    assert f"viewer.port: cannot listen on 127.0.0.1:{port}: Port {port} is already in use" in err


def test_teleoperation_is_validated_without_an_operator(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["validate", "task=pick_place", "policy=teleop", "viewer=web"]) == 0
    assert main(["validate", "task=reach", "policy=teleop", "viewer=web"]) == 2
    assert "teleop moves a tool" in capsys.readouterr().err
