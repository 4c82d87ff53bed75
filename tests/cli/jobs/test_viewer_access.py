"""`viewer.token`: what is allowed, and that no record of a run has it."""

import dataclasses
import re
from pathlib import Path

import pytest
import yaml

from embodichain.cli import main
from embodichain.config.rerun import resolve_run
from embodichain.config.resolved import resolve, thaw

pytestmark = pytest.mark.slow

TASK = ("task=random_reach", "num_envs=2", "max_steps=3", "scene_png=false")
TOKEN = "hush-9b1c77"


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["viewer.token=none", "viewer.host=0.0.0.0"], "viewer.token: none is for an address that"),
        (["viewer.token=none", "viewer.host='::'"], "viewer.token: none is for an address that"),
        (["viewer.token=None"], "Did you mean 'none'?"),
        (["viewer.token=''"], "printable ASCII characters without blanks"),
        (["viewer.token='two words'"], "printable ASCII characters without blanks"),
        (["viewer.token=null"], "viewer.token: expected text, got null"),
        (["viewer.allow_origins=['*']"], "viewer.allow_origins.0: expected a site with its scheme"),
        (["viewer.allow_origins=[app.foxglove.dev]"], "expected a site with its scheme"),
        (["viewer.allow_origins=['https://a.example/x']"], "without a path"),
        (["viewer.allow_origins=['null']"], "expected a site with its scheme"),
        (["viewer.allow_hosts=['https://a.example']"], "viewer.allow_hosts.0: expected a name"),
        (["viewer.allow_hosts=['*.example']"], "viewer.allow_hosts.0: expected a name"),
    ],
)
@pytest.mark.parametrize("viewer", ["web", "foxglove"])
def test_what_is_wrong_is_named_before_anything_is_served(words, why, viewer, capsys):
    assert main(["validate", *TASK, f"viewer={viewer}", *words]) == 2
    assert why in capsys.readouterr().err


@pytest.mark.parametrize("host", ["127.0.0.1", "127.0.0.2", "localhost", "'::1'"])
def test_none_is_taken_where_only_this_machine_connects(host):
    found = resolve([*TASK, "viewer=web", "viewer.token=none", f"viewer.host={host}"])
    assert found.access.token == "none"


def files_with(folder: Path, text: str) -> list[str]:
    """Names of the files below a folder that have a text."""
    files = [path for path in folder.rglob("*") if path.is_file()]
    return [path.name for path in files if text.encode() in path.read_bytes()]


def the_run(folder: Path) -> Path:
    """The only run in a folder of outputs."""
    (config,) = folder.rglob("config.yaml")
    return config.parent


@pytest.mark.parametrize("viewer", ["web", "foxglove"])
def test_a_given_token_is_in_no_record(viewer, embodichain, tmp_path):
    words = ["run", *TASK, f"viewer={viewer}", "viewer.wait_s=0", "record.compression=none"]
    done = embodichain(*words, f"viewer.token={TOKEN}", cwd=tmp_path)
    assert done.returncode == 0
    assert f"?token={TOKEN}" in done.stderr
    assert files_with(tmp_path, TOKEN) == []
    folder = the_run(tmp_path)
    assert yaml.safe_load((folder / "config.yaml").read_text())["viewer"]["token"] == "<token>"
    assert "viewer.token='<token>'" in yaml.safe_load((folder / "overrides.yaml").read_text())
    again = resolve_run(folder)  # the text is no token itself: another one is drawn
    assert again.access.token == "auto"
    again = resolve_run(folder, [f"viewer.token={TOKEN}"])
    assert again.access.token == TOKEN
    assert TOKEN not in repr(again) and TOKEN not in str(thaw(again.tree))


def test_a_training_that_is_resumed_draws_a_token(embodichain, tmp_path):
    words = ["train", "task=cart_pole", "algo.n_steps=8", "algo.batch_size=8", "viewer=web"]
    words += ["num_envs=2", "eval.episodes=0"]
    done = embodichain(*words, "total_timesteps=16", f"viewer.token={TOKEN}", cwd=tmp_path)
    assert done.returncode == 0 and f"?token={TOKEN}\n" in done.stderr, done.stderr
    done = embodichain("train", "resume=last", "total_timesteps=32", cwd=tmp_path)
    assert done.returncode == 0 and re.search(r"\?token=\S{43}\n", done.stderr), done.stderr
    assert files_with(tmp_path, TOKEN) == []


def test_however_overrides_get_into_a_config_the_token_is_not_among_them():
    found = resolve([*TASK, "viewer=web", f"+viewer.token={TOKEN}"])
    assert found.overrides[-1] == "+viewer.token='<token>'"
    again = dataclasses.replace(found, overrides=(f"viewer.token={TOKEN}", "seed=1"))
    assert again.overrides == ("viewer.token='<token>'", "seed=1")
    assert again.changed(seed=2).access.token == TOKEN


@pytest.mark.parametrize("viewer", ["web", "foxglove"])
def test_a_drawn_token_is_printed_and_in_no_record(viewer, embodichain, tmp_path):
    words = ["run", *TASK, f"viewer={viewer}", "viewer.wait_s=0", "record.compression=none"]
    words += ["--quiet"]
    done = embodichain(*words, cwd=tmp_path)
    token = re.search(r"viewer: \S+\?token=(\S{43})", done.stderr)  # or nobody could open it
    assert token is not None
    assert files_with(tmp_path, token[1]) == []
    assert re.search(r"viewer: \S+", (the_run(tmp_path) / "run.log").read_text())


def test_the_seed_does_not_draw_the_token(capsys):
    words = ["run", *TASK, "record=none", "viewer=foxglove", "viewer.port=18765", "seed=7"]
    words += ["viewer.wait_s=0"]
    found = []
    for _ in range(2):
        assert main(words) == 0
        found += re.findall(r"token=(\S+)", capsys.readouterr().err)
    assert len(set(found)) == 2


def test_a_token_of_the_environment_is_written_as_its_name(embodichain, tmp_path):
    words = ["run", *TASK, "viewer=web", "viewer.wait_s=0", "viewer.token=${oc.env:MY_TOKEN}"]
    done = embodichain(*words, cwd=tmp_path, env={"MY_TOKEN": TOKEN})
    assert f"?token={TOKEN}" in done.stderr
    assert files_with(tmp_path, TOKEN) == []
    overrides = yaml.safe_load((the_run(tmp_path) / "overrides.yaml").read_text())
    assert "viewer.token=${oc.env:MY_TOKEN}" in overrides


def test_a_sweep_takes_no_token_that_it_would_write(capsys):
    words = ["run", "-m", *TASK, "seed=1,2", "viewer=web", f"viewer.token={TOKEN}"]
    assert main(words) == 2
    err = capsys.readouterr().err
    assert "viewer.token: a sweep would write it to multirun.yaml" in err
    assert TOKEN not in err
