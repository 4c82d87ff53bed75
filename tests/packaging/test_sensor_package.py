"""A package outside adds the sensor of docs/extending.md with one file, installed as a wheel."""

import json
import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

PAGE = (Path(__file__).parents[2] / "docs" / "extending.md").read_text(encoding="utf-8")
SECTION = PAGE.partition("\n## A sensor\n")[2].partition("\n## ")[0]
SENSOR = "{sensor_type: altimeter, of: {uid: robot, link_names: [ee_link]}, level: 0.5}"
PROJECT = """\
[build-system]
requires = ["setuptools"]
build-backend = "setuptools.build_meta"

[project]
name = "altimeter"
version = "1.0"

[tool.setuptools]
py-modules = ["altimeter"]
"""
TRY = """
import json, sys
import numpy as np
from embodichain.config import resolve
from embodichain.config.resolved import build_env, compile_scene_of
from embodichain.lab.sim.sensors import SENSORS

overrides = ["task=reach", "num_envs=2", "seed=1", f"+task.sensors.tool={sys.argv[1]}"]
term = "{func: sensor_reading, params: {sensor: tool, reading: height}}"
resolved = resolve([*overrides, f"+task.observations.height={term}"])
torch_is_loaded = "torch" in sys.modules
env = build_env(resolved, compile_scene_of(resolved))
env.reset()
env.step(env.action_space.sample())
sensor = env.sensors["tool"]
expected = sensor.frames.positions(env.sim.engine)[..., 2].reshape(2, 1) - 0.5
print(json.dumps({
    "place": SENSORS.place("altimeter"),
    "torch": torch_is_loaded,
    "data": sensor.get_data()["height"].tolist(),
    "expected": expected.tolist(),
    "columns": env.observation_manager.columns("policy")["height"],
}))
"""


def documented(language: str, marker: str) -> str:
    found = re.search(rf"{marker}```{language}\n(.*?)^```", SECTION, re.MULTILINE | re.DOTALL)
    assert found is not None
    return found[1]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the package, built as a wheel from the page's file and installed."""
    project = tmp_path_factory.mktemp("altimeter")
    module = documented("python", "<!-- altimeter.py -->\n")
    (project / "altimeter.py").write_text(module, encoding="utf-8")
    points = documented("toml", r"")
    (project / "pyproject.toml").write_text(f"{PROJECT}\n{points}", encoding="utf-8")
    build = "from setuptools.build_meta import build_wheel; build_wheel('dist')"
    subprocess.run([sys.executable, "-c", build], cwd=project, check=True, capture_output=True)
    (wheel,) = (project / "dist").glob("*.whl")
    installed = tmp_path_factory.mktemp("site")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(installed)
    return installed


def run(site: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    path = os.pathsep.join([str(site), os.environ.get("PYTHONPATH", "")]).rstrip(os.pathsep)
    return subprocess.run(
        [sys.executable, *arguments],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": path},
    )


def test_a_sensor_of_a_package_is_declared_measured_and_observed(site: Path) -> None:
    done = run(site, "-c", TRY, SENSOR)
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout.splitlines()[-1])
    assert result["place"] == "altimeter:Altimeter"
    assert result["torch"] is False
    assert result["columns"] == 1
    for height, expected in zip(result["data"], result["expected"], strict=True):
        assert height == pytest.approx(expected, abs=1e-6)


def test_mistakes_in_a_sensor_of_a_package_are_answered_as_ours(site: Path) -> None:
    wrong = "{sensor_type: altimeter, of: {uid: ur11}, lvel: 1, level: inf}"
    done = run(site, "-m", "embodichain", "validate", "task=reach", f"+task.sensors.tool={wrong}")
    assert done.returncode == 2
    allowed = "sensor_type, uid, of, observe, rate, level"
    assert f"task.sensors.tool.lvel: unknown key; allowed: {allowed}." in done.stderr
    assert "Did you mean 'level'?" in done.stderr
    assert "task.sensors.tool.level: must be finite, metres, got inf" in done.stderr
    assert "task.sensors.tool.of.uid: no entity is called 'ur11'" in done.stderr


def test_without_the_package_its_type_is_unknown() -> None:
    sensor = f"+task.sensors.tool={SENSOR}"
    arguments = [sys.executable, "-m", "embodichain", "validate", "task=reach", sensor]
    done = subprocess.run(arguments, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "unknown sensor 'altimeter'; one of: camera, stereo_camera, contact" in done.stderr


def test_a_broken_package_is_named_where_its_type_is_missing(tmp_path: Path) -> None:
    info = tmp_path / "altimeter-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: altimeter\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[embodichain.sensors]\naltimeter = altimeter\n")
    (tmp_path / "altimeter.py").write_text("raise RuntimeError('no licence')\n")
    task = ("validate", "task=reach", f"+task.sensors.tool={SENSOR}")
    done = run(tmp_path, "-m", "embodichain", *task)
    assert done.returncode == 2
    reason = "the sensor types of 'altimeter' (entry point 'altimeter' of altimeter) could not be "
    assert f"Besides, {reason}loaded: RuntimeError: no licence." in done.stderr
    good = run(tmp_path, "-m", "embodichain", "validate", "task=quadruped_velocity")
    assert good.returncode == 0, good.stderr
