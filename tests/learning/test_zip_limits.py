"""Zips of policies and trainings unpack no further than a limit, checked before they are used."""

import copy
import io
import struct
import tracemalloc
import zipfile
import zlib

import numpy as np
import pytest
import torch

from embodichain.learning import SB3VecEnv, load_policy
from embodichain.learning.checkpoints.checkpoint import save_checkpoint, save_script
from embodichain.learning.checkpoints.plain_state import read_tree, write_tree
from embodichain.learning.sb3.algorithms import Algorithm
from embodichain.learning.sb3.training_state import load_parameters
from embodichain.utils.errors import ConfigError
from tests.learning.counting import CountingEnv

MB = 2**20
NOTE = {"algo": "ppo", "group": "policy", "task": "counting"}


@pytest.fixture(scope="module")
def model():
    arguments = {"policy": "MlpPolicy", "n_steps": 4, "batch_size": 8, "policy_kwargs": {}}
    return Algorithm("ppo", arguments).build(SB3VecEnv(CountingEnv([0, 3])), 0)


@pytest.fixture(scope="module")
def zeros():
    return bytes(128 * MB)


@pytest.fixture
def path(model, tmp_path):
    save_checkpoint(model, tmp_path / "final.zip", NOTE)
    return tmp_path / "final.zip"


def files_of(path):
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def write(path, files, packed=(), how=zipfile.ZIP_DEFLATED):
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in files.items():
            archive.writestr(name, data, how if name in packed else zipfile.ZIP_STORED)


def peak_of_refusal(function, match):
    """Most bytes that Python held until it refused."""
    tracemalloc.start()
    try:
        with pytest.raises(ConfigError, match=match):
            function()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("name", ["data", "policy.pth", "system_info.txt", "another"])
def test_a_file_of_a_policy_that_unpacks_too_far_is_refused(path, zeros, name):
    write(path, {**files_of(path), name: zeros}, packed=[name])
    assert path.stat().st_size < MB
    peak = peak_of_refusal(lambda: load_policy(path), f"{name} unpacks to more than {64 * MB}")
    assert peak < 80 * MB


@pytest.mark.parametrize("outer", [False, True], ids=["stored", "packed"])
def test_a_zip_of_weights_that_unpacks_too_far_is_refused(path, model, zeros, outer):
    inner = io.BytesIO()
    write(inner, {"archive/data/0": zeros}, packed=["archive/data/0"])
    files = {**files_of(path), "policy.pth": inner.getvalue()}
    write(path, files, packed=["policy.pth"] if outer else [])
    why = "archive/data/0 unpacks to more than"
    assert peak_of_refusal(lambda: load_policy(path), why) < 16 * MB
    assert peak_of_refusal(lambda: load_parameters(model, path), why) < 16 * MB


def test_a_size_that_is_not_the_announced_one_is_refused(path, zeros):
    """With the checksum of what is announced: readers stop there, after unpacking everything."""
    files = files_of(path)
    text = files["data"] + zeros
    write(path, {**files, "data": text}, packed=["data"])
    data = path.read_bytes()
    sizes = struct.pack("<I", len(text)), struct.pack("<I", len(files["data"]))
    sums = struct.pack("<I", zlib.crc32(text)), struct.pack("<I", zlib.crc32(files["data"]))
    path.write_bytes(data.replace(*sizes).replace(*sums))
    with zipfile.ZipFile(path) as archive:
        assert archive.read("data") == files["data"]  # nothing to see from outside
    assert peak_of_refusal(lambda: load_policy(path), "data unpacks to more than") < 16 * MB


def test_files_that_overlap_are_refused(path):
    with zipfile.ZipFile(path, "a") as archive:
        for number in range(100):
            again = copy.copy(archive.getinfo("policy.pth"))
            again.filename = f"x{number}.pth"
            archive.filelist.append(again)
        archive.writestr("last", b"")
    with pytest.raises(ConfigError, match="its files overlap"):
        load_policy(path)


def test_ways_to_pack_without_a_limit_are_refused(path):
    write(path, files_of(path), packed=["data"], how=zipfile.ZIP_LZMA)
    with pytest.raises(ConfigError, match="data is packed in a way that no policy is"):
        load_policy(path)


def test_a_policy_that_somebody_packed_is_read(path):
    before = load_policy(path)
    files = files_of(path)
    write(path, files, packed=files)
    observations = np.zeros((2, *before.model.observation_space.shape), np.float32)
    actions = [
        p.model.predict(observations, deterministic=True)[0] for p in (before, load_policy(path))
    ]
    assert (actions[0] == actions[1]).all()


@pytest.mark.parametrize("inside", [False, True], ids=["a file", "in a zip of rsl_rl"])
def test_torchscript_that_unpacks_too_far_is_refused(tmp_path, zeros, inside):
    stream = io.BytesIO()
    torch.jit.save(torch.jit.script(torch.nn.Linear(2, 2)), stream)
    files = files_of(stream)
    folder = next(iter(files)).partition("/")[0]
    packed = f"{folder}/extra/notes"
    write(stream, {**files, packed: zeros}, packed=[packed])
    path = tmp_path / ("final.zip" if inside else "policy.pt")
    if inside:
        save_script(stream.getvalue(), path, {**NOTE, "algo": "rsl_rl_ppo"})
    else:
        path.write_bytes(stream.getvalue())
    assert peak_of_refusal(lambda: load_policy(path), "notes unpacks to more than") < 16 * MB


def test_the_state_of_a_training_that_unpacks_too_far_is_refused(tmp_path, zeros):
    path = tmp_path / "final.state.npz"
    write_tree(path, {"step": 3})
    array = io.BytesIO()
    np.save(array, np.frombuffer(zeros, np.uint8))
    write(path, {**files_of(path), "a1.npy": array.getvalue()}, packed=["a1.npy"])
    assert peak_of_refusal(lambda: read_tree(path), "a1.npy unpacks to more than") < 16 * MB


def test_an_array_that_is_said_to_be_huge_is_refused(tmp_path):
    path = tmp_path / "final.state.npz"
    write_tree(path, {"step": 3})
    header = io.BytesIO()
    about = {"descr": "<f8", "fortran_order": False, "shape": (2**60,)}
    np.lib.format.write_array_header_1_0(header, about)
    write(path, {**files_of(path), "a1.npy": header.getvalue()})
    with pytest.raises(ConfigError, match="has no state of a training"):
        read_tree(path)
