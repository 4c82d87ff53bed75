"""Pictures in a log: `record.images`."""

import io
import json
import math
import subprocess

import numpy as np
import pytest
import torch
from PIL import Image

import embodichain
from embodichain.cli.app import main
from embodichain.recording import ImageOptions, McapRecorder, RecordOptions, diff, inspect, verify
from embodichain.utils.errors import ConfigError
from tests.recording.read.test_api import decoded

CAMERA = (
    "+task.sensors.front={sensor_type: camera, width: 64, height: 48, intrinsics: [60, 70, 30, 25],"
    " extrinsics: {eye: [0, -3, 1.2], target: [0, 0, 1.2]}, data_types: [color, depth, mask]}"
)
WALL = (
    "+task.objects.wall={shape: {shape_type: Cube, size: [1, 0.2, 1]}, body_type: static, "
    "init_pos: [0.6, 0.1, 1.2]}"
)
"""The camera looks along y; the wall's front is 3 m away, from 0.1 to 1.1 m right of the axis."""
IMAGE = "/env_1/camera/front/image"
SCENE = [CAMERA, WALL, "task.max_episode_steps=25"]


def recorded(path, options, steps=40, num_envs=2, **record):
    """A log of cart poles that are not pushed."""
    env = embodichain.make("cart_pole", num_envs, SCENE)
    record = RecordOptions(images=options, **record)
    env.add_observer(log := McapRecorder(path, env, options=record))
    env.reset(seed=0)
    for step in range(steps):
        env.step(torch.zeros(num_envs, 1))
        if step % 10 == 9:
            log.flush()  # so that the size of files does not depend on the time that steps take
    env.close()
    return path


def steps_of(found, path):
    start = found[0].timestamp.ToNanoseconds()
    return [(m.timestamp.ToNanoseconds() - start) // 20_000_000 for m in found]


def nal_types(data):
    """Types of the units of an Annex B stream."""
    units = data.replace(b"\0\0\0\1", b"\0\0\1").split(b"\0\0\1")[1:]
    return [unit[0] & 31 for unit in units]


@pytest.fixture(scope="module")
def video(tmp_path_factory):
    path = tmp_path_factory.mktemp("images") / "log.mcap"
    return recorded(path, ImageOptions(envs=[1], rate=10), view_envs=[0, 1])


def test_a_video_has_a_picture_in_each_message(video):
    av = pytest.importorskip("av")
    found = decoded(video, IMAGE)
    # 10 Hz is every fifth step of 20 ms; and after the reset in step 25
    assert steps_of(found, video) == [0, 5, 10, 15, 20, 25, 30, 35]
    assert {(m.format, m.frame_id) for m in found} == {("h264", "env_1/camera/front")}
    for number, message in enumerate(found):
        pictures = [kind for kind in nal_types(message.data) if kind in (1, 5)]
        assert len(set(pictures)) == 1
        if number == 0:
            assert {7, 8, 5} <= set(nal_types(message.data))  # parameter sets and an IDR picture
    decoder = av.CodecContext.create("h264", "r")
    decoder.thread_count = 1
    assert [len(decoder.decode(av.Packet(message.data))) for message in found] == [1] * len(found)


def test_another_program_decodes_the_video(video, tmp_path):
    still = recorded(tmp_path / "still.mcap", ImageOptions(envs=[1], rate=10, format="png"))
    exact = [np.asarray(Image.open(io.BytesIO(m.data))) for m in decoded(still, IMAGE)]
    pictures = decode_with_ffmpeg(decoded(video, IMAGE))
    error = np.abs(pictures.astype(int) - np.array(exact).astype(int)).mean(axis=(1, 2, 3))
    assert exact[0].shape == (48, 64, 3)
    assert (error < 6).all()


def test_a_video_names_its_colors(video):
    av = pytest.importorskip("av")
    decoder = av.CodecContext.create("h264", "r")
    decoder.thread_count = 1
    (frame,) = decoder.decode(av.Packet(decoded(video, IMAGE)[0].data))
    # H.264, table E-5 and E-3: SMPTE 170M, BT.709's primaries, sRGB; 16 to 235
    assert (frame.colorspace, frame.color_range) == (6, 1)
    assert (frame.color_primaries, frame.color_trc) == (1, 13)


def decode_with_ffmpeg(found):
    """(pictures, H, W, 3) by another program."""
    ffmpeg = pytest.importorskip("imageio_ffmpeg").get_ffmpeg_exe()
    command = [
        ffmpeg,
        "-v",
        "error",
        "-f",
        "h264",
        "-i",
        "-",
        "-f",
        "rawvideo",
        "-fps_mode",
        "passthrough",
    ]
    done = subprocess.run(
        [*command, "-pix_fmt", "rgb24", "-"],
        input=b"".join(m.data for m in found),
        capture_output=True,
        check=True,
    )
    pictures = np.frombuffer(done.stdout, np.uint8).reshape(-1, 48, 64, 3)
    assert len(pictures) == len(found)
    return pictures


WALL_PIXEL = 20, 42
"""Row and column of a point of the wall: 60 / 3 pixels a metre right of column 30."""


def test_depth_and_mask_are_numbers(video):
    depth, mask = (decoded(video, f"/env_1/camera/front/{name}")[0] for name in ("depth", "mask"))
    assert (depth.encoding, depth.width, depth.height, depth.step) == ("16UC1", 64, 48, 128)
    metres = np.frombuffer(depth.data, "<u2").reshape(48, 64) / 1000
    assert metres[WALL_PIXEL] == pytest.approx(3.0, abs=1e-3)
    env = embodichain.make("cart_pole", 1, SCENE)
    body = env.sim.engine.model.body("wall").id
    env.close()
    found = np.frombuffer(mask.data, "<u2").reshape(48, 64)
    assert found[WALL_PIXEL] == body
    columns = np.flatnonzero(found[WALL_PIXEL[0]] == body)
    assert (columns[0], columns[-1]) == (32, 51)  # 30 + 20 x 0.1 to 30 + 20 x 1.1


def test_the_camera_has_its_lens_and_its_frame(video):
    calibration = decoded(video, "/env_1/camera/front/calibration")[0]
    # The config's [60, 70, 30, 25] is from the corner; OpenCV's pixels have their middles there.
    assert list(calibration.K) == pytest.approx([60, 0, 29.5, 0, 70, 24.5, 0, 0, 1])
    assert list(calibration.P) == pytest.approx([60, 0, 29.5, 0, 0, 70, 24.5, 0, 0, 0, 1, 0])
    assert (calibration.width, calibration.height) == (64, 48)
    frames = [f for m in decoded(video, "/tf") for f in m.transforms]
    frame = next(f for f in frames if f.child_frame_id == "env_1/camera/front")
    assert frame.parent_frame_id == "env_1"
    at, turned = frame.translation, frame.rotation
    assert (at.x, at.y, at.z) == pytest.approx((0, -3, 1.2))
    # z forward is the environment's y, y down is -z: a quarter turn about -x
    half = math.sqrt(0.5)
    assert (turned.w, turned.x, turned.y, turned.z) == pytest.approx((half, -half, 0, 0), abs=1e-6)


def test_the_layout_shows_them(video):
    layout = json.loads(video.with_name("foxglove_layout.json").read_text())
    panel = layout["configById"]["Image!0"]["imageMode"]
    topics = {channel.topic for channel in inspect(video).channels}
    assert panel["imageTopic"] == IMAGE
    assert panel["calibrationTopic"] in topics
    scene = layout["configById"]["3D!scene"]["topics"]
    assert {IMAGE, panel["calibrationTopic"]} <= scene.keys() <= topics
    left = layout["layout"]["first"]
    assert (left["first"], left["second"]) == ("3D!scene", "Image!0")


def test_pictures_change_nothing_else(video, tmp_path):
    assert verify(video).ok
    plain = recorded(tmp_path / "plain.mcap", None)
    assert diff(plain, video).same


def test_cameras_of_the_scene_and_any_size(tmp_path):
    options = ImageOptions(["default"], format="jpeg", size=(80, 60), rate=1000)
    path = recorded(tmp_path / "log.mcap", options, steps=3)
    found = decoded(path, "/env_0/camera/default/image")
    assert len(found) == 3  # at most one a control step
    with Image.open(io.BytesIO(found[0].data)) as image:
        assert (image.format, image.size) == ("JPEG", (80, 60))


def test_each_file_of_a_log_begins_with_a_picture_that_needs_none_before(tmp_path):
    pytest.importorskip("av")
    recorded(tmp_path / "log.mcap", ImageOptions(rate=50), steps=150, max_mb=0.01)
    files = sorted(tmp_path.glob("log*.mcap"))
    assert len(files) > 1
    for file in files:
        first = decoded(file, "/env_0/camera/front/image")[0]
        assert {7, 8, 5} <= set(nal_types(first.data))


def test_a_video_may_have_a_picture_in_an_hour(tmp_path):
    pytest.importorskip("av")
    path = recorded(tmp_path / "log.mcap", ImageOptions(rate=1 / 3600), steps=2)
    assert len(decoded(path, "/env_0/camera/front/image")) == 1


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (ImageOptions(["frnt"]), "record.images.cameras.0: no camera 'frnt'. .*mean 'front'"),
        (ImageOptions(size=(63, 48)), "record.images.size: h264 needs even widths and heights"),
        (ImageOptions(format="gif"), "record.images.format: 'gif' is not one of h264, jpeg, png"),
        (ImageOptions(envs=[7]), r"record.images.envs: \[7\]: there are environments 0 to 1"),
        (ImageOptions(rate=0), "record.images.rate: 0 must be positive"),
        (ImageOptions(size=(0, 48)), r"record.images.size: \[0, 48\] must be from 1 to"),
    ],
)
def test_wrong_options_are_named(tmp_path, options, message):
    with pytest.raises(ConfigError, match=message):
        recorded(tmp_path / "log.mcap", options)


def test_without_camera_sensors_cameras_must_be_named(tmp_path):
    env = embodichain.make("cart_pole", 1)
    options = RecordOptions(images=ImageOptions())
    with pytest.raises(ConfigError, match="the task has no camera sensors: name cameras"):
        McapRecorder(tmp_path / "log.mcap", env, options=options)


def test_a_run_records_them(tmp_path, capsys):
    images = "record.images={cameras: [default], format: jpeg, size: [64, 48]}"
    keys = ["task=cart_pole", "num_envs=1", "max_steps=6", "scene_png=false", images]
    assert main(["run", *keys, f"hydra.run.dir={tmp_path / 'run'}", "-q"]) == 0
    (path,) = tmp_path.glob("**/rollout.mcap")
    assert len(decoded(path, "/env_0/camera/default/image")) == 2
    assert main(["run", *keys, "record.images.format=gif"]) == 2
    assert "record.images.format" in capsys.readouterr().err


HALL = """<mujoco><worldbody>
  <geom type="box" size=".3 .3 .3" pos="0 0 .3" rgba=".8 .2 .2 1"/>
  <camera name="door" pos="0 -3 1" xyaxes="1 0 0 0 .3 1" resolution="64 48"/>
</worldbody></mujoco>"""
TWO = """
description: One camera of a file in two sizes.
scene: {fpath: hall.xml}
max_episode_steps: 4
sensors:
  fine: {sensor_type: camera, camera: scene/door, width: 160, height: 120, data_types: [color]}
  coarse: {sensor_type: camera, camera: scene/door, width: 40, height: 30, data_types: [color]}
"""


def test_sensors_of_one_camera_have_pictures_of_their_own(tmp_path, monkeypatch):
    import h5py

    import embodichain.recording as recording
    from embodichain.recording.export import Part, export

    (tmp_path / "conf/task").mkdir(parents=True)
    (tmp_path / "hall.xml").write_text(HALL)
    (tmp_path / "conf/task/hall.yaml").write_text(TWO)
    monkeypatch.chdir(tmp_path)
    keys = ["task=hall", "policy=zero", "episodes=1", "num_envs=1", "scene_png=false", "-q"]
    for name, cameras in (("all", "null"), ("one", "[fine]")):
        images = f"record.images={{cameras: {cameras}, format: jpeg}}"
        assert main(["run", *keys, images, f"hydra.run.dir={tmp_path / name}"]) == 0
    sizes = {"fine": (160, 120), "coarse": (40, 30)}
    for run, names in (("all", ["fine", "coarse"]), ("one", ["fine"])):
        topics = {channel.topic for channel in inspect(tmp_path / run / "rollout.mcap").channels}
        images = {topic for topic in topics if topic.endswith("/image")}
        assert images == {f"/env_0/camera/{name}/image" for name in names}
        for name in names:
            found = decoded(tmp_path / run / "rollout.mcap", f"/env_0/camera/{name}/image")
            with Image.open(io.BytesIO(found[0].data)) as image:
                assert image.size == sizes[name]
    with recording.open(tmp_path / "all/rollout.mcap") as log:
        with h5py.File(export(log, "hdf5", tmp_path / "all.hdf5")) as file:
            shapes = {key: v.shape[1:3] for key, v in file["data/demo_0/obs"].items()}
            assert {k: v for k, v in shapes.items() if "image" in k} == {
                "fine_image": (120, 160),
                "coarse_image": (30, 40),
            }
        features = json.loads(
            (export(log, "lerobot", tmp_path / "set") / "meta/info.json").read_text()
        )["features"]
        assert features["observation.images.fine"]["shape"] == [120, 160, 3]
        assert features["observation.images.coarse"]["shape"] == [30, 40, 3]
        with pytest.raises(ConfigError, match=r"no camera 'fin'\. Did you mean 'fine'"):
            export(log, "mp4", tmp_path / "x.mp4", Part(cameras=("fin",)))
        assert export(log, "mp4", tmp_path / "x.mp4", Part(cameras=("fine",))).exists()
