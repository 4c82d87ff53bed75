"""`GifFile`: pictures, their durations, and what is left where writing stops."""

import importlib.util
import shutil
import subprocess

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
