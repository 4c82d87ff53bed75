"""`doctor` knows every optional package, and says whether it is there."""

import importlib.metadata as metadata
import json
import re
import tomllib
from dataclasses import replace
from pathlib import Path

import pytest

from embodichain.cli import main
from embodichain.cli.verbs.running.doctor import EXTRAS
from embodichain.lab.sim.drawing.renderer_register import RENDERERS

PYPROJECT = Path(__file__).parents[2] / "pyproject.toml"


def test_every_extra_of_the_package_is_listed_with_its_packages():
    found = tomllib.loads(PYPROJECT.read_text())["project"]["optional-dependencies"]

    def packages(extra):
        names = [re.match(r"([\w.-]+)(?:\[(.*)\])?", line).groups() for line in found[extra]]
        return {
            package
            for name, nested in names
            for package in (
                set().union(*map(packages, nested.split(","))) if name == "embodichain" else {name}
            )
        }

    own = {extra: packages(extra) for extra in found if extra not in ("dev", "docs", "export-log")}
    listed = {name: set(packages) for name, (_, *packages) in EXTRAS.items()}
    assert listed == own


def test_doctor_says_what_is_there_and_how_to_get_the_rest(capsys, monkeypatch):
    versions = metadata.version
    gilded = replace(RENDERERS["rays"], requires="gold-leaf>=2")
    # A register has no method to forget what a test adds, as nothing else asks.
    monkeypatch.setattr(RENDERERS, "_members", {**dict(RENDERERS.items()), "gilded": gilded})

    def without_three(name):
        if name in ("onnxruntime", "matplotlib", "mujoco-warp"):
            raise metadata.PackageNotFoundError(name)
        return versions(name)

    # An environment without these packages would have to be installed.
    monkeypatch.setattr(metadata, "version", without_three)
    assert main(["doctor", "--json"]) == 0
    checks = {check["part"]: check for check in json.loads(capsys.readouterr().out)["checks"]}
    assert set(EXTRAS) <= set(checks)
    assert "camera" not in checks["rendering"]["found"]  # a machine may lack OpenGL, no more
    assert checks["tensorboard"]["state"] == "ok" and checks["tensorboard"]["advice"] == ""
    assert checks["tensorboard"]["found"] == f"tensorboard {versions('tensorboard')}"
    assert checks["plot"]["state"] == "missing"
    assert checks["plot"]["advice"] == (
        "curves of trainings as PNG: pip install 'embodichain[plot]'"
    )
    # What needs an extra is what is registered with it, and so are packages of other packages.
    assert checks["gpu"]["advice"] == (
        "MuJoCo Warp: device=cuda, sim.engine=warp: pip install 'embodichain[gpu]'"
    )
    assert checks["gold-leaf"]["state"] == "missing"
    assert checks["gold-leaf"]["advice"] == (
        "EMBODICHAIN_RENDERER=gilded: pip install 'gold-leaf>=2'"
    )
    assert checks["export"]["found"] == (
        f"not installed: onnxruntime (there: onnx {versions('onnx')})"
    )


@pytest.mark.parametrize(
    ("variable", "value", "state", "found"),
    [
        ("EMBODICHAIN_RENDERER", "layered", "ok", "layered renderer: .*, OpenGL 4"),
        ("EMBODICHAIN_RENDERER", "classic", "ok", "classic renderer: .*, OpenGL [1-9]"),
        (
            "EMBODICHAIN_RENDERER",
            "layerd",
            "warn",
            "unknown renderer 'layerd'.*Did you mean",
        ),
        ("MUJOCO_GL", "disable", "warn", "no OpenGL: depth and masks are drawn with rays"),
    ],
)
def test_doctor_names_the_renderer(capsys, monkeypatch, variable, value, state, found):
    monkeypatch.setenv(variable, value)
    assert main(["doctor", "--json"]) == 0
    checks = {check["part"]: check for check in json.loads(capsys.readouterr().out)["checks"]}
    check = checks["rendering"]
    assert check["state"] == state and re.search(found, check["found"]), check
    assert ("apt-get install" in check["advice"]) == (state == "warn")
