"""Data sets say what an action is, which robot and which instruction; nothing becomes another."""

import json

import h5py
import mujoco
import numpy as np
import pyarrow.parquet as pq
import pytest

import embodichain.recording as recording
from embodichain.recording import McapRecorder, read_episodes
from embodichain.recording.export import export, export_episodes
from embodichain.utils.errors import ConfigError
from tests.recording.live import record_task
from tests.recording.scene import SmallEnv

pytestmark = pytest.mark.slow

SHORT = ["task.max_episode_steps=3"]
SENSORS = """
    eye: {sensor_type: camera, observe: true, width: 32, height: 24,
      extrinsics: {eye: [2, 0, 1], target: [0, 0, 0.5]}, data_types: [color, depth]}
    twins: {sensor_type: stereo_camera, observe: true, width: 16, height: 12,
      extrinsics: {eye: [2, 0, 1], target: [0, 0, 0.5]}, data_types: [color]}
"""


def info_of(root):
    return json.loads((root / "meta/info.json").read_text())


def test_an_action_has_names_units_and_a_frame_in_every_format(tmp_path):
    log, _ = record_task(tmp_path / "log.mcap", ["task=pick_place", *SHORT], 3)
    names = [f"tool/{axis}" for axis in ("x", "y", "z", "rx", "ry", "rz")] + ["gripper"]
    units = ["m"] * 3 + ["rad"] * 3 + [""]
    scales = [0.02] * 3 + [0.1] * 3
    for many in (True, False):
        if many:
            root = export_episodes(log, "lerobot", tmp_path / "many", failures=True)
        else:
            with recording.open(log) as opened:
                root = export(opened, "lerobot", tmp_path / "one")
        info = info_of(root)
        action = info["features"]["action"]
        assert (info["robot_type"], action["names"]) == ("ur10", names)
        assert action["info"]["rate_hz"] == 25.0
        columns = action["info"]["columns"]
        assert [column["unit"] for column in columns] == units
        assert [column["scale"] for column in columns[:6]] == scales
        assert [(c["mode"], c["reference"], c["frame"], c["centre"]) for c in columns[:6]] == [
            ("delta", "target", "base", 0.0)
        ] * 6
        assert (columns[6]["mode"], columns[6]["centre"]) == ("absolute", "below 0: 0; else 0.085")
        assert {(column["low"], column["high"]) for column in columns} == {(-1.0, 1.0)}
    with recording.open(log) as opened:
        table = export(opened, "hdf5", tmp_path / "log.hdf5")
        assert opened.columns["actions"][0].name == "tool/x"
        said = "Pick up a cube from a table and put it on a stand, with a gripper."
    for path in (table, export_episodes(log, "robomimic", tmp_path / "set.hdf5", failures=True)):
        with h5py.File(path) as file:
            demo = file["data/demo_0"]
            about = demo["actions"].attrs
            assert [list(about[key]) for key in ("names", "unit")] == [names, units]
            assert list(about["mode"]) == ["delta"] * 6 + ["absolute"]
            assert list(about["frame"]) == ["base"] * 6 + [""]
            assert about["scale"][:6].tolist() == scales and np.isnan(about["scale"][6])
            assert about["rate_hz"] == 25.0
            assert json.loads(demo.attrs["ep_meta"])["lang"] == demo.attrs["instruction"] == said
            args = json.loads(file["data"].attrs["env_args"])
            assert (args["control_freq"], args["lang"]) == (25.0, said)
            assert args["action"]["columns"][0]["name"] == "tool/x"


@pytest.mark.parametrize(
    ("control", "given", "mode", "reference", "centre", "scale", "unit"),
    [
        ("position", "home, scale: 0.6", "absolute", "", 1.57079, 0.6, "rad"),
        ("position", "target, scale: 0.2, offset: 0.1", "delta", "target", 0.1, 0.2, "rad"),
        ("position", "qpos, scale: 0.2", "delta", "qpos", 0.0, 0.2, "rad"),
        ("velocity", "zero, scale: 0.5", "absolute", "", 0.0, 0.5, "rad/s"),
        ("effort", "zero, scale: 30", "absolute", "", 0.0, 30.0, "N m"),
    ],
)
def test_what_joints_are_told(tmp_path, control, given, mode, reference, centre, scale, unit):
    params = f"of: {{uid: robot}}, control: {control}, centre: {given}"
    arm = f"{{func: joint_action, params: {{{params}}}}}"
    overrides = ["task=reach", *SHORT, "~task.expert", f"task.actions={{arm: {arm}}}"]
    log, _ = record_task(tmp_path / "log.mcap", overrides, 1)
    with recording.open(log) as opened:
        first = opened.header.action[0]
    assert first["quantity"] == f"joint {control}"
    found = [first[key] for key in ("name", "mode", "reference", "unit", "frame")]
    assert found == ["arm/Joint1", mode, reference, unit, ""]
    assert (first["centre"], first["scale"]) == pytest.approx((centre, scale))


def test_a_term_that_describes_other_columns_is_refused(monkeypatch):
    from embodichain import make
    from embodichain.lab.gym.envs.action_columns import action_columns
    from embodichain.lab.gym.envs.managers.term import ActionMeaning

    env = make("reach", num_envs=1)
    term = env.unwrapped.action_manager.terms["arm"].instance
    # No shipped term has this mistake.
    monkeypatch.setattr(term, "meaning", lambda: ActionMeaning(units=("rad", "rad")))
    with pytest.raises(ConfigError, match=r"actions\.arm\.func: says 2 of units for 6 columns"):
        action_columns(env.unwrapped)
    env.close()


def test_episodes_of_logs_have_their_own_instructions(tmp_path):
    logs = []
    for said in ("Go left.", "Go right."):
        path = tmp_path / f"{said[3:-1]}.mcap"
        record_task(path, ["task=reach", *SHORT, f"task.description={said}"], 3)
        logs.append(path)
    root = export_episodes(logs, "lerobot", tmp_path / "set", failures=True)
    rows = pq.read_table(root / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    assert [row["tasks"] for row in rows] == [["Go left."]] * 3 + [["Go right."]] * 3
    tasks = pq.read_table(root / "meta/tasks.parquet").to_pylist()
    assert tasks == [{"task_index": 0, "task": "Go left."}, {"task_index": 1, "task": "Go right."}]
    frames = pq.read_table(root / "data/chunk-000/file-000.parquet")
    assert frames["task_index"].to_pylist() == [0] * 9 + [1] * 9
    assert info_of(root)["total_tasks"] == 2
    path = export_episodes(logs, "robomimic", tmp_path / "set.hdf5", failures=True)
    with h5py.File(path) as file:
        said = [file[f"data/demo_{i}"].attrs["instruction"] for i in (0, 5)]
    assert said == ["Go left.", "Go right."]


def test_several_robots_are_named_by_their_files(tmp_path):
    log, _ = record_task(tmp_path / "log.mcap", ["task=hand_over", *SHORT], 1)
    with recording.open(log) as opened:
        info = info_of(export(opened, "lerobot", tmp_path / "set"))
    assert info["robot_type"] == "UR10+UR10"
    names = info["features"]["action"]["names"]
    assert (names[0], names[6], names[13]) == ("right_tool/x", "right_gripper", "left_gripper")


def observed(path, extra=()):
    sensors = " ".join(SENSORS.split())
    overrides = [
        "task=reach",
        *SHORT,
        f"+task.sensors={{{sensors.replace('} twins', '}, twins')}}}",
    ]
    return record_task(path, [*overrides, *extra], 3)[0]


def test_pictures_of_observed_sensors_are_in_data_sets(tmp_path, caplog):
    log = observed(tmp_path / "log.mcap")
    (episode, *_) = read_episodes(log, failures=True)
    root = export_episodes(log, "lerobot", tmp_path / "set", failures=True)
    images = {key: f["shape"] for key, f in info_of(root)["features"].items() if "images" in key}
    assert images == {
        "observation.images.eye": [24, 32, 3],
        "observation.images.twins": [12, 16, 3],
        "observation.images.twins_right": [12, 16, 3],
    }
    assert "eye/depth is left out" in caplog.text
    path = export_episodes(log, "robomimic", tmp_path / "set.hdf5", failures=True)
    with h5py.File(path) as file:
        obs, after = file["data/demo_0/obs"], file["data/demo_0/next_obs"]
        colours = episode.observations["sensor/eye/color"][..., :3]
        assert np.array_equal(obs["eye_image"], colours[:-1])
        assert np.array_equal(after["eye_image"], colours[1:])
        depth = episode.observations["sensor/eye/depth"][..., None]
        assert np.array_equal(obs["eye_depth"], depth[:-1])
        right = episode.observations["sensor/twins/color_right"][..., :3]
        assert np.array_equal(obs["twins_right_image"], right[:-1])


def test_two_names_that_would_be_one_are_refused(tmp_path):
    clash = "+task.sensors.twins_right={sensor_type: camera, observe: true, width: 32, height: 24}"
    log = observed(tmp_path / "log.mcap", [clash])
    said = "'twins/right' and 'twins_right' would both be"
    for form in ("lerobot", "robomimic"):
        with pytest.raises(ConfigError, match=said):
            export_episodes(log, form, tmp_path / "set", failures=True)
    with recording.open(log) as opened:
        for form in ("lerobot", "hdf5"):
            with pytest.raises(ConfigError, match=said):
                export(opened, form, tmp_path / "set")
    assert not (tmp_path / "set").exists()


def test_a_task_without_actions(tmp_path, caplog, monkeypatch):
    ball = "{ball: {shape: {shape_type: Sphere, radius: 0.1}, init_pos: [0, 0, 1]}}"
    term = "{place: {func: position, params: {of: {uid: ball}}}}"
    (tmp_path / "conf/task").mkdir(parents=True)
    text = f"description: A ball.\nmax_episode_steps: 3\nobjects: {ball}\nobservations: {term}\n"
    (tmp_path / "conf/task/ball.yaml").write_text(text)
    monkeypatch.chdir(tmp_path)
    log, _ = record_task(tmp_path / "log.mcap", ["task=ball"], 3)
    root = export_episodes(log, "lerobot", tmp_path / "set", failures=True)
    assert "action" not in info_of(root)["features"]
    assert "has no actions" in caplog.text
    with h5py.File(export_episodes(log, "robomimic", tmp_path / "a.hdf5", failures=True)) as file:
        assert file["data/demo_0/actions"].shape == (3, 0)


def test_the_model_of_a_demonstration_goes_into_mujoco_with_its_states(tmp_path):
    log, _ = record_task(tmp_path / "log.mcap", ["task=reach", *SHORT], 3)
    with recording.open(log) as opened:
        table = export(opened, "hdf5", tmp_path / "log.hdf5")
        model, rows = opened.model, opened.read(["qpos"])
        for path in (table, export_episodes(log, "robomimic", tmp_path / "a.hdf5", failures=True)):
            with h5py.File(path) as file:
                demo = file["data/demo_1"]
                files = {
                    name: file["assets"][name][()].tobytes() for name in demo.attrs["model_assets"]
                }
                there = mujoco.MjModel.from_xml_string(demo.attrs["model_file"], files)
                assert (there.nmesh, there.nq) == (model.nmesh, model.nq) and there.nmesh > 0
                names = list(demo["states"].attrs["names"])
                first = next(i for i, name in enumerate(names) if name.startswith("qpos/"))
                qpos = demo["states"][0, first : first + model.nq]
                env, step = int(demo.attrs["env"]), int(demo.attrs["first_step"])
            assert np.array_equal(qpos, rows["qpos"][step, env])
            places = []
            for one in (model, there):
                data = mujoco.MjData(one)
                data.qpos[:] = qpos
                mujoco.mj_kinematics(one, data)
                places.append(data.xpos)
            assert places[0] == pytest.approx(places[1], abs=1e-5)


def test_states_of_more_columns_than_an_attribute_of_old_files_holds(tmp_path):
    spec = mujoco.MjSpec()
    count = 330
    for i in range(count):
        body = spec.worldbody.add_body(name=f"ball_{i}", pos=[i, 0, 1])
        body.add_freejoint(name=f"ball_{i}/free")
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.1, 0, 0])
    for name in ("cube", "a", "b"):
        spec.worldbody.add_body(name=name)
    env = BallEnv(spec)
    recorder = McapRecorder(tmp_path / "log.mcap", env, "{}", [], None, "balls")
    env.add_observer(recorder)
    env.run()
    with recording.open(tmp_path / "log.mcap") as log, h5py.File(export(log, "hdf5")) as file:
        names = file["data/demo_0/states"].attrs["names"]
    assert len(names) == 1 + 13 * count
    assert names[-1] == f"qvel/ball_{count - 1}/free.wz"


class BallEnv(SmallEnv):
    """An environment of a spec of its own, without controls."""

    def __init__(self, spec):
        super().__init__(num_envs=1, model=spec.compile())
        self.sim.scene.spec = spec

    def run(self):
        self.sim.engine.forward()
        for observer in self.observers:
            observer.on_reset(self, np.arange(1))
        for _ in range(2):
            self.sim.engine.step(self.sim_steps_per_control)
            self._tell()
        self.close()

    def _tell(self):
        from embodichain.lab.gym.envs.observers import StepRecord

        self.count += 1
        no = np.zeros(1, bool)
        record = StepRecord(
            *(self.count, np.zeros((1, 0)), np.zeros(1, np.float32), no, no, {}, {}),
            np.zeros(1, np.int64),
        )
        for observer in self.observers:
            observer.on_step(self, record)
