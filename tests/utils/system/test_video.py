"""`GifFile`: pictures, their durations, and what is left where writing stops."""

import importlib.util
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from embodichain.utils.errors import ConfigError
from embodichain.utils.system.video import GifFile, VideoFile, film_file, need_encoder

SIZE = (24, 16)


def plain(red: int) -> np.ndarray:
    return np.full((16, 24, 3), (red, 40, 90), np.uint8)


def ramp() -> np.ndarray:
    """(16, 24, 3) all levels of red that the other pictures have."""
    red = np.linspace(0, 255, 24).astype(np.uint8)
    return np.stack([np.tile(red, (16, 1)), *np.full((2, 16, 24), 60, np.uint8)], axis=-1)


def test_a_gif_has_the_pictures_for_as_long_as_they_last(tmp_path):
    path = tmp_path / "new" / "film.gif"
    with film_file(path, SIZE, 30.0) as film:
        assert isinstance(film, GifFile)
        for red in range(0, 180, 30):
            film.write(ramp() if red == 0 else np.roll(ramp(), red, axis=1))
        assert not path.exists()
    with Image.open(path) as gif:
        assert (gif.n_frames, gif.size, gif.info["loop"]) == (6, SIZE, 0)
        seconds = 0.0
        for k in range(gif.n_frames):
            gif.seek(k)
            seconds += gif.info["duration"] / 1000
            expected = np.roll(ramp(), 30 * k, axis=1).astype(int)
            assert np.abs(np.asarray(gif.convert("RGB")).astype(int) - expected).max() < 12
    assert seconds == pytest.approx(6 / 30, abs=0.005)  # 30, 40, 30 ms, ...
    assert [p.name for p in path.parent.iterdir()] == ["film.gif"]


def arm_in_front_of_a_wall(frame: int) -> np.ndarray:
    """(480, 640, 3) a picture of many browns and greys, and a small red square that moves."""
    picture = np.empty((480, 640, 3), np.uint8)
    across = np.linspace(0.0, 1.0, 640)
    down = np.linspace(0.0, 1.0, 480)[:, None]
    picture[..., 0] = 110 + 90 * across
    picture[..., 1] = 80 + 90 * down
    picture[..., 2] = 70 + 60 * across * down
    left = 300 + 10 * frame
    picture[230:252, left : left + 22] = RED
    return picture


RED = (217, 76, 25)


def read_with_ffmpeg(path: Path) -> np.ndarray:
    """(frames, 480, 640, 3) the pictures of a film."""
    ffmpeg = pytest.importorskip("imageio_ffmpeg").get_ffmpeg_exe()
    command = [ffmpeg, "-v", "error", "-i", path, "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    raw = subprocess.run(command, stdout=subprocess.PIPE, check=True).stdout
    return np.frombuffer(raw, np.uint8).reshape(-1, 480, 640, 3)


def test_what_is_small_and_red_in_a_gif_is_red(tmp_path):
    """With one palette by number of pixels, it was brown."""
    path = tmp_path / "film.gif"
    with film_file(path, (640, 480), 25.0) as film:
        for frame in range(5):
            film.write(arm_in_front_of_a_wall(frame))
    for frame, shown in enumerate(read_with_ffmpeg(path)):
        expected = arm_in_front_of_a_wall(frame).astype(int)
        is_red = (expected == RED).all(axis=2)
        assert is_red.sum() == 22 * 22
        assert np.abs(shown[is_red].astype(int) - RED).max(axis=1).mean() < 4
        # Dithered: of 8 x 8 pixels, the mean is closer than the pixels are.
        error = shown - expected
        of_blocks = error.reshape(60, 8, 80, 8, 3).mean(axis=(1, 3))
        assert np.abs(of_blocks).mean() < 0.6 * np.abs(error).mean() < 3


def test_each_picture_of_a_gif_has_its_palette(tmp_path):
    path = tmp_path / "film.gif"
    with film_file(path, (640, 480), 25.0) as film:
        for frame in range(5):
            film.write(np.roll(arm_in_front_of_a_wall(0), 40 * frame, axis=(1, 2)))
    shown = read_with_ffmpeg(path)
    assert len(shown) == 5
    for picture in shown:
        assert 200 <= len(np.unique(picture.reshape(-1, 3), axis=0)) <= 256
    with Image.open(path) as gif:
        assert gif.size == (640, 480)
        assert gif.global_palette is None
    assert path.stat().st_size < 900_000


def test_few_and_dark_colours_are_no_holes(tmp_path):
    """What a picture does not draw is transparent; black is drawn."""
    path = tmp_path / "film.gif"
    levels = (200, 3, 0, 90, 0)
    with film_file(path, (640, 480), 25.0) as film:
        for level in levels:
            film.write(np.full((480, 640, 3), level, np.uint8))
    for picture, level in zip(read_with_ffmpeg(path), levels, strict=True):
        assert (picture == level).all()


def test_what_does_not_move_costs_nothing(tmp_path):
    sizes = []
    for frames in (1, 11):
        path = tmp_path / f"film_{frames}.gif"
        with film_file(path, (640, 480), 25.0) as film:
            for _ in range(frames):
                film.write(arm_in_front_of_a_wall(3))
        sizes.append(path.stat().st_size)
    assert sizes[1] - sizes[0] < 10 * 1000


def test_no_file_is_replaced_and_nothing_is_left_of_one_that_failed(tmp_path):
    path = tmp_path / "film.gif"
    path.write_bytes(b"mine")
    with film_file(path, SIZE, 10.0) as film:
        film.write(plain(3))
    assert path.read_bytes() == b"mine" and (tmp_path / "film_2.gif").stat().st_size > 20
    with pytest.raises(ValueError, match="mine"), film_file(tmp_path / "b.gif", SIZE, 10.0) as film:
        film.write(plain(3))
        raise ValueError("mine")
    assert sorted(p.name for p in tmp_path.glob("*.*")) == ["film.gif", "film_2.gif"]


def test_only_an_mp4_needs_the_encoder(tmp_path, monkeypatch):
    assert isinstance(film := film_file(tmp_path / "film.mp4", SIZE, 10.0), VideoFile)
    film.discard()
    # As if the extra were not installed.
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    need_encoder(".gif")
    with pytest.raises(ConfigError, match=r"imageio-ffmpeg.*embodichain\[video\]"):
        need_encoder()


@pytest.mark.parametrize("size", [(64, 48), (1280, 720)])
def test_an_mp4_names_its_colours(tmp_path, size):
    """Unnamed, players take BT.709 from 720 lines on; here as in videos of logs."""
    av = pytest.importorskip("av")
    width, height = size
    colours = [(220, 30, 40), (20, 200, 60), (30, 40, 230)]
    picture = np.zeros((height, width, 3), np.uint8)
    for number, colour in enumerate(colours):
        picture[:, number * width // 3 :] = colour
    with VideoFile(tmp_path / "film.mp4", size, 25) as film:
        for _ in range(3):
            film.write(picture)
    with av.open(str(tmp_path / "film.mp4")) as opened:
        stream = opened.streams.video[0].codec_context
        # ITU-T H.273: BT.709 primaries, the curve of sRGB, the matrix of BT.601, limited range.
        tags = stream.color_primaries, stream.color_trc, stream.colorspace, stream.color_range
        assert tuple(map(int, tags)) == (1, 13, 6, 1)
        shown = next(opened.decode(video=0)).to_ndarray(format="rgb24")
    for number, colour in enumerate(colours):
        found = shown[height // 2, (2 * number + 1) * width // 6]
        assert np.abs(found.astype(int) - colour).max() <= 3
    import imageio_ffmpeg

    told = subprocess.run(
        [imageio_ffmpeg.get_ffmpeg_exe(), "-i", tmp_path / "film.mp4"],
        capture_output=True,
        text=True,
        check=False,
    ).stderr
    assert "yuv420p(tv, smpte170m/bt709/iec61966-2-1" in told


def test_a_film_whose_encoder_fails_is_an_error_and_no_film(tmp_path, capfd):
    """The encoder opens its file at the first picture: here the folder is gone by then."""
    pytest.importorskip("imageio_ffmpeg")
    path = tmp_path / "gone/film.mp4"
    film = VideoFile(path, (64, 48), 25)
    shutil.rmtree(path.parent)
    with pytest.raises(OSError, match="the encoder ended with code") as raised, film:
        for _ in range(3):
            film.write(np.zeros((48, 64, 3), np.uint8))
    assert raised.value.filename == str(path)
    assert "No such file or directory" in str(raised.value)
    assert capfd.readouterr().err == ""
    assert not path.parent.exists()
