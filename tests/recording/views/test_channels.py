"""The channels for viewers, decoded by mcap-protobuf-support from the schemas in the file."""

import json
import re
from types import SimpleNamespace

import foxglove_schemas_protobuf as published
import mujoco
import numpy as np
import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

import embodichain.recording as recording
from embodichain.recording import McapRecorder, inspect
from embodichain.recording.format.options import RecordOptions
from embodichain.recording.views.layout import foxglove_layout
from embodichain.recording.views.shapes import glb, mesh_of
from tests.recording.scene import MODEL, SmallEnv

VIEW = RecordOptions(view_envs=(0, 2), view_hz=1000)  # every control step


def decoded(path, topic=None):
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        return [
            (channel.topic, message.log_time, content)
            for _, channel, message, content in reader.iter_decoded_messages(topics=topic)
        ]


def kinematics(row):
    data = mujoco.MjData(MODEL)
    mujoco.mj_setState(MODEL, data, row, mujoco.mjtState.mjSTATE_INTEGRATION)
    mujoco.mj_kinematics(MODEL, data)
    return data


@pytest.fixture
def watched(tmp_path):
    """A log of environments 0 and 2, and the rows that physics received in every step."""
    env, rows = SmallEnv(), []
    recorder = McapRecorder(tmp_path / "log.mcap", env, options=VIEW)
    env.add_observer(recorder)
    env.reset()

    class Watcher:
        def on_physics(self, event):
            if event.phase == "before":
                rows.append(event.rows.copy())

        def on_write(self, write): ...

    env.sim.engine.listeners.append(Watcher())
    for _ in range(9):
        env.step()
    rows.append(env.sim.engine.rows.copy())
    env.close()
    return tmp_path / "log.mcap", rows


def test_every_message_of_the_file_is_decoded(watched):
    path, _ = watched
    found = decoded(path)
    assert len(found) == inspect(path).messages
    assert {topic for topic, _, _ in found} == {
        "/sim/start", "/sim/steps", "/episode", "/tf", "/log",
        "/env_0/scene", "/env_0/joint_states", "/env_0/metrics",
        "/env_2/scene", "/env_2/joint_states", "/env_2/metrics",
    }  # fmt: skip
    runs = [content for topic, _, content in found if topic == "/sim/steps"]
    assert runs[0].first == 0
    ends = [run for run in runs if any(call.kind == "step" for call in run.calls)]
    assert sum(run.count for run in ends) == 9


def test_frames_stand_where_mujoco_puts_them(watched):
    path, rows = watched
    messages = decoded(path, "/tf")
    assert len(messages) == len(rows)
    for (_, time, message), row in zip(messages, rows, strict=True):
        frames = {t.child_frame_id: t for t in message.transforms}
        assert len(frames) == 2 * MODEL.nbody  # every body and each environment's own frame
        for env in (0, 2):
            data = kinematics(row[env])
            for body in range(1, MODEL.nbody):
                frame = frames[f"env_{env}/{MODEL.body(body).name}"]
                assert frame.parent_frame_id == f"env_{env}"
                t, r = frame.translation, frame.rotation
                assert [t.x, t.y, t.z] == data.xpos[body].tolist()
                assert [r.w, r.x, r.y, r.z] == data.xquat[body].tolist()
                assert frame.timestamp.seconds * 10**9 + frame.timestamp.nanos == time
        base = frames["env_2"]
        assert base.parent_frame_id == "world"
        pitch = min(2.5 * MODEL.stat.extent, 5.0)  # in a row of their own
        assert (base.translation.x, base.translation.y, base.rotation.w) == (pitch, 0.0, 1.0)


def test_joints_have_their_positions_and_velocities(watched):
    path, rows = watched
    messages = decoded(path, "/env_2/joint_states")
    assert len(messages) == len(rows)
    for (_, _, message), row in zip(messages, rows, strict=True):
        data = kinematics(row[2])
        assert [j.name for j in message.joints] == ["arm/shoulder", "arm/elbow"]
        assert [j.position for j in message.joints] == data.qpos[:2].tolist()
        assert [j.velocity for j in message.joints] == data.qvel[:2].tolist()


def test_the_scene_is_shown(watched):
    path, _ = watched
    # once, though environment 0 is reset in step 6 and environment 2 in step 8
    assert len(decoded(path, "/env_0/scene")) == 1
    assert len(decoded(path, "/env_2/scene")) == 1
    _, _, scene = decoded(path, "/env_2/scene")[0]
    entities = {e.id: e for e in scene.entities}
    assert set(entities) == {
        "env_2", "env_2/arm/base", "env_2/arm/upper", "env_2/arm/fore", "env_2/cube", "env_2/goal",
    }  # fmt: skip
    assert all(e.frame_locked and e.frame_id == name for name, e in entities.items())
    cube = entities["env_2/cube"].cubes[0]
    assert (cube.size.x, cube.size.y, cube.size.z) == pytest.approx((0.1, 0.1, 0.1))
    assert (cube.color.r, cube.color.b, cube.color.a) == (0, 1, 1)
    base = entities["env_2/arm/base"].cylinders[0]
    assert (base.size.x, base.size.z, base.top_scale) == pytest.approx((0.12, 0.1, 1))
    goal = entities["env_2/goal"].spheres[0]
    assert (goal.size.x, goal.color.a) == pytest.approx((0.04, 0.5))
    upper = entities["env_2/arm/upper"]  # a capsule, in its material's colour
    assert (len(upper.cylinders), len(upper.spheres)) == (1, 2)
    assert upper.cylinders[0].color.r == pytest.approx(0.8)
    ends = sorted(s.pose.position.x for s in upper.spheres)
    assert ends == pytest.approx([0, 0.3], abs=1e-12)
    wedge = entities["env_2/arm/fore"].models[0]
    assert (wedge.media_type, wedge.override_color, wedge.scale.z) == ("model/gltf-binary", True, 1)
    assert wedge.data == glb(mesh_of(MODEL, MODEL.geom("arm/tip").id))
    plane = entities["env_2"].cubes[0]  # infinite: drawn as a thin slab whose top is z = 0
    assert plane.pose.position.z + plane.size.z / 2 == pytest.approx(0)
    assert plane.size.x == plane.size.y == pytest.approx(min(4.0, 2.5 * MODEL.stat.extent))


def test_looks_follow_the_model_of_their_environment(tmp_path):
    env = SmallEnv()
    geom = np.array([4 * MODEL.geom("cube/geom").id])
    env.sim.engine.write_model("geom_rgba", 0.25, np.array([2]), geom)  # before the recorder
    env.add_observer(McapRecorder(tmp_path / "log.mcap", env, options=VIEW))
    env.reset()
    env.sim.engine.write_model("geom_rgba", 0.75, np.array([0, 1]), geom)
    env.step()
    env.close()
    reds = {}
    for number in (0, 2):
        _, _, scene = decoded(tmp_path / "log.mcap", f"/env_{number}/scene")[0]
        reds[number] = next(e for e in scene.entities if e.id.endswith("cube")).cubes[0].color.r
    assert reds == {0: 0.75, 2: 0.25}


def test_metrics_are_flat_and_those_of_the_environment(watched):
    path, _ = watched
    found = [content for _, _, content in decoded(path, "/env_2/metrics")]
    assert [f.name for f in found[0].DESCRIPTOR.fields] == [
        "reward", "terminated", "truncated", "elapsed_steps",
        "reward_near_goal", "reward_effort", "metric_success",
    ]  # fmt: skip
    assert [m.elapsed_steps for m in found] == list(range(1, 10))
    with recording.open(path) as log:
        rewards = log.read("rewards", env=2)["rewards"][:, 0].tolist()
    assert [m.reward for m in found] == rewards
    assert [m.reward_near_goal for m in found] == rewards
    assert {m.metric_success for m in found} == {1.0}
    assert [m.truncated for m in found] == [0.0] * 8 + [1.0]


def test_the_log_tells_of_resets_and_divergence(record, poison):
    lines = [c for _, _, c in decoded(record(env=poison, steps=9), "/log")]
    texts = [line.message for line in lines if "move_goal" not in line.message]
    assert texts[:3] == [
        "recording begins", "environment 0: mass (reset): scale 1.137", "environments 0 reset",
    ]  # fmt: skip
    assert "environment 0: episode 0 ended after 7 steps: out of time" in texts
    assert "environments 1 diverged in step 5" in texts
    assert texts[-1] == "recording ends after 9 steps"
    warning = next(line for line in lines if "diverged" in line.message)
    assert warning.level == type(warning).WARNING


def test_the_log_tells_what_events_drew(record):
    path = record(steps=110, num_envs=3, options=RecordOptions(view_envs=[2]), length=200)
    with recording.open(path) as log:
        drawn = [event.drawn["position"] for event in log.events() if event.term == "move_goal"]
    lines = [c.message for _, _, c in decoded(path, "/log") if "move_goal" in c.message]
    assert len(drawn) == 110  # one in each step of 20 ms, and a line a second
    rows = [drawn[step][2] for step in (0, 50, 100)]
    assert lines == [
        "environment 2: move_goal (interval): position " + " ".join(f"{x:.4g}" for x in row)
        for row in rows
    ]


def test_views_are_sampled_at_most_as_often_as_asked(record):
    # 20 ms a step: 15 Hz is every fourth step (80 ms), and whenever a reset changes the picture
    path = record(steps=21, options=RecordOptions(view_hz=15), num_envs=1, length=100)
    start = inspect(path).header.start_ns
    steps = [(time - start) // 20_000_000 for _, time, _ in decoded(path, "/tf")]
    assert steps == [0, 4, 8, 12, 16, 20, 21]  # the last state in any case


def test_no_views(record):
    path = record(options=RecordOptions(view_envs=()))
    assert {c.topic for c in inspect(path).channels} == {
        "/log", "/episode", "/sim/start", "/sim/steps",
    }  # fmt: skip


def test_foxgloves_schemas_are_the_published_ones(watched):
    path, _ = watched
    with path.open("rb") as stream:
        schemas = make_reader(stream).get_summary().schemas.values()
    foxglove = [s for s in schemas if s.name.startswith("foxglove.")]
    assert {s.name for s in foxglove} == {
        "foxglove.FrameTransforms", "foxglove.JointStates", "foxglove.Log", "foxglove.SceneUpdate",
    }  # fmt: skip
    for schema in foxglove:
        assert schema.encoding == "protobuf"
        files = {f.name: f for f in FileDescriptorSet.FromString(schema.data).file}
        short = schema.name.partition(".")[2]
        assert f"foxglove/{short}.proto" in files
        for name, file in files.items():
            assert set(file.dependency) <= set(files)
            if name.startswith("foxglove/"):
                module = __import__(
                    f"{published.__name__}.{name[9:-6]}_pb2", fromlist=["DESCRIPTOR"]
                )
                theirs = FileDescriptorProto()
                module.DESCRIPTOR.CopyToProto(theirs)
                assert file == theirs


def test_the_layout_shows_topics_that_exist(watched):
    path, _ = watched
    layout = json.loads(path.with_name("foxglove_layout.json").read_text())
    topics = {c.topic for c in inspect(path).channels if c.messages}
    panels = layout["configById"]
    assert set(panels["3D!scene"]["topics"]) == {"/env_0/scene", "/env_2/scene"} <= topics
    values = [
        p["value"] for name in panels if name.startswith("Plot") for p in panels[name]["paths"]
    ]
    assert {re.match(r"/[a-z0-9_/]+", value)[0] for value in values} == {
        "/env_0/joint_states", "/env_0/metrics",
    }  # fmt: skip
    assert '/env_0/joint_states.joints[:]{name=="arm/elbow"}.position' in values

    def named(node):
        if isinstance(node, str):
            return {node}
        return named(node["first"]) | named(node["second"])

    assert named(layout["layout"]) == set(panels)


def test_the_layout_plots_every_reward_and_sees_every_environment():
    env = SmallEnv(num_envs=9)
    env.reward_manager = SimpleNamespace(terms={"near goal": None, "effort": None})
    one, many = foxglove_layout(env, [4]), foxglove_layout(env, [1, 3, 5, 7])
    assert [p["value"] for p in one["configById"]["Plot!reward"]["paths"]] == [
        "/env_4/metrics.reward",
        "/env_4/metrics.reward_effort",
        "/env_4/metrics.reward_near_goal",
    ]
    near, far = (x["configById"]["3D!scene"]["cameraState"] for x in (one, many))
    pitch = min(2.5 * MODEL.stat.extent, 5.0)
    assert near["targetOffset"] == pytest.approx(MODEL.stat.center)
    middle = MODEL.stat.center + np.array([pitch / 2, pitch / 2, 0])
    assert far["targetOffset"] == pytest.approx(middle)
    assert far["distance"] == pytest.approx(near["distance"] + 1.2 * pitch)


def test_a_scene_is_shown_again_when_it_changed(record, monkeypatch):
    # Masses are randomized at every reset: they are not visible.
    assert len(decoded(record(steps=20, num_envs=1), "/env_0/scene")) == 1
    monkeypatch.setattr(SmallEnv, "reset", _reset_to_another_size)
    assert len(decoded(record(name="b.mcap", steps=20, num_envs=1), "/env_0/scene")) == 3


def _reset_to_another_size(self, ids=None):
    ids = np.arange(self.num_envs) if ids is None else ids
    self.sim.engine.reset(ids)
    self.sim.engine.write_model("geom_size", 0.01 * (2 + self.count), ids, slice(0, 1))
    self.elapsed[ids] = 0
    for o in self.observers:
        o.on_reset(self, ids)
