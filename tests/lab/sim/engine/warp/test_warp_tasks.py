"""Whole tasks on MuJoCo Warp's CPU device, against MuJoCo: two, or all by `make test-warp`."""

import copy
import json
import os
import re
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch
import yaml

import embodichain
import embodichain.recording as recording
from embodichain.cli import main
from embodichain.config.composition.composed import list_options
from embodichain.config.environments.factory import with_warp_sizes
from embodichain.config.resolved import resolve
from embodichain.lab.sim.engine.warp import warp_worlds
from embodichain.recording import verify
from embodichain.recording.demos.reenactment import Reenactment
from embodichain.recording.read import simulation
from embodichain.utils.errors import ConfigError

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]

FEW = ["cart_pole", "quadruped_velocity"]
ALL = os.environ.get("EMBODICHAIN_TEST_WARP") == "all"
TASKS = list_options("task") if ALL else FEW
N, STEPS, EPISODE = 2, 40, 25
TIE = 1e-6
"""Metres: closer bodies touch or do not, by rounding."""


class Touching:
    """Notes which environments had geoms at distance 0 before physics, since their reset."""

    def __init__(self, engine):
        self.tied = np.zeros(N, bool)
        self.model = copy.copy(engine.model)
        self.model.geom_margin += TIE  # MuJoCo finds these too, just before they touch
        self.data = mujoco.MjData(self.model)
        mujoco.mj_setConst(self.model, self.data)

    def on_write(self, write):
        pass

    def on_physics(self, event):
        for i, row in enumerate(event.rows):
            mujoco.mj_setState(self.model, self.data, row, int(mujoco.mjtState.mjSTATE_INTEGRATION))
            mujoco.mj_fwdPosition(self.model, self.data)
            self.tied[i] |= bool((np.abs(self.data.contact.dist) < TIE).any())


def play(task, engine, steps, *overrides):
    lines = ["seed=3", f"sim.engine={engine}", "sim.num_threads=1", *overrides]
    if not any(line.startswith("sim.warp.arrays=") for line in lines):
        lines.append("sim.warp.arrays=host")
    env = embodichain.make(task, num_envs=N, overrides=lines)
    try:
        env.reset()
        sim, space, host = env.sim.engine, env.single_action_space, env.arrays.host
        touching = Touching(sim)
        if not env.arrays.on_device:
            sim.listeners.append(touching)
        rng = np.random.default_rng(5)
        low, high = np.maximum(space.low, -1), np.minimum(space.high, 1)
        played = {"start": sim.host_rows() if env.arrays.on_device else sim.rows.copy()}
        played["name"] = sim.name
        keys = ("qpos", "qvel", "obs", "reward", "done", "diverged", "success", "tied")
        found = {key: [] for key in keys}
        for _ in range(steps):
            action = rng.uniform(low, high, (N, *space.shape)).astype(np.float32)
            given = torch.from_numpy(action).to(env.device)
            obs, reward, terminated, truncated, info = env.step(given)
            done = (terminated | truncated).cpu().numpy().copy()
            found["tied"].append(touching.tied.copy())
            touching.tied[done] = False
            found["done"].append(done)
            found["obs"].append(host(obs.rows).copy())
            found["reward"].append(reward.cpu().numpy().copy())
            for key in ("diverged", "success"):
                found[key].append(info[key].cpu().numpy().copy())
            for key in ("qpos", "qvel"):
                found[key].append(host(sim.state(key)).copy())
        fields = sim.model_fields()
    finally:
        env.close()
    return played | {key: np.array(values) for key, values in found.items()} | {"fields": fields}


@pytest.mark.parametrize("task", TASKS)
def test_a_task_is_the_same_on_both_engines(task):
    """Forty control steps with resets between them, from the same draws."""
    cap = f"task.max_episode_steps={EPISODE}"
    cpu = play(task, "mujoco", STEPS, cap)
    warp = play(task, "warp", STEPS, cap, "sim.warp.nconmax=256", "sim.warp.njmax=512")
    assert (cpu["name"], warp["name"][:12]) == ("mujoco", "mujoco_warp ")
    np.testing.assert_array_equal(warp["done"], cpu["done"])
    assert cpu["done"].any() and not warp["diverged"].any()
    # Resets that read poses begin from poses in float32.
    np.testing.assert_allclose(warp["start"], cpu["start"], rtol=0, atol=1e-6)
    clear = ~(cpu["tied"] | warp["tied"])
    for key, bound in (("qpos", 1e-5), ("qvel", 1e-3), ("reward", 1e-4)):
        error = np.abs(warp[key] - cpu[key]).reshape(STEPS, N, -1).max(axis=-1, initial=0)
        assert error[clear].max(initial=0) < bound, key
        assert np.isfinite(error).all()


@pytest.mark.parametrize("task", TASKS)
def test_a_task_is_the_same_with_arrays_on_the_device(task):
    """The same engine and draws; terms compute in float32 instead of float64."""
    lines = (f"task.max_episode_steps={EPISODE}", "sim.warp.nconmax=256", "sim.warp.njmax=512")
    host = play(task, "warp", STEPS, *lines)
    device = play(task, "warp", STEPS, *lines, "sim.warp.arrays=device")
    for key in ("done", "diverged", "success"):
        np.testing.assert_array_equal(device[key], host[key])
    assert host["done"].any() and not host["diverged"].any()
    np.testing.assert_allclose(device["start"], host["start"], rtol=0, atol=1e-6)
    for key, bound in (("qpos", 1e-5), ("qvel", 1e-4), ("obs", 1e-4), ("reward", 1e-5)):
        scale = max(1.0, np.abs(host[key]).max())
        np.testing.assert_allclose(device[key], host[key], rtol=0, atol=bound * scale, err_msg=key)
    assert host["qvel"].any() and host["obs"].any()


def test_what_events_draw_is_the_same_to_the_bit():
    of = "func: randomize, mode: reset, params: {of: {uid: cart_pole}"
    draws = (
        f"+task.events.mass={{{of}, mass: [0.8, 1.2], operation: scale}}}}",
        f"+task.events.damping={{{of}, joint_damping: [0.1, 0.4]}}}}",
        "+task.events.fall={func: randomize, mode: reset, "
        "params: {gravity: [[0, 0, -1], [0, 0, 1]]}}",
    )
    cap = ("task.max_episode_steps=3", *draws)
    cpu = play("cart_pole", "mujoco", 6, *cap)
    warp = play("cart_pole", "warp", 6, *cap, "sim.warp.nconmax=16", "sim.warp.njmax=16")
    np.testing.assert_array_equal(warp["start"], cpu["start"])
    assert {"body_mass", "body_invweight0", "dof_damping", "opt.gravity"} <= cpu["fields"].keys()
    for name, values in cpu["fields"].items():
        np.testing.assert_array_equal(warp["fields"][name], values)
        assert name != "body_mass" or (values[0] != values[1]).any()
    np.testing.assert_allclose(warp["qpos"], cpu["qpos"], atol=1e-5)


def test_memory_is_measured_once_and_written_into_the_config():
    resolved = resolve(["task=cart_pole", "sim.engine=warp", "sim.warp.njmax=48", "seed=1"])
    asked = {"nconmax": None, "njmax": 48, "arrays": "auto"}
    assert dict(resolved.tree["sim"]["warp"]) == asked
    sized = with_warp_sizes(resolved)
    assert dict(sized.tree["sim"]["warp"]) == {**asked, "nconmax": 16}
    assert with_warp_sizes(sized) is sized
    plain = resolve(["task=cart_pole"])
    assert with_warp_sizes(plain) is plain and plain.tree["sim"]["engine"] == "mujoco"


def test_environments_that_diverge_while_memory_is_measured_are_one_warning(caplog, monkeypatch):
    """A UR10 without a base, which its drives toss about; what is counted is tested above."""
    counted = {"nconmax": 16, "njmax": 48}
    # Measuring takes seconds, and is tested above.
    monkeypatch.setattr(warp_worlds, "measured_sizes", lambda model, states: counted)
    free = ["++task.robot.fix_base=false", "seed=1", "sim.engine=warp"]
    sized = with_warp_sizes(resolve(["task=random_reach", *free]))
    assert counted.items() <= dict(sized.tree["sim"]["warp"]).items()
    (told,) = [r.getMessage() for r in caplog.records if r.levelname == "WARNING"]
    assert re.search(r"sim\.warp: [1-8] of 8 environments diverged in 64 control steps", told)
    assert "sim.warp.nconmax and sim.warp.njmax" in told


def told(capsys, *words):
    assert main(list(words)) == 0
    return capsys.readouterr().out


def test_a_run_and_its_log(capsys, monkeypatch):
    """The states of a log are those of the engine; its physics is close to MuJoCo's."""
    lines = ("task=cart_pole", "sim.engine=warp", "num_envs=2", "max_steps=12", "seed=4")
    lines += ("sim.warp.arrays=host", "episodes=9")
    told(capsys, "run", *lines, "task.max_episode_steps=5", "scene_png=false")
    folder = Path("outputs/latest")
    config = yaml.safe_load((folder / "config.yaml").read_text())
    assert config["sim"]["warp"] == {"nconmax": 16, "njmax": 16, "arrays": "host"}
    with recording.open(folder) as log:
        assert log.header.engine.startswith("mujoco_warp 4.")
        model, data = log.model, log.read(["qpos"])["qpos"]
    assert data.shape == (12, 2, model.nq)
    # Physics was float32; a simulation on the CPU in float64 gives other bits.
    assert (data[1:4].astype(np.float32) == data[1:4]).all()
    report = verify(folder)
    assert report.ok and (report.measured, report.outside) == (24, 0)
    assert 0 < report.largest_error["qvel"] < 1e-5
    assert "writes and resets are identical to the bit" in str(report)
    listed = told(capsys, "replay", str(folder))
    assert "mujoco_warp" in listed and "within a tolerance" in listed
    with pytest.raises(ConfigError, match="pictures of mujoco_warp 4"):
        verify(folder, images=True)
    monkeypatch.setitem(simulation.TOLERANCE, "qvel", 1e-12)
    strict = verify(folder)
    assert not strict.ok and "results of physics are not MuJoCo's" in str(strict)


def test_a_training_with_arrays_on_the_device_and_its_evaluation(capsys):
    """An evaluation is logged from the device, too. Resuming continues there."""
    sizes = ("sim.warp.nconmax=16", "sim.warp.njmax=16", "num_envs=2", "algo.n_steps=32")
    lines = (*sizes, "task.max_episode_steps=9", "eval.episodes=2", "seed=4", "algo.batch_size=32")
    told(capsys, "train", "task=cart_pole", "sim.engine=warp", *lines, "total_timesteps=64")
    told(capsys, "train", "resume=outputs/latest", "total_timesteps=128")
    folders = sorted(path.parent for path in Path("outputs").glob("*/*/summary.json"))
    assert len(folders) == 2
    for folder in folders:
        config = yaml.safe_load((folder / "config.yaml").read_text())
        assert config["sim"]["warp"]["arrays"] == "device"
        with recording.open(folder) as log:
            assert log.header.engine.startswith("mujoco_warp 4.")
            assert (log.header.writes, len(log.episodes)) == ("none", 2)
    report = json.loads(told(capsys, "eval", "outputs/latest", "episodes=2", "--json"))
    assert report["episodes"] == 2
    config = yaml.safe_load(Path("outputs/latest/config.yaml").read_text())
    assert config["sim"]["warp"]["arrays"] == "device"


def test_a_run_with_arrays_on_the_device_and_its_log(capsys):
    """All that reads logs reads it; what draws again draws with arrays of the host."""
    lines = ("task=cart_pole", "sim.engine=warp", "num_envs=2", "episodes=2", "seed=4")
    sizes = ("sim.warp.nconmax=16", "sim.warp.njmax=16", "task.max_episode_steps=5")
    report = json.loads(told(capsys, "run", *lines, *sizes, "scene_png=false", "--json"))
    assert (report["status"], report["episodes"]) == ("finished", 4)
    folder = str(Path("outputs/latest").resolve())
    config = yaml.safe_load(Path(folder, "config.yaml").read_text())
    assert config["sim"]["warp"]["arrays"] == "device"
    listed = " ".join(told(capsys, "replay", folder).split())
    assert "within a tolerance; resets and events are not in the log" in listed
    assert "verified: 10 steps of 2 environments" in told(capsys, "replay", folder, "--verify")
    told(capsys, "export", folder, "--format", "csv", "-o", "log.csv")
    assert len(Path("log.csv").read_text().splitlines()) == 1 + 10 * 2
    told(capsys, "recover", str(Path(folder, "rollout.mcap")), "again.mcap")
    assert "the same: 10 control steps" in told(capsys, "diff", folder, "again.mcap")
    again = json.loads(told(capsys, "replay", folder, "--policy", "zero", "--json"))
    assert again["same_start"] and again["episodes"] == 4
    with recording.open(folder) as log, Reenactment(log) as play:
        actions = log.read(["actions"])["actions"]
        steps = list(play.steps())
        assert not play.env.arrays.on_device and len(steps) == 10
        for step in steps:
            np.testing.assert_array_equal(step.action, actions[step.number])
            found = step.seen["robot"]["qpos"].numpy()
            assert np.isfinite(found).all() and found.shape == (2, 2)
