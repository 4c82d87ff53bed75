import builtins
import csv
import importlib
import io
import json
import os
import subprocess
import sys
import xml.etree.ElementTree as ElementTree

import h5py
import mujoco
import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

import embodichain.recording as recording
from embodichain.cli import main
from embodichain.recording import RecordOptions
from embodichain.recording.export import FORMATS, Part, export
from embodichain.recording.export.formats.ros2 import urdf
from embodichain.utils.errors import ConfigError
from tests.recording.scene import MODEL

pytestmark = pytest.mark.slow


@pytest.fixture
def log(record):
    with recording.open(record(steps=24)) as log:
        yield log


def test_csv_is_a_table_with_units(log):
    path = export(log, "csv")
    assert path == log.path.with_suffix(".csv")
    data = log.read()
    with path.open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == 24 * 3
    row = rows[10 * 3 + 2]
    assert (row["step"], row["env"], float(row["time [s]"])) == ("10", "2", data.time[10])
    assert float(row["qpos/arm/elbow [rad]"]) == data["qpos"][10, 2, 1]
    assert float(row["qvel/cube/free.wz [rad/s]"]) == data["qvel"][10, 2, -1]
    assert float(row["mocap_pos/goal.x [m]"]) == data["mocap_pos"][10, 2, 3]
    assert row["truncated"] == str(int(data["truncated"][10, 2]))


def test_npz_holds_arrays_and_their_names(log):
    data = log.read()
    with np.load(export(log, "npz")) as file:
        for field in data:
            assert np.array_equal(file[field], data[field])
        assert file["qpos.names"].tolist() == data.names("qpos")
        assert file["qpos.units"][:3].tolist() == ["rad", "rad", "m"]
        assert np.array_equal(file["time"], data.time)
        assert json.loads(str(file["about"]))["task"] == "small"


def test_parquet_is_the_same_table(log):
    table = pq.read_table(export(log, "parquet"))
    frame = log.read().frame()
    assert table.column_names == list(frame.columns)
    assert np.array_equal(table["qpos/cube/free.z"].to_numpy(), frame["qpos/cube/free.z"])
    assert table.schema.field("qvel/arm/elbow").metadata == {b"unit": b"rad/s"}
    assert table.schema.metadata[b"task"] == b"small"


def test_hdf5_is_one_demonstration_for_each_episode(log):
    data, episodes = log.read(), log.episodes
    with h5py.File(export(log, "hdf5")) as file:
        demos = file["data"]
        assert len(demos) == len(episodes)
        assert demos.attrs["total"] == 24 * 3
        args = json.loads(demos.attrs["env_args"])
        assert args["env_kwargs"] == {"name": "small", "config": {"seed": 0}}
        assert (args["type"], args["control_freq"]) == (2, 50)
        for number, episode in enumerate(episodes):
            demo = demos[f"demo_{number}"]
            steps = slice(episode.first_step, episode.last_step + 1)
            assert demo.attrs["num_samples"] == episode.steps == len(demo["actions"])
            assert np.array_equal(demo["actions"], data["actions"][steps, episode.env])
            assert np.array_equal(demo["obs/qpos"], data["qpos"][steps, episode.env])
            assert demo["dones"][:-1].sum() == 0
            assert demo["dones"][-1] == (episode.terminated or episode.truncated)
            assert np.array_equal(demo["states"][:, 1:10], data["qpos"][steps, episode.env])
        assert list(demo["states"].attrs["names"])[:2] == ["time/time", "qpos/arm/shoulder"]
        assert list(demo["obs/qpos"].attrs["units"])[:3] == ["rad", "rad", "m"]
        assert ElementTree.fromstring(demo.attrs["model_file"]).tag == "mujoco"


def bag_messages(path):
    """Topic, time in ns and message of a ROS 2 bag, in the order of time."""
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        return [(c.topic, m.log_time, ros) for _, c, m, ros in reader.iter_decoded_messages()]


def test_foxgloves_reader_of_ros_2_reads_the_bag(log, tmp_path):
    path = export(log, "ros2", tmp_path / "bag.mcap", Part(env=1))
    data = log.read(["qpos", "qvel", "mocap_pos"], env=1)
    joints, frames, described = [], [], []
    messages = bag_messages(path)
    assert len(messages) == 24 * 2 + 1
    for topic, stamp, message in messages:
        kind = {"/env_1/joint_states": joints, "/tf": frames}.get(topic, described)
        kind.append((stamp, message))
    assert [list(m.name) for _, m in joints] == [["arm/shoulder", "arm/elbow"]] * 24
    assert np.array_equal([m.position for _, m in joints], data["qpos"][:, 0, :2])
    assert np.array_equal([m.velocity for _, m in joints], data["qvel"][:, 0, :2])
    stamp, message = joints[5]
    assert stamp == log.header.start_ns + 5 * 20_000_000
    assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == stamp
    for index, (_, message) in enumerate(frames):
        poses = {t.child_frame_id: t for t in message.transforms}
        assert len(poses) == MODEL.nbody - 1
        cube = poses["env_1/cube"]
        assert cube.header.frame_id == "env_1"
        position, turn = cube.transform.translation, cube.transform.rotation
        expected = data["qpos"][index, 0, 2:]
        assert (position.x, position.y, position.z) == tuple(expected[:3])
        found = np.array([turn.w, turn.x, turn.y, turn.z])
        assert found == pytest.approx(expected[3:] / np.linalg.norm(expected[3:]), abs=1e-12)
    with AnyReader([path]) as reader:  # rosbags finds the same, and the latched topic
        assert reader.message_count == len(messages)
        (latched,) = [c for c in reader.connections if c.topic == "/env_1/robot_description"]
        (quality,) = latched.ext.offered_qos_profiles
        assert quality.durability.name == "TRANSIENT_LOCAL"
    text = described[0][1].data
    links = {link.get("name") for link in ElementTree.fromstring(text).iter("link")}
    assert set(poses) < links


def test_frames_follow_the_model_of_their_environment(record, tmp_path):
    from tests.recording.scene import SmallEnv

    class Moved(SmallEnv):
        def reset(self, ids=None):
            super().reset(ids)
            fore = mujoco.mj_name2id(MODEL, mujoco.mjtObj.mjOBJ_BODY, "arm/fore")
            everyone = np.arange(self.num_envs) if ids is None else ids
            offsets = 0.3 + 0.1 * everyone[:, None] + 0.01 * self.episodes[everyone, None]
            columns = np.array([3 * fore])
            self.sim.engine.write_model("body_pos", offsets, everyone, columns)

        def step(self):
            if self.count == 12:  # between two steps, not at the end of one
                self.reset(np.array([2]))
            super().step()

    with recording.open(record(env=Moved, steps=20)) as log:
        path = export(log, "ros2", tmp_path / "bag.mcap", Part(env=2))
        episodes = log.read("episodes", env=2)["episodes"][:, 0]
    lengths = []
    for topic, _, message in bag_messages(path):
        if topic == "/tf":
            at = {t.child_frame_id: t.transform.translation for t in message.transforms}
            a, b = at["env_2/arm/upper"], at["env_2/arm/fore"]
            lengths.append(np.linalg.norm([a.x - b.x, a.y - b.y, a.z - b.z]))
    assert lengths == pytest.approx(0.5 + 0.01 * episodes)


URDF_MODEL = """
<mujoco><worldbody>
  <body name="a" pos=".1 .2 .3" euler="20 30 40"><geom size=".1" mass="1"/>
    <joint name="j1" axis="0 1 0" pos=".05 0 .1" range="-90 90" limited="true"/>
    <body name="b" pos="0 0 .4"><geom type="capsule" size=".05 .1" mass="1"/>
      <joint name="j2" type="slide" axis="1 0 0" ref=".2"/>
      <joint name="j3" axis="0 0 1" ref="30"/>
      <body name="c" pos=".3 0 0" quat=".5 .5 .5 .5"><geom type="box" size=".1 .2 .3" mass="1"/>
        <joint name="j4" axis="1 1 0"/></body>
    </body>
  </body>
</worldbody></mujoco>
"""


TURNED = """
<mujoco><worldbody>
  <body name="a"><geom size=".1" mass="1"/>
    <body name="b" pos="0 0 .05" quat=".5 -.5 .5 .5"><geom size=".1" mass="1"/>
      <joint name="j1" axis="0 0 1" range="-90 90" limited="true"/>
      <body name="c" pos="0 .2 0" quat="0.7071067811865476 0 -0.7071067811865476 0">
        <geom type="box" size=".03 .01 .01" pos=".03 0 0" quat=".5 .5 .5 -.5" mass="1"/>
        <joint name="j2" type="slide" axis="0 1 0"/></body>
    </body>
  </body>
</worldbody></mujoco>
"""
"""Bodies, and a shape, that are turned by a pitch of exactly 90 degrees, and by another angle."""


def poses_of(model, values):
    """Position and rotation matrix of the bodies a, b and c, by MuJoCo."""
    data = mujoco.MjData(model)
    for name, value in values.items():
        data.joint(name).qpos = value
    mujoco.mj_kinematics(model, data)
    return {name: (data.body(name).xpos, data.body(name).xmat) for name in "abc"}


def by_mujoco(text, values):
    """The same of a URDF, by MuJoCo's reader."""
    # It needs some mass in every link that moves, and would else fuse those that do not.
    bounds = '<compiler boundmass="1e-3" boundinertia="1e-3" fusestatic="false"/>'
    made = text.replace("<link", f"<mujoco>{bounds}</mujoco><link", 1)
    model = mujoco.MjModel.from_xml_string(made)
    data = mujoco.MjData(model)
    for name, value in values.items():
        data.joint(name).qpos = value
    mujoco.mj_kinematics(model, data)
    return {n: (data.body(f"env_0/{n}").xpos, data.body(f"env_0/{n}").xmat) for n in "abc"}


def by_yourdfpy(text, values):
    """The same, by yourdfpy."""
    yourdfpy = pytest.importorskip("yourdfpy")
    robot = yourdfpy.URDF.load(io.BytesIO(text.encode()))
    assert robot.validate()
    robot.update_cfg(values)
    at = {name: robot.get_transform(f"env_0/{name}", "env_0") for name in "abc"}
    return {name: (pose[:3, 3], pose[:3, :3].ravel()) for name, pose in at.items()}


@pytest.mark.parametrize("scene", [URDF_MODEL, TURNED], ids=["skew", "turned"])
@pytest.mark.parametrize("reader", [by_mujoco, by_yourdfpy])
def test_the_urdf_moves_as_the_model_does(scene, reader):
    """Other programs' readers of URDF put every link where the model has the body."""
    model = mujoco.MjModel.from_xml_string(scene)
    text = urdf(model, 0)
    rng = np.random.default_rng(0)
    for _ in range(5):
        values = {model.joint(i).name: rng.uniform(-1, 1) for i in range(model.njnt)}
        found = reader(text, values)
        for body, (pos, mat) in poses_of(model, values).items():
            assert found[body][0] == pytest.approx(pos, abs=1e-9)
            assert found[body][1] == pytest.approx(mat, abs=1e-9)


def test_a_slide_of_a_urdf_has_a_limit():
    text = urdf(mujoco.MjModel.from_xml_string(TURNED), 0)
    joints = {joint.get("name"): joint for joint in ElementTree.fromstring(text).iter("joint")}
    assert joints["j2"].get("type") == "prismatic"
    limit = joints["j2"].find("limit")
    assert (float(limit.get("lower")), float(limit.get("upper"))) == (-1e9, 1e9)


@pytest.mark.parametrize("format", ["csv", "npz", "parquet"])
def test_parts(log, tmp_path, format):
    episode = next(e for e in log.episodes if e.env == 1 and e.episode == 1)
    path = export(log, format, tmp_path / f"part.{format}", Part(1, 1, 0, episode.last_step))
    steps = {
        "csv": lambda: pd.read_csv(path)["step"].tolist(),
        "npz": lambda: np.load(path)["steps"].tolist(),
        "parquet": lambda: pq.read_table(path)["step"].to_pylist(),
    }[format]()
    assert steps == list(range(episode.first_step, episode.last_step))


def test_hdf5_of_a_range_cuts_episodes(log, tmp_path):
    with h5py.File(export(log, "hdf5", tmp_path / "part.hdf5", Part(0, None, 3, 9))) as file:
        firsts = [demo.attrs["first_step"] for demo in file["data"].values()]
        assert firsts[0] == 3
        assert file["data"].attrs["total"] == 6


@pytest.mark.parametrize("format", ["hdf5", "lerobot"])
def test_a_log_without_episodes_is_refused(record, tmp_path, format):
    with (
        recording.open(record("empty.mcap", steps=0)) as empty,
        pytest.raises(ConfigError, match="no episode is in the chosen range"),
    ):
        export(empty, format, tmp_path / "none")
    assert not list(tmp_path.glob("*none*"))


@pytest.mark.parametrize("format", ["hdf5", "lerobot"])
def test_demonstrations_have_no_gaps(record, tmp_path, capsys, format):
    """Every third episode of environment 0 is recorded, and what the others do meanwhile."""
    path, out = record(steps=60, options=RecordOptions(every=3)), tmp_path / "out"
    with recording.open(path) as log:
        there = set(log.read("rewards").steps.tolist())
        steps = {(e.env, e.episode): range(e.first_step, e.last_step + 1) for e in log.episodes}
    whole = [key for key, mine in steps.items() if there.issuperset(mine)]
    assert {(0, 0), (0, 3), (0, 6)} <= set(whole) < set(steps)
    assert main(["export", str(path), "--format", format, "-o", str(out)]) == 0
    said = f"warning: {len(steps) - len(whole)} of {len(steps)} episodes are left out: record.every"
    assert said in capsys.readouterr().err
    if format == "hdf5":
        with h5py.File(out) as file:
            demos = [file[f"data/demo_{i}"].attrs for i in range(len(file["data"]))]
            found = [(a["env"], a["episode"], a["num_samples"]) for a in demos]
    else:
        rows = pq.read_table(out / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
        found = [(r["source/env"], r["source/episode"], r["length"]) for r in rows]
    assert found == [(*key, len(steps[key])) for key in whole]
    asked = ["--env", "0", "--episode", "1", "-o", str(tmp_path / "none")]
    assert main(["export", str(path), "--format", format, *asked]) == 2
    assert "none of 1 episodes is whole: record.every=3" in capsys.readouterr().err
    assert not (tmp_path / "none").exists()


@pytest.mark.parametrize("format", FORMATS)
def test_a_log_without_states_is_refused(record, tmp_path, capsys, format):
    path, out = record(options=RecordOptions(state="none")), tmp_path / "out"
    assert main(["export", str(path), "--format", format, "-o", str(out)]) == 2
    assert capsys.readouterr().err == (
        f"error: {path} has no states: it was recorded with record.state=none\n"
    )
    assert not out.exists()


@pytest.mark.parametrize("format", FORMATS)
def test_a_late_part_of_a_log_of_many_chunks(many_chunks, tmp_path, capsys, format):
    log, out = many_chunks(), tmp_path / f"out{FORMATS[format].suffix}"
    asked = ["--format", format, "-o", str(out), "--env", "1", "--from", "85", "--to", "115"]
    assert main(["export", str(log), *asked]) == 0, capsys.readouterr().err
    with recording.open(log) as read:
        data = read.read(["ctrl", "qpos"], env=1, start=85, stop=115)
    if format in ("csv", "parquet"):
        table = pd.read_csv(out) if format == "csv" else pd.read_parquet(out)
        columns = [c for c in table.columns if c.startswith("ctrl/")]
        assert np.array_equal(table[columns], data["ctrl"][:, 0])
    elif format == "npz":
        with np.load(out) as arrays:
            assert np.array_equal(arrays["ctrl"], data["ctrl"])
    elif format == "hdf5":
        with h5py.File(out) as file:
            assert np.array_equal(file["data/demo_0/obs/qpos"], data["qpos"][:, 0])
    elif format == "ros2":
        assert len(bag_messages(out)) == 30 * 2 + 1
    else:
        assert any(f.stat().st_size for f in (out.rglob("*") if out.is_dir() else [out]))


@pytest.mark.parametrize("format", FORMATS)
def test_steps_that_are_not_there_are_refused(record, tmp_path, capsys, format):
    asked = ["--format", format, "-o", str(tmp_path / "out")]
    log = str(record(steps=24))
    assert main(["export", log, *asked, "--from", "24"]) == 2
    assert f"{log} has no control step from 24 to the end" in capsys.readouterr().err
    assert main(["export", log, *asked, "--from", "7", "--to", "7", "--env", "1"]) == 2
    assert f"{log} has no control step from 7 to 7" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("format", FORMATS)
def test_nothing_is_overwritten(log, tmp_path, format):
    path = tmp_path / "taken"
    path.write_text("mine")
    with pytest.raises(ConfigError, match="exists; it is never replaced"):
        export(log, format, path)
    assert path.read_text() == "mine"


@pytest.mark.parametrize(
    ("format", "module", "package", "extra"),
    [
        ("parquet", "pyarrow", "pyarrow", "parquet"),
        ("hdf5", "h5py", "h5py", "hdf5"),
        ("rrd", "rerun", "rerun-sdk", "rerun"),
        ("lerobot", "pyarrow", "pyarrow", "lerobot"),
        ("ros2", "rosbags", "rosbags", "ros2"),
    ],
)
def test_a_missing_package_is_named(log, monkeypatch, tmp_path, format, module, package, extra):
    importing = importlib.import_module

    def refuse(name, *args):
        if name.partition(".")[0] == module:
            raise ImportError(name)
        return importing(name, *args)

    # As if the package were not installed.
    monkeypatch.setattr(importlib, "import_module", refuse)
    said = rf"--format {format} needs {package}: pip install 'embodichain\[{extra}\]'"
    with pytest.raises(ConfigError, match=said):
        export(log, format, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("format", ["csv", "npz"])
def test_tables_need_no_further_packages(log, monkeypatch, tmp_path, format):
    importing = builtins.__import__

    def refuse(name, *args, **kwargs):
        if name.partition(".")[0] in ("pandas", "pyarrow", "h5py", "rosbags"):
            raise ImportError(name)
        return importing(name, *args, **kwargs)

    # As if none of the extras were installed.
    monkeypatch.setattr(builtins, "__import__", refuse)
    assert export(log, format, tmp_path / "out").stat().st_size


@pytest.mark.parametrize("format", FORMATS)
def test_a_broken_log_is_exported_as_far_as_it_goes(record, tmp_path, capsys, format):
    whole = record(num_envs=64, steps=160)  # several chunks
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size * 2 // 3])
    out = tmp_path / "out"
    assert main(["export", str(cut), "--format", format, "-o", str(out), "--env", "3"]) == 0
    assert out.stat().st_size
    assert "warning" in capsys.readouterr().err


def test_the_command(record, tmp_path, capsys):
    path = record(steps=8)
    assert main(["export", str(path), "--format", "csv", "--from", "2", "--to", "5", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert pd.read_csv(said["file"])["step"].tolist() == np.repeat([2, 3, 4], 3).tolist()
    for arguments, message in [
        (["--format", "csv"], "exists; it is never replaced"),
        (["--format", "cvs"], "unknown export format 'cvs'; there are: csv, hdf5"),
        (["--format", "npz", "--episode", "1"], "--episode needs --env"),
        (["--format", "npz", "--env", "7"], "no environment 7 in the log: there are 0 to 2"),
        (["--format", "npz", "-o", str(tmp_path / "no" / "x")], "does not exist"),
    ]:
        assert main(["export", str(path), *arguments]) == 2
        assert message in capsys.readouterr().err
    assert not [p for p in tmp_path.iterdir() if ".part" in p.name]


FULL = """
import resource, sys
from embodichain.cli import main

most = int(sys.argv[1])
resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))  # each file's disk is full there
sys.exit(main(sys.argv[2:]))
"""


@pytest.mark.parametrize("kilobytes", [0, 4])
def test_hdf5_on_a_full_disk_is_an_error_and_nothing_is_left(record, tmp_path, kilobytes):
    """HDF5 itself ended the process with SIGSEGV: a file that it could not close, closed again."""
    path, out = record(steps=24), tmp_path / "out"
    out.mkdir()
    command = ["export", str(path), "--format", "hdf5", "-o", str(out / "x.hdf5")]
    command = [sys.executable, "-c", FULL, str(kilobytes * 1024), *command]
    # What coverage measures could not be written either, and would say so.
    env = {name: value for name, value in os.environ.items() if not name.startswith("COVERAGE")}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=env)
    assert done.returncode == 1
    assert done.stderr == f"error: File too large: {out}/x.hdf5\n"
    assert list(out.iterdir()) == []


def test_formats_are_named_in_help_without_importing_one():
    script = (
        "import sys\n"
        "from embodichain.cli import main\n"
        "assert main(['export', '--help']) == 0\n"
        "heavy = {'torch', 'mujoco'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    words = " ".join(done.stdout.split())
    assert f"For a log: {', '.join(FORMATS)}, robomimic" in words
