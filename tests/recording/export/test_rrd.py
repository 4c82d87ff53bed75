"""Recordings for Rerun, read back with Rerun's own reader and command."""

import os
import socket
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import mujoco
import numpy as np
import pytest

import embodichain.recording as recording
from embodichain.cli import main
from embodichain.recording.export import Part, export
from embodichain.recording.views.shapes import mesh_of, shapes
from tests.recording.live import record_task
from tests.recording.scene import MODEL, SmallEnv

pytest.importorskip("rerun")
from rerun.chunk import RrdReader

pytestmark = pytest.mark.slow


@pytest.fixture(autouse=True)
def _no_analytics(monkeypatch, tmp_path_factory):
    """A new home each time: the viewer asks before it ever sends anything."""
    monkeypatch.setenv("HOME", str(tmp_path_factory.mktemp("home")))


def rerun(*arguments):
    command = [str(Path(sys.executable).with_name("rerun")), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, env=os.environ, timeout=60)


def read(path):
    """Entity to component to [(step, value)] in the order of steps; step None is static."""
    found = {}
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        columns = {name: batch.column(name).to_pylist() for name in batch.schema.names}
        steps = [None] * len(batch) if chunk.is_static else columns["step"]
        for name, values in columns.items():
            if ":" in name:
                rows = found.setdefault(chunk.entity_path, {}).setdefault(name, [])
                rows += zip(steps, values, strict=True)
        if not chunk.is_static and "sim_time" in columns:
            seconds = [time.total_seconds() for time in columns["sim_time"]]
            assert seconds == pytest.approx(0.02 * np.array(steps))
    for components in found.values():
        for rows in components.values():
            rows.sort(key=lambda row: -1 if row[0] is None else row[0])
    return found


def numbers(rows):
    return np.array([value for _, value in rows])


@pytest.fixture
def log(record):
    with recording.open(record(steps=24)) as log:
        yield log


def test_poses_are_those_of_the_log(log, tmp_path):
    found = read(export(log, "rrd", tmp_path / "a.rrd", Part(env=1)))
    data, state = log.read(env=1), mujoco.MjData(MODEL)
    moving = found["/world/env_1/arm/fore"]
    assert [step for step, _ in moving["Transform3D:translation"]] == list(range(24))
    for index in range(24):
        state.qpos[:] = data["qpos"][index, 0]
        state.mocap_pos[:] = data["mocap_pos"][index, 0].reshape(-1, 3)
        state.mocap_quat[:] = data["mocap_quat"][index, 0].reshape(-1, 4)
        mujoco.mj_kinematics(MODEL, state)
        for name in ("arm/upper", "arm/fore", "cube", "goal"):
            body, at = state.body(name), found[f"/world/env_1/{name}"]
            (position,) = at["Transform3D:translation"][index][1]
            (turn,) = at["Transform3D:quaternion"][index][1]
            assert position == pytest.approx(body.xpos, abs=1e-6)
            assert turn == pytest.approx(body.xquat[[1, 2, 3, 0]], abs=1e-6)
    still = found["/world/env_1/hidden"]["Transform3D:translation"]
    assert [step for step, _ in still] == [0]  # what never moves is said once


def test_the_robot_is_drawn_with_its_shapes_and_colours(log, tmp_path):
    found = read(export(log, "rrd", tmp_path / "a.rrd", Part(env=0)))
    drawn = {path.removeprefix("/world/env_0/") for path in found}
    assert {
        *("world/box", "arm/base/cylinder", "arm/upper/capsule", "arm/fore/capsule"),
        *("cube/box", "goal/ellipsoid"),
    } <= drawn
    assert not [path for path in drawn if path.startswith("hidden/")]
    upper = found["/world/env_0/arm/upper/capsule"]
    ((_, (start,)),) = upper["Capsules3D:translations"]
    ((_, (length,)),) = upper["Capsules3D:lengths"]
    ((_, ((x, y, z, w),)),) = upper["Capsules3D:quaternions"]
    axis = np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])
    ends = [start, start + length * axis]  # the model says: from 0 0 0 to .3 0 0
    assert sorted(end[0] for end in ends) == pytest.approx([0, 0.3], abs=1e-6)
    ((_, (color,)),) = upper["Capsules3D:colors"]
    assert color == 0xCC1A1AFF
    ((_, (color,)),) = found["/world/env_0/goal/ellipsoid"]["Ellipsoids3D:colors"]
    assert color == 0x00FF0080
    tip = next(s for s in shapes(MODEL) if s.kind == "mesh")
    mesh = found[f"/world/env_0/arm/fore/mesh_{tip.geom}"]
    corners = numbers(mesh["Mesh3D:vertex_positions"])[0]
    own = mesh_of(MODEL, tip.geom)
    state = mujoco.MjData(MODEL)
    mujoco.mj_kinematics(MODEL, state)
    # Where MuJoCo has the geom, seen from its body.
    turn = state.body("arm/fore").xmat.reshape(3, 3).T
    at = turn @ (state.geom("arm/tip").xpos - state.body("arm/fore").xpos)
    matrix = turn @ state.geom("arm/tip").xmat.reshape(3, 3)
    expected = own.vertices[own.faces].reshape(-1, 3) @ matrix.T + at
    assert corners == pytest.approx(expected, abs=1e-6)
    normals = numbers(mesh["Mesh3D:vertex_normals"])[0]
    assert np.linalg.norm(normals, axis=1) == pytest.approx(1, abs=1e-6)
    outward = (corners - corners.mean(axis=0)) * normals
    assert (outward.sum(axis=1) > -1e-6).all()


def test_looks_follow_what_was_randomized(record, tmp_path):
    cube = MODEL.geom("cube/geom").id

    class Painted(SmallEnv):
        def reset(self, ids=None):
            super().reset(ids)
            everyone = np.arange(self.num_envs) if ids is None else ids
            red = 0.2 * (1 + self.episodes[everyone, None] % 4)
            self.sim.engine.write_model("geom_rgba", red, everyone, np.array([4 * cube]))

    with recording.open(record(env=Painted, steps=20)) as log:
        found = read(export(log, "rrd", tmp_path / "a.rrd", Part(env=1)))
        episodes = [e for e in log.episodes if e.env == 1]
    colors = found["/world/env_1/cube/box"]["Boxes3D:colors"]
    assert [step for step, _ in colors] == [e.first_step for e in episodes]
    reds = [color >> 24 for _, (color,) in colors]
    assert reds == [round(51 * (1 + e.episode % 4)) for e in episodes]
    assert len(found["/world/env_1/goal/ellipsoid"]["Ellipsoids3D:colors"]) == 1


def test_curves_and_lines(log, tmp_path):
    found = read(export(log, "rrd", tmp_path / "a.rrd", Part(env=0)))
    data = log.read(env=0)
    joints = found["/env_0/joint_positions"]
    assert joints["SeriesLines:names"] == [(None, ["arm/shoulder", "arm/elbow"])]
    assert np.array_equal(numbers(joints["Scalars:scalars"]), data["qpos"][:, 0, :2])
    speeds = numbers(found["/env_0/joint_velocities"]["Scalars:scalars"])
    assert np.array_equal(speeds, data["qvel"][:, 0, :2])
    actions = numbers(found["/env_0/actions"]["Scalars:scalars"])
    assert np.array_equal(actions, data["actions"][:, 0])
    rewards = numbers(found["/env_0/reward"]["Scalars:scalars"])[:, 0]
    assert np.array_equal(rewards, data["rewards"][:, 0])
    metrics = found["/env_0/metrics"]
    ((_, names),) = metrics["SeriesLines:names"]
    steps, values = log.metrics(0)
    assert [step for step, _ in metrics["Scalars:scalars"]] == steps.tolist()
    sampled = numbers(metrics["Scalars:scalars"])
    assert np.array_equal(sampled[:, names.index("reward_near_goal")], values["reward_near_goal"])
    ended = [e for e in log.episodes if e.env == 0 and (e.terminated or e.truncated)]
    returns = found["/env_0/episode/return"]["Scalars:scalars"]
    assert returns == [(e.last_step, [e.total_reward]) for e in ended]
    lines = [text for _, (text,) in found["/env_0/log"]["TextLog:text"]]
    assert len([line for line in lines if "move_goal (interval): position" in line]) == 24
    assert len([line for line in lines if "mass (reset): scale" in line]) == len(ended) + 1
    assert "environment 0: episode 0 truncated after 7 steps" in " ".join(lines)


def test_viewed_environments_stand_beside_each_other(record, tmp_path):
    options = recording.RecordOptions(view_envs=[0, 2])
    with recording.open(record(steps=12, options=options)) as log:
        found = read(export(log, "rrd", tmp_path / "a.rrd", Part(start=3, stop=9)))
    assert {path for path in found if path.startswith("/env_1")} == set()
    places = [found[f"/world/env_{i}"]["Transform3D:translation"][0][1][0] for i in (0, 2)]
    assert np.linalg.norm(np.subtract(*places)) > 1
    steps = [step for step, _ in found["/env_2/reward"]["Scalars:scalars"]]
    assert steps == list(range(3, 9))
    assert found["/world/env_2/cube/box"]["Boxes3D:colors"][0][0] == 3


def test_rerun_accepts_the_file_and_shows_the_scene_first(log, tmp_path):
    path = export(log, "rrd", tmp_path / "a.rrd")
    verified = rerun("rrd", "verify", path)
    assert verified.returncode == 0, verified.stderr
    (blueprint,) = RrdReader(path).blueprints()
    stored = [c.to_record_batch().to_pydict() for c in RrdReader(path).stream(store=blueprint)]
    kinds = {value[0] for b in stored for value in b.get("ViewBlueprint:class_identifier", [])}
    assert {"3D", "TimeSeries", "TextLog"} <= kinds
    (about,) = RrdReader(path).recordings()
    assert about.application_id == "embodichain"


def test_rerun_finds_nothing_wrong_with_logs(log, tmp_path):
    bag, states = export(log, "ros2", tmp_path / "bag.mcap"), {}
    for path in (log.path, bag):
        checked = rerun("mcap", "check", "--full", path)
        assert checked.returncode == 0, checked.stdout + checked.stderr
        rows = [line.split() for line in checked.stdout.splitlines()[1:] if " /" in line]
        states[path] = {row[3]: row[0] for row in rows}
        assert set(states[path].values()) == {"ok"}
    assert "/sim/steps" in states[log.path] and "/env_0/scene" in states[log.path]
    assert {"/tf", "/env_0/joint_states", "/env_0/robot_description"} <= set(states[bag])


def test_the_command(record, tmp_path, capsys):
    path = record(steps=8)
    assert main(["export", str(path), "--format", "rrd", "--env", "2", "--episode", "0"]) == 0
    assert "log.rrd" in capsys.readouterr().out
    steps = [step for step, _ in read(tmp_path / "log.rrd")["/env_2/reward"]["Scalars:scalars"]]
    assert steps == list(range(8))


@pytest.fixture
def twins(tmp_path):
    """A log with a stereo camera, and a body that is called as the cameras' part of the path."""
    stereo = (
        "{twins: {sensor_type: stereo_camera, width: 32, height: 24, "
        "extrinsics: {eye: [2, 0, 1], target: [0, 0, 0.5]}}}"
    )
    body = "{shape: {shape_type: Sphere, radius: 0.1}, init_pos: [1, 2, 0.5]}"
    overrides = [f"+task.sensors={stereo}", f"+task.objects.camera={body}"]
    keys = ["task=reach", "task.max_episode_steps=3", *overrides]
    path, _ = record_task(tmp_path / "twins.mcap", keys, 3)
    with recording.open(path) as log:
        yield log


def test_no_camera_is_below_something_with_a_pose(twins, tmp_path):
    found = read(export(twins, "rrd", tmp_path / "a.rrd", Part(env=0)))
    lenses = [path for path, of in found.items() if "Pinhole:resolution" in of]
    posed = [path for path, of in found.items() if "Transform3D:translation" in of]
    assert len(lenses) == 2
    for path in lenses:
        above = [other for other in posed if path.startswith(f"{other}/")]
        assert above == ["/world/env_0"]


def test_the_viewer_draws_both_eyes_where_they_are(twins, tmp_path, monkeypatch):
    """Rerun's own viewer, without a window: what it reports, and its graph of transforms."""
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    path = export(twins, "rrd", tmp_path / "a.rrd", Part(env=0))
    with headless(path) as viewer:
        views = viewer.get_state().views
        graph = viewer.get_transform_graph(include_transforms=True)
    assert {view.name for view in views} >= {"scene", "twins", "twins/right"}
    assert [(view.name, view.reports) for view in views if view.reports] == []
    frames = {frame["id"] for frame in graph["frames"]}
    left, right = (f"tf#/world/env_0/camera_/{name}" for name in ("twins", "twins\\/right"))
    assert {left, right} <= frames
    parents = {edge["child"]: edge["parent"] for edge in graph["edges"]}
    assert parents[left] == parents[right] == "tf#/world/env_0/camera_"


@contextmanager
def headless(path):
    """A viewer that has opened a recording; skipped where it finds no Vulkan."""
    from rerun.experimental import ViewerClient

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    try:
        client = ViewerClient.spawn(headless=True, port=port, hide_welcome_screen=True)
        client.open(str(path))
        ends = time.monotonic() + 30
        while not client.get_state().views and time.monotonic() < ends:
            time.sleep(0.2)
    except (ConnectionError, RuntimeError) as error:
        pytest.skip(
            "Rerun's viewer does not start here; it needs Vulkan, a software one is in Debian's "
            f"mesa-vulkan-drivers: {error}"
        )
    try:
        time.sleep(1.0)  # for its first pictures
        yield client
    finally:
        client.quit()
