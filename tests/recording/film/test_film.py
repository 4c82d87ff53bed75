"""Films of a log, read back by ffmpeg: how many pictures, how long, and what is in them."""

import imageio_ffmpeg
import numpy as np
import pytest

import embodichain.recording as recording
from embodichain.lab.sim.drawing.offscreen import OffscreenRenderer
from embodichain.lab.sim.drawing.views import Viewpoint
from embodichain.recording import RecordOptions
from embodichain.recording.film.filming import film_log
from embodichain.recording.film.frames import FilmCamera, frames
from embodichain.recording.format.log_error import LogError
from embodichain.recording.format.messages.schema import STEPS_TOPIC, message_class
from embodichain.recording.read.playback import Playback, Span
from embodichain.utils.errors import ConfigError
from tests.recording.rewrite import rewrite

pytestmark = pytest.mark.slow

SIZE = (96, 64)


def pictures(path):
    """What ffmpeg says of a film, and its pictures, (T, height, width, 3)."""
    reader = imageio_ffmpeg.read_frames(str(path))
    about = next(reader)
    width, height = about["size"]
    return about, np.array([np.frombuffer(f, np.uint8).reshape(height, width, 3) for f in reader])


@pytest.mark.parametrize(
    ("arguments", "count", "fps"),
    [
        ({}, 20, 50.0),  # a control step of 0.02 s
        ({"env": 2, "episode": 1}, 9, 50.0),
        ({"first": 3, "last": 12, "speed": 0.5}, 10, 25.0),
        ({"speed": 3.0}, 7, 50.0),  # every third step
        ({"every": 4}, 5, 12.5),
        ({"every": 2, "max_seconds": 0.13}, 3, 25.0),
        ({"env": 1, "first": 2, "last": 8, "max_seconds": 1000.0}, 7, 50.0),
    ],
    ids=str,
)
def test_a_picture_for_each_step(record, tmp_path, arguments, count, fps):
    out = tmp_path / "film.mp4"
    drawn = []
    film_log(record(), out, size=SIZE, progress=drawn.append, **arguments)
    about, shown = pictures(out)
    assert len(shown) == count == len(drawn)
    assert {filmed.total for filmed in drawn} == {count}
    assert about["fps"] == pytest.approx(fps)
    assert about["duration"] == pytest.approx(count / fps, abs=0.011)
    assert about["size"] == SIZE
    assert about["codec"] == "h264"
    assert [p.name for p in tmp_path.glob("*.mp4")] == ["film.mp4"]
    assert list(tmp_path.glob(".*")) == []


def test_it_shows_what_happened(record, tmp_path):
    path = record(steps=7)
    film_log(path, tmp_path / "a.mp4", env=0, size=(384, 256))
    film_log(path, tmp_path / "b.mp4", env=1, size=(384, 256))
    _, first = pictures(tmp_path / "a.mp4")
    _, second = pictures(tmp_path / "b.mp4")
    blue = first[0][..., 2] > 2 * first[0][..., 0].astype(int) + 30
    assert 20 < blue.sum() < 400  # the cube
    moved = np.abs(first[5].astype(int) - first[0]).max(axis=-1) > 8
    assert 20 < moved.sum() < 2000  # the arm, not the whole picture
    assert not np.array_equal(first[3], second[3])


@pytest.mark.parametrize("state", ["all", "keyframes"])
def test_frames_are_the_states_one_by_one(record, state):
    """Several control steps are drawn in one call, as each is drawn alone."""
    path = record(options=RecordOptions(state=state))
    near = Viewpoint.look_at((1.2, -1.0, 0.9), (0.2, 0.0, 0.3))
    with recording.open(path) as log:
        playback = Playback(log, 1)
        renderer = OffscreenRenderer(playback.engine.model)
        cameras = [FilmCamera(near, (64, 48)), FilmCamera(near, (32, 16))]
        found = list(frames(renderer, playback, cameras, Span(3, 17), 2))
        assert [frame.step for frame in found] == [3, 5, 7, 9, 11, 13, 15, 17]
        alone = Playback(log, 1)
        for step, frame in zip(alone.steps(Span(3, 17), 2), found, strict=True):
            assert step == frame.step
            for camera, picture in zip(cameras, frame.pictures, strict=True):
                expected = renderer.pictures(alone.engine, near, camera.size)[0]
                np.testing.assert_array_equal(picture, expected)
        renderer.close()
    assert not np.array_equal(found[0].pictures[0], found[-1].pictures[0])


def test_a_film_that_is_stopped_has_what_was_drawn(record, tmp_path):
    path, out = record(), tmp_path / "film.mp4"
    drawn = []
    film = film_log(path, out, size=SIZE, progress=drawn.append, stop=lambda: len(drawn) == 5)
    assert (film.pictures, film.step, film.whole, film.total) == (5, 4, False, 20)
    assert len(pictures(out)[1]) == 5
    none = film_log(path, tmp_path / "none.mp4", size=SIZE, stop=lambda: True)
    assert none.pictures == 0 and not (tmp_path / "none.mp4").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"env": 3}, "no environment 3 in the log: there are 0 to 2"),
        ({"episode": 7}, "no episode 7 of environment 0"),
        ({"first": 20}, "there is nothing to film"),
        ({"speed": 0.0}, "speed must be positive"),
        ({"size": (97, 64)}, "even"),
        ({"camera": "front"}, "no camera 'front'.* Cameras: none"),
    ],
    ids=str,
)
def test_wrong_questions_leave_no_file(record, tmp_path, arguments, message):
    folder = tmp_path / "films"
    folder.mkdir()
    with pytest.raises(ConfigError, match=message):
        film_log(record(), folder / "film.mp4", **{"size": SIZE, **arguments})
    assert list(folder.iterdir()) == []


def test_nothing_is_overwritten(record, tmp_path):
    out = tmp_path / "film.mp4"
    out.write_bytes(b"mine")
    with pytest.raises(ConfigError, match=r"film\.mp4 exists"):
        film_log(record(), out, size=SIZE)
    assert out.read_bytes() == b"mine"


def test_a_damaged_message_in_the_middle_leaves_no_file(many_chunks, tmp_path):
    def damage(topic, data):
        steps = topic == STEPS_TOPIC and message_class("Steps").FromString(data)
        return b"\xff\xff\xff" if steps and steps.first >= 6 else data

    bad = rewrite(many_chunks(), tmp_path / "bad.mcap", message=damage)
    before = sorted(tmp_path.iterdir())
    with recording.open(bad) as log, pytest.raises(LogError, match="a message is damaged"):
        film_log(log, tmp_path / "film.mp4", size=SIZE)
    assert sorted(tmp_path.iterdir()) == before
