"""The live server, seen by a WebSocket client of others and decoded by published messages."""

import base64
import io
import json
import socket
import struct
import threading
import time

import numpy as np
import pytest
import torch
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from mcap.reader import make_reader
from PIL import Image
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

import embodichain
from embodichain.lab.sim.drawing.offscreen import VARIABLE
from embodichain.recording import ImageOptions, McapRecorder
from embodichain.recording.format.options import RecordOptions
from embodichain.recording.viewers.foxglove import FoxgloveView
from embodichain.recording.viewers.foxglove_server import FoxgloveServer
from embodichain.recording.views import pictures
from embodichain.utils.errors import ConfigError
from tests.recording.scene import SmallEnv
from tests.recording.views.test_images import SCENE, WALL_PIXEL, nal_types, recorded

DECODERS = {
    "/tf": FrameTransforms, "/log": Log, "scene": SceneUpdate, "joint_states": JointStates,
    "foxglove.CameraCalibration": CameraCalibration, "foxglove.CompressedImage": CompressedImage,
    "foxglove.CompressedVideo": CompressedVideo, "foxglove.RawImage": RawImage,
}  # fmt: skip


class Client:
    """Speaks Foxglove's WebSocket protocol, as its published text says."""

    def __init__(self, server, **options):
        options = {"subprotocols": ["foxglove.sdk.v1"], "close_timeout": 0.1, **options}
        self.connection = connect(server.url, **options)
        self.channels, self.topics, self.server = {}, {}, None

    def __enter__(self):
        self.socket = self.connection.__enter__()
        return self

    def __exit__(self, *error):
        self.connection.__exit__(*error)

    def meet(self, count):
        """Wait until the server has introduced itself and this many channels."""
        while self.server is None or len(self.channels) < count:
            text = json.loads(self.socket.recv(timeout=10))
            if text["op"] == "serverInfo":
                self.server = text
            elif text["op"] == "advertise":
                self.channels |= {c["topic"]: c for c in text["channels"]}
        return self.channels

    def subscribe(self, *topics):
        wanted = []
        for topic in topics:
            number = len(self.topics) + 100
            self.topics[number] = topic
            wanted.append({"id": number, "channelId": self.channels[topic]["id"]})
        self.socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))

    def receive(self):
        """Topic, log time in ns and content of the next message; None if none comes."""
        while True:
            try:
                data = self.socket.recv(timeout=10)
            except TimeoutError:
                return None
            if isinstance(data, bytes) and data[0] == 1:
                number, time_ns = struct.unpack_from("<IQ", data, 1)
                topic = self.topics[number]
                names = topic, topic.rsplit("/", 1)[1], self.channels[topic]["schemaName"]
                kind = next((DECODERS[name] for name in names if name in DECODERS), None)
                return topic, time_ns, kind.FromString(data[13:]) if kind else data[13:]

    def until(self, topic):
        """The next message of a topic."""
        while True:
            message = self.receive()
            assert message is not None, f"nothing on {topic}"
            if message[0] == topic:
                return message


class Running:
    """An environment that steps on a thread of its own until it is told to stop."""

    def __init__(self, env):
        self.env, self.stop, self.steps = env, threading.Event(), 0
        self.thread = threading.Thread(target=self._run)

    def _run(self):
        while not self.stop.wait(0.002):
            self.env.step()
            self.steps += 1

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *error):
        self.stop.set()
        self.thread.join()
        self.env.close()


@pytest.fixture
def live():
    """A running environment and its view of environments 0 and 2."""
    env = SmallEnv(length=1000)
    geom = np.array([4 * env.sim.engine.model.geom("cube/geom").id])
    view = FoxgloveView(env, port=0, view_envs=[0, 2], fps=1000)
    env.add_observer(view)
    env.reset()
    env.sim.engine.write_model("geom_rgba", 0.75, np.array([2]), geom)  # before any subscription
    env.step()
    with Running(env) as running:
        yield running, view


def test_its_channels_are_those_of_the_file(live, tmp_path):
    env = SmallEnv()
    options = RecordOptions(view_envs=[0, 2])
    env.add_observer(McapRecorder(tmp_path / "log.mcap", env, options=options))
    env.reset()
    env.step()
    env.close()
    check_channels(live[1].server, tmp_path / "log.mcap")


def check_channels(server, path):
    """The server has the channels that a log has for people."""
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    in_file = {
        channel.topic: summary.schemas[channel.schema_id]
        for channel in summary.channels.values()
        if not channel.topic.startswith(("/sim/", "/episode", "/pictures"))  # for programs
    }
    with Client(server) as client:
        found = client.meet(len(in_file))
    assert client.server["capabilities"] == []  # clients cannot change anything
    assert set(found) == set(in_file)
    for topic, schema in in_file.items():
        channel = found[topic]
        assert (channel["encoding"], channel["schemaEncoding"]) == ("protobuf", "protobuf")
        assert channel["schemaName"] == schema.name
        assert base64.b64decode(channel["schema"]) == schema.data


def test_what_comes_is_the_state_of_the_simulation(live):
    running, view = live
    with Client(view.server) as client:
        client.meet(7)
        client.subscribe("/tf", "/env_2/joint_states")
        _, _, joints = client.until("/env_2/joint_states")
        _, time_ns, frames = client.until("/tf")
        assert [j.name for j in joints.joints] == ["arm/shoulder", "arm/elbow"]
        poses = {t.child_frame_id: t for t in frames.transforms}
        assert {"env_0", "env_2", "env_2/cube", "env_0/arm/fore"} <= set(poses)
        assert poses["env_2"].parent_frame_id == "world"
        assert poses["env_2"].translation.x > 1.0  # beside the others
        assert poses["env_2/cube"].timestamp.seconds == time_ns // 10**9
        later = client.until("/tf")[1]
        assert (later - time_ns) % 20_000_000 == 0 < later - time_ns  # the log's own clock


def test_a_scene_is_sent_to_every_subscriber(live):
    _, view = live
    for _ in range(2):
        with Client(view.server) as client:
            client.meet(7)
            client.subscribe("/env_2/scene", "/log")
            _, _, scene = client.until("/env_2/scene")
            entities = {e.id: e for e in scene.entities}
            assert {"env_2", "env_2/arm/upper", "env_2/cube", "env_2/goal"} <= set(entities)
            # It was painted before the subscription.
            assert entities["env_2/cube"].cubes[0].color.r == 0.75
            assert "move_goal" in client.until("/log")[2].message
    with Client(view.server) as first, Client(view.server) as second:
        first.meet(7)
        first.subscribe("/env_0/scene")
        assert first.until("/env_0/scene")[2].entities
        second.meet(7)
        second.subscribe("/env_0/scene")
        assert second.until("/env_0/scene")[2].entities


def test_no_message_is_made_without_a_subscription(monkeypatch):
    env = SmallEnv()
    view = FoxgloveView(env, port=0, fps=1e9)
    env.add_observer(view)
    made = []
    # Without a client nothing is sent: what would be made is seen here only.
    monkeypatch.setattr(view._views, "on_rows", lambda *rest: made.append(rest))
    env.reset()
    for _ in range(5):
        env.step()
    with Client(view.server) as client:
        client.meet(5)
        env.step()
        assert not made  # connected, but subscribed to nothing
        client.subscribe("/tf")
        _step_until(env, lambda: made)
    _step_until(env, lambda: not view.server.wanted)
    made.clear()
    env.step()
    assert not made
    env.close()


def _step_until(env, condition):
    end = time.monotonic() + 10
    while not condition() and time.monotonic() < end:
        env.step()
        time.sleep(0.01)
    assert condition()


def test_real_time_is_kept_while_anything_is_subscribed_to(monkeypatch):
    env = SmallEnv()
    env.step_dt = 1000.0  # seconds: far more than a step takes
    env.add_observer(view := FoxgloveView(env, port=0, realtime=True))
    slept = []
    # A step of 1000 s would be slept through.
    monkeypatch.setattr(time, "sleep", slept.append)
    env.reset()
    env.step()
    assert not slept
    with Client(view.server) as client:
        client.meet(5)
        client.subscribe("/tf")
        while not view.server.wanted:
            pass
        env.step()
        env.step()
        assert len(slept) == 2 and slept[0] == 0.0 and 900.0 < slept[1] <= 1000.0
    env.close()


def test_it_changes_nothing(live):
    running, view = live
    plain = SmallEnv(length=1000)
    plain.reset()
    geom = np.array([4 * plain.sim.engine.model.geom("cube/geom").id])
    plain.sim.engine.write_model("geom_rgba", 0.75, np.array([2]), geom)
    with Client(view.server) as client:
        client.meet(7)
        client.subscribe("/tf", "/env_0/scene", "/env_2/metrics")
        for _ in range(5):
            client.until("/env_2/metrics")
    running.stop.set()
    running.thread.join()
    for _ in range(running.steps + 1):
        plain.step()
    assert np.array_equal(plain.sim.engine.rows, running.env.sim.engine.rows)


def test_other_addresses_do_not_answer(live):
    port = live[1].server.port
    assert live[1].server.address == f"ws://127.0.0.1:{port}"
    with pytest.raises(OSError):
        socket.create_connection(("127.0.0.2", port), timeout=2)


def test_an_address_that_is_taken_and_an_environment_that_is_not_there(live):
    port = live[1].server.port
    with pytest.raises(ConfigError, match=rf"viewer.port: cannot listen on 127.0.0.1:{port}"):
        FoxgloveView(SmallEnv(), port=port)
    with pytest.raises(ConfigError, match="environments 0 to 2"):
        FoxgloveView(SmallEnv(), port=0, view_envs=[3])


def test_a_viewer_that_never_reads_costs_the_run_nothing_and_others_see_all():
    env = SmallEnv(length=1000)
    view = FoxgloveView(env, port=0, view_envs=[0, 2], fps=1e9)
    env.add_observer(view)
    env.reset()
    env.step()
    topics = "/tf", "/env_0/scene", "/env_0/joint_states", "/env_2/metrics"
    with Client(view.server, max_queue=1) as stuck, Client(view.server) as client:
        stuck.meet(7)
        stuck.subscribe(*topics)  # and reads nothing from now on
        client.meet(7)
        client.subscribe("/env_2/metrics")
        wanted = view.server.is_wanted
        _step_until(env, lambda: wanted("/env_2/metrics") and wanted("/tf"))
        big, waiting = bytes(1 << 19), 0
        for i in range(400):
            view.server.send(i, [("/tf", big)])  # 200 MB: returns each time, whoever reads
            waiting = max(waiting, *(one.outbox._bytes for one in view.server._clients))
        assert 16 << 20 < waiting <= (32 << 20) + (2 << 20)
        assert max(one.outbox.dropped for one in view.server._clients) > 100
        env.step()
        assert client.until("/env_2/metrics")
    env.close()


def test_what_is_no_request_is_answered_with_a_reason(live):
    _, view = live
    wrong = [
        ("no json", "not a request of the protocol"),
        ("[]", "not a request of the protocol"),
        ('{"op": "subscribe"}', "not a request of the protocol"),
        (b"\x01", "this server takes no messages"),
        ('{"op": "advertise", "channels": []}', "read-only"),
        ('{"op": "setParameters", "parameters": []}', "read-only"),
        ('{"op": "subscribe", "subscriptions": [{"id": 1, "channelId": 99}]}', "no such channel"),
        ('{"op": "unsubscribe", "subscriptionIds": [7]}', "no subscription 7"),
        ("[" * 100_000, "not a request of the protocol"),
    ]
    with Client(view.server) as client:
        client.meet(7)
        for message, why in wrong:
            client.socket.send(message)
            answer = json.loads(client.socket.recv(timeout=10))
            assert answer["op"] == "status" and why in answer["message"]
        client.subscribe("/tf")
        assert client.until("/tf")
        client.socket.send(json.dumps({"op": "unsubscribe", "subscriptionIds": [100]}))
        end = time.monotonic() + 10
        while view.server.wanted and time.monotonic() < end:
            time.sleep(0.01)
        assert not view.server.wanted


def test_both_names_of_the_protocol_are_spoken_and_no_other(live):
    _, view = live
    for name in ("foxglove.sdk.v1", "foxglove.websocket.v1"):
        with Client(view.server, subprotocols=[name]) as client:
            assert client.socket.subprotocol == name
            client.meet(7)
    with pytest.raises(InvalidStatus), Client(view.server, subprotocols=["graphql-ws"]):
        pass


def test_a_replay_that_starts_again_is_another_session():
    server = FoxgloveServer("127.0.0.1", 0)
    server.channel("/tf", "foxglove.FrameTransforms")
    with Client(server) as client:
        client.meet(1)
        first = client.server["sessionId"]
        server.channel("/later", "foxglove.Log")
        assert {"/tf", "/later"} == set(client.meet(2))
        server.restart()
        again = json.loads(client.socket.recv(timeout=10))
        assert again["op"] == "serverInfo" and again["sessionId"] != first
    server.close()
    server.close()
    server.send(0, [])
    server.channel("/after", "foxglove.Log")  # the run goes on without its viewers


# -- pictures of cameras ---------------------------------------------------------------------------


class WithCamera:
    """Two cart poles and a camera, shown live; `step` is a control step."""

    def __init__(self, images=None, **view):
        self.env = embodichain.make("cart_pole", 2, SCENE)
        self.view = FoxgloveView(self.env, port=0, images=images, fps=1e9, **view)
        self.env.add_observer(self.view)
        self.env.reset(seed=0)

    def step(self):
        self.env.step(torch.zeros(2, 1))

    def close(self):
        self.env.close()


CAMERA = "/env_1/camera/front"


@pytest.fixture(scope="module")
def log_with_pictures(tmp_path_factory):
    path = tmp_path_factory.mktemp("live") / "log.mcap"
    return recorded(path, ImageOptions(envs=[1], format="jpeg"), steps=1, view_envs=[1])


def test_camera_sensors_have_the_channels_of_a_log_with_pictures(log_with_pictures):
    env = WithCamera(view_envs=[1])
    env.step()
    check_channels(env.view.server, log_with_pictures)
    env.close()


def test_live_pictures_are_of_the_simulation():
    env = WithCamera(ImageOptions(envs=[1], format="png", rate=1e9), view_envs=[1])
    with Running(env), Client(env.view.server) as client:
        client.meet(9)
        client.subscribe("/tf", CAMERA + "/image", CAMERA + "/depth", CAMERA + "/calibration")
        _, time_ns, depth = client.until(CAMERA + "/depth")
        assert (depth.encoding, depth.width, depth.height) == ("16UC1", 64, 48)
        millimetres = np.frombuffer(depth.data, "<u2").reshape(48, 64)
        assert millimetres[WALL_PIXEL] == 3000  # the wall is 3 m away
        assert depth.timestamp.ToNanoseconds() == time_ns
        _, _, color = client.until(CAMERA + "/image")
        with Image.open(io.BytesIO(color.data)) as image:
            assert (image.format, image.size) == ("PNG", (64, 48))
        lens = client.until(CAMERA + "/calibration")[2]
        assert list(lens.K) == pytest.approx([60, 0, 29.5, 0, 70, 24.5, 0, 0, 1])
        frames = []
        while "env_1/camera/front" not in frames:
            frames = [frame.child_frame_id for frame in client.until("/tf")[2].transforms]
        assert {color.frame_id, depth.frame_id, lens.frame_id} == set(frames)


def test_pictures_are_drawn_only_for_their_subscribers(monkeypatch):
    opened = []
    renderer = pictures.OffscreenRenderer
    # A renderer that nobody needs shows only in time and memory.
    monkeypatch.setattr(
        pictures, "OffscreenRenderer", lambda model: opened.append(model) or renderer(model)
    )
    env = WithCamera(view_envs=[1])
    with Running(env), Client(env.view.server) as client:
        client.meet(9)
        client.subscribe("/tf", CAMERA + "/calibration")
        client.until(CAMERA + "/calibration")
        assert not opened  # its pose and its lens are no picture
        client.subscribe(CAMERA + "/image")
        assert client.until(CAMERA + "/image")[2].format == "jpeg"
        assert len(opened) == 1


def test_the_rate_bounds_pictures():
    env = WithCamera(ImageOptions(rate=1e-9))
    with Client(env.view.server) as client:
        env.step()
        client.meet(9)
        topic = "/env_0/camera/front/image"
        client.subscribe(topic, "/env_0/metrics")
        _step_until(env, lambda: env.view.server.is_wanted("/env_0/metrics"))
        for _ in range(20):
            env.step()
        found = []
        while found.count("/env_0/metrics") < 20:
            found.append(client.receive()[0])
    env.close()
    assert found.count(topic) == 1  # the one that every subscriber gets


def test_a_later_subscriber_of_a_video_begins_with_a_picture_that_needs_none_before():
    pytest.importorskip("av")
    env = WithCamera(ImageOptions(envs=[1], rate=1e9), view_envs=[1])
    server, topic = env.view.server, CAMERA + "/image"
    with Running(env), Client(server) as first:
        first.meet(9)
        first.subscribe(topic)
        kinds = [nal_types(first.until(topic)[2].data) for _ in range(5)]
        assert any(5 not in kind for kind in kinds)
        with Client(server) as second:
            second.meet(9)
            second.subscribe(topic)
            kinds = [nal_types(second.until(topic)[2].data) for _ in range(5)]
        assert any({7, 8, 5} <= set(kind) for kind in kinds)  # long before the next one is due


def test_a_run_goes_on_where_no_picture_can_be_drawn(monkeypatch, caplog):
    monkeypatch.setenv(VARIABLE, "rays")
    env = WithCamera(view_envs=[1])
    with Running(env), Client(env.view.server) as client:
        client.meet(9)
        client.subscribe("/tf", "/log", CAMERA + "/image")
        line = client.until("/log")[2]
        while line.level != Log.Level.ERROR:
            line = client.until("/log")[2]
        assert line.message.startswith("no pictures of cameras: ")
        assert "viewer: no pictures of cameras: " in caplog.text
        client.until("/tf")
