"""Commands are drawn where their numbers say, and stand in the metrics."""

import json
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from embodichain.lab.gym.envs.managers.term import CommandMarker, CommandTerm
from embodichain.recording import McapRecorder, inspect
from embodichain.recording.format.options import RecordOptions
from embodichain.recording.views.scene import ABOVE, AXIS_LENGTH, METRES_PER_SPEED
from tests.recording.scene import MODEL, SmallEnv


class Pose(CommandTerm):
    names = ("x", "y", "z", "qw", "qx", "qy", "qz")
    marker = CommandMarker("pose", MODEL.body("arm/fore").id)

    def __init__(self):
        self.values = np.tile([0.1, 0.2, 0.3, np.sqrt(0.5), 0, 0, np.sqrt(0.5)], (3, 1))
        self.values[:, 0] += np.arange(3)


class Velocity(CommandTerm):
    marker = CommandMarker("velocity", MODEL.body("cube").id)

    def __init__(self):
        self.values = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.8, -0.5]])


class Joints(CommandTerm):
    """Nothing that could be drawn."""

    def __init__(self):
        self.values = np.arange(6.0).reshape(3, 2)


@pytest.fixture
def path(tmp_path):
    env = SmallEnv()
    terms = {"grasp": Pose(), "walk": Velocity(), "home": Joints()}
    env.command_manager = SimpleNamespace(
        terms={name: SimpleNamespace(instance=term) for name, term in terms.items()}
    )
    options = RecordOptions(view_envs=[0, 2], view_hz=1000)
    env.add_observer(McapRecorder(tmp_path / "log.mcap", env, options=options))
    env.reset()
    env.step()
    env.step()
    env.close()
    return tmp_path / "log.mcap"


def decoded(path, topic):
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        return [content for *_, content in reader.iter_decoded_messages(topics=topic)]


def x_axis(pose):
    q, turned = pose.orientation, np.empty(3)
    mujoco.mju_rotVecQuat(turned, np.array([1.0, 0, 0]), np.array([q.w, q.x, q.y, q.z]))
    return turned


def test_a_commanded_pose_is_a_frame_on_its_body(path):
    entity = next(e for e in decoded(path, "/env_2/markers")[0].entities if "grasp" in e.id)
    assert (entity.id, entity.frame_id) == ("env_2/commands/grasp", "env_2/arm/fore")
    assert entity.frame_locked  # it moves with the body whose frame it is in
    assert len(entity.arrows) == 3
    for arrow, axis in zip(entity.arrows, np.eye(3), strict=True):
        p = arrow.pose.position
        assert (p.x, p.y, p.z) == pytest.approx((2.1, 0.2, 0.3))
        turned = [-axis[1], axis[0], axis[2]]  # a quarter turn about z
        assert x_axis(arrow.pose) == pytest.approx(turned, abs=1e-12)
        assert arrow.shaft_length + arrow.head_length == pytest.approx(AXIS_LENGTH)


def test_a_commanded_velocity_is_an_arrow_in_the_heading(path):
    frames = decoded(path, "/tf")
    messages = decoded(path, "/env_2/markers")
    assert len(messages) == len(frames)
    for message, tf in zip(messages, frames, strict=True):
        entity = next(e for e in message.entities if "walk" in e.id)
        assert (entity.frame_id, entity.frame_locked) == ("env_2", False)
        cube = next(t for t in tf.transforms if t.child_frame_id == "env_2/cube")
        left, turn = entity.arrows
        for arrow in (left, turn):
            p, t = arrow.pose.position, cube.translation
            assert (p.x, p.y, p.z) == pytest.approx((t.x, t.y, t.z + ABOVE))
        q, side = cube.rotation, np.empty(3)
        mujoco.mju_rotVecQuat(side, np.array([0.0, 1, 0]), np.array([q.w, q.x, q.y, q.z]))
        assert x_axis(left.pose) == pytest.approx(side, abs=1e-6)  # the cube lies flat
        assert left.shaft_length + left.head_length == pytest.approx(METRES_PER_SPEED * 0.8)
        assert x_axis(turn.pose) == pytest.approx([0, 0, -1], abs=1e-12)  # clockwise
    still = next(e for e in decoded(path, "/env_0/markers")[0].entities if "walk" in e.id)
    assert len(still.arrows) == 0


def test_commands_stand_in_the_metrics(path):
    last = decoded(path, "/env_2/metrics")[-1]
    assert (last.command_grasp_x, last.command_walk_1, last.command_home_1) == (2.1, 0.8, 5.0)


def test_the_layout_shows_them(path):
    layout = json.loads(path.with_name("foxglove_layout.json").read_text())
    shown = {"/env_0/scene", "/env_0/markers", "/env_2/scene", "/env_2/markers"}
    assert set(layout["configById"]["3D!scene"]["topics"]) == shown


def test_without_commands_there_is_no_channel(record):
    assert not [c for c in inspect(record(steps=1)).channels if "markers" in c.topic]
