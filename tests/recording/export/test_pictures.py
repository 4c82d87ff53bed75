"""Pictures of camera sensors in exports, drawn from the states of a log."""

import io
import json

import h5py
import imageio_ffmpeg
import numpy as np
import pytest
import torch
from PIL import Image

import embodichain
import embodichain.recording as recording
from embodichain.cli.app import main
from embodichain.recording import McapRecorder
from embodichain.recording.export import Part, export
from embodichain.utils.errors import ConfigError

pytestmark = pytest.mark.slow

CAMERA = (
    "+task.sensors.front={sensor_type: camera, width: 64, height: 48, fovy: 45, "
    "extrinsics: {eye: [0, -3, 1.5], target: [0, 0, 1.2]}, observe: true}"
)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A log of two cart poles, and the pictures that were observed before each step."""
    path, seen = tmp_path_factory.mktemp("pictures") / "log.mcap", []
    env = embodichain.make("cart_pole", 2, [CAMERA])
    env.add_observer(McapRecorder(path, env, f"task: {{sensors: {{{SENSOR}}}}}"))
    obs, _ = env.reset(seed=0)
    for step in range(8):
        seen.append(obs["sensor"]["front"]["color"][..., :3].numpy().copy())
        obs, *_ = env.step(torch.full((2, 1), 0.5 - 0.1 * step))
    env.close()
    with recording.open(path) as log:
        yield log, np.array(seen)


SENSOR = CAMERA.removeprefix("+task.sensors.").replace("=", ": ", 1)


def test_hdf5_has_the_pictures_that_were_observed(recorded, tmp_path):
    log, seen = recorded
    with h5py.File(export(log, "hdf5", tmp_path / "demos.hdf5")) as file:
        for env in range(2):
            found = file[f"data/demo_{env}/obs/front_image"][:]
            assert np.array_equal(found, seen[:, env])


def test_cameras_and_size_can_be_chosen(recorded, tmp_path):
    log, _ = recorded
    part = Part(env=1, start=2, stop=5, cameras=("default", "front"), size=(40, 30))
    with h5py.File(export(log, "hdf5", tmp_path / "demos.hdf5", part)) as file:
        obs = file["data/demo_0/obs"]
        assert obs["default_image"].shape == obs["front_image"].shape == (3, 30, 40, 3)
        assert obs["default_image"][:].std() > 5


def test_lerobot_has_them_as_videos(recorded, tmp_path):
    log, seen = recorded
    root = export(log, "lerobot", tmp_path / "set")
    info = json.loads((root / "meta/info.json").read_text())
    key = "observation.images.front"
    assert info["features"][key]["shape"] == [48, 64, 3]
    for env in range(2):
        name = info["video_path"].format(video_key=key, chunk_index=0, file_index=env)
        meta, *pictures = imageio_ffmpeg.read_frames(str(root / name))
        assert meta["size"] == (64, 48)
        found = np.array([np.frombuffer(p, np.uint8).reshape(48, 64, 3) for p in pictures])
        assert np.abs(found.astype(int) - seen[:, env]).mean() < 6


def test_rerun_has_them_as_jpeg_in_the_scene(recorded, tmp_path):
    reader = pytest.importorskip("rerun.chunk").RrdReader
    log, seen = recorded
    path, found = export(log, "rrd", tmp_path / "log.rrd", Part(env=1)), {}
    for chunk in reader(path).stream():
        if chunk.entity_path == "/world/env_1/camera/front":
            batch = chunk.to_record_batch()
            for name in (name for name in batch.schema.names if ":" in name):
                values = batch.column(name).to_pylist()
                rows = zip(batch.column("step").to_pylist(), values, strict=True)
                found.setdefault(name, {}).update(rows)
    assert sorted(found["EncodedImage:blob"]) == [0, 2, 4, 6]  # 25 a second
    for step, (blob,) in found["EncodedImage:blob"].items():
        with Image.open(io.BytesIO(bytes(blob))) as image:
            assert np.abs(np.asarray(image).astype(int) - seen[step, 1]).mean() < 6
        # The target of the camera is in the middle of the picture, which looks along -z.
        columns = np.array(found["Transform3D:mat3x3"][step][0]).reshape(3, 3)
        eye = np.array(found["Transform3D:translation"][step][0])
        assert np.allclose(eye, [0, -3, 1.5])
        assert np.allclose(columns[2], (eye - [0, 0, 1.2]) / np.hypot(3, 0.3), atol=1e-6)
        lens = np.array(found["Pinhole:image_from_camera"][step][0]).reshape(3, 3).T
        focal = 24 / np.tan(np.radians(22.5))
        assert np.allclose(lens, [[focal, 0, 32], [0, focal, 24], [0, 0, 1]])
        assert found["Pinhole:resolution"][step] == [[64, 48]]


def test_the_command_draws_any_camera_at_any_size(recorded, tmp_path, capsys):
    log, _ = recorded
    film = tmp_path / "film.mp4"
    size = ["--camera", "front", "--size", "80x60"]
    assert main(["export", str(log.path), "--format", "mp4", "-o", str(film), *size]) == 0
    meta, *pictures = imageio_ffmpeg.read_frames(str(film))
    assert (meta["size"], len(pictures)) == ((80, 60), 8)
    assert main(["export", str(log.path), "--format", "csv", "--camera", "front"]) == 2
    assert "csv has no pictures; formats with cameras: hdf5, lerobot" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("format", "part", "message"),
    [
        ("hdf5", Part(cameras=("frnt",)), "no camera 'frnt'.*'front'"),
        ("lerobot", Part(size=(63, 48)), "videos need an even width and height; front has 63x48"),
        ("mp4", Part(cameras=("front", "default")), "a film has one camera, not front, default"),
    ],
)
def test_wrong_cameras_are_refused(recorded, tmp_path, format, part, message):
    with pytest.raises(ConfigError, match=message):
        export(recorded[0], format, tmp_path / f"out.{format}", part)
    assert not [path for path in tmp_path.iterdir() if path.is_file() or "out" in path.name]
