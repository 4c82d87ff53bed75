"""What is refused while a job is built prints the refusal alone: there is no folder."""

import socket
from pathlib import Path

import pytest

from embodichain.cli import main

pytestmark = pytest.mark.slow

TASK = ["task=cart_pole", "max_steps=2", "scene_png=false", "record=none"]


def test_a_refusal_has_no_folder(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        words = [*TASK, "viewer=web", f"viewer.port={port}", "viewer.wait_s=0"]
        assert main(["run", *words]) == 2
    err = capsys.readouterr().err
    assert err.startswith("error: ")
    assert f"viewer.port: cannot listen on 127.0.0.1:{port}" in err
    assert "cart_pole: " not in err
    assert not list(Path().iterdir())


@pytest.mark.parametrize("words", [(), ("viewer=web", "viewer.wait_s=0")])
def test_a_job_that_begins_names_its_folder_once_and_first(
    words: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", *TASK, *words]) == 0
    err = capsys.readouterr().err
    assert err.startswith("cart_pole: outputs/")
    assert err.count("cart_pole: outputs/") == 1


def test_a_job_that_fails_names_the_folder_that_stays(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    Path("broken.py").write_text("def act(obs, env):\n    raise KeyError('lost')\n")
    monkeypatch.syspath_prepend(Path().resolve())
    assert main(["run", *TASK, "policy=broken:act"]) == 1
    err = capsys.readouterr().err
    (log,) = Path("outputs").rglob("run.log")
    assert err.count("cart_pole: outputs/") == 1
    assert "KeyError" in log.read_text()
