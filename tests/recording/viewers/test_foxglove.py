"""The live server, seen by a WebSocket client of others and decoded by published messages."""

import base64
import json
import socket
import struct
import threading
import time

import numpy as np
import pytest
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from mcap.reader import make_reader
from websockets.sync.client import connect

from embodichain.recording import McapRecorder
from embodichain.recording.options import RecordOptions
from embodichain.recording.viewers.foxglove import FoxgloveView
from embodichain.utils.errors import ConfigError
from tests.recording.scene import SmallEnv

DECODERS = {
    "/tf": FrameTransforms, "/log": Log, "scene": SceneUpdate, "joint_states": JointStates,
}  # fmt: skip


class Client:
    """Speaks Foxglove's WebSocket protocol, as its published text says."""

    def __init__(self, port):
        self.connection = connect(
            f"ws://127.0.0.1:{port}", subprotocols=["foxglove.sdk.v1"], close_timeout=0.1
        )
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
                kind = DECODERS.get(topic) or DECODERS.get(topic.rsplit("/", 1)[1])
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
    with (tmp_path / "log.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    in_file = {
        channel.topic: summary.schemas[channel.schema_id]
        for channel in summary.channels.values()
        if not channel.topic.startswith(("/sim/", "/episode"))  # for programs
    }
    with Client(live[1].server.port) as client:
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
    with Client(view.server.port) as client:
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
        with Client(view.server.port) as client:
            client.meet(7)
            client.subscribe("/env_2/scene", "/log")
            _, _, scene = client.until("/env_2/scene")
            entities = {e.id: e for e in scene.entities}
            assert {"env_2", "env_2/arm/upper", "env_2/cube", "env_2/goal"} <= set(entities)
            # It was painted before the subscription.
            assert entities["env_2/cube"].cubes[0].color.r == 0.75
            assert "move_goal" in client.until("/log")[2].message
    with Client(view.server.port) as first, Client(view.server.port) as second:
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
    monkeypatch.setattr(view._views, "on_rows", lambda *rest: made.append(rest))
    env.reset()
    for _ in range(5):
        env.step()
    with Client(view.server.port) as client:
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
    env.add_observer(view := FoxgloveView(env, port=0, realtime=True))
    slept = []
    monkeypatch.setattr(time, "sleep", slept.append)
    env.reset()
    env.step()
    assert not slept
    with Client(view.server.port) as client:
        client.meet(5)
        client.subscribe("/tf")
        while not view.server.wanted:
            pass
        env.step()
        env.step()
        assert len(slept) == 2 and slept[0] == 0.0 < slept[1] <= 0.02
    env.close()


def test_it_changes_nothing(live):
    running, view = live
    plain = SmallEnv(length=1000)
    plain.reset()
    geom = np.array([4 * plain.sim.engine.model.geom("cube/geom").id])
    plain.sim.engine.write_model("geom_rgba", 0.75, np.array([2]), geom)
    with Client(view.server.port) as client:
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
    assert live[1].server.url == f"ws://127.0.0.1:{port}"
    with pytest.raises(OSError):
        socket.create_connection(("127.0.0.2", port), timeout=2)


def test_an_address_that_is_taken_and_an_environment_that_is_not_there(live):
    port = live[1].server.port
    with pytest.raises(ConfigError, match=rf"viewer.port: cannot listen on 127.0.0.1:{port}"):
        FoxgloveView(SmallEnv(), port=port)
    with pytest.raises(ConfigError, match="environments 0 to 2"):
        FoxgloveView(SmallEnv(), port=0, view_envs=[3])


def test_without_the_package_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "foxglove", None)
    with pytest.raises(ConfigError, match=r"pip install 'embodichain\[foxglove\]'"):
        FoxgloveView(SmallEnv(), port=0)
