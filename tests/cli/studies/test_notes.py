"""Notes come once a command, whatever the number of its jobs, stages and evaluations."""

import logging
from pathlib import Path

import pytest

from embodichain.cli import main
from embodichain.utils.notes import forget_shown, is_new, shared_by_jobs, warn_once

LAMP = """\
<mujoco>
  <option timestep="0.01"/>
  <worldbody>
    <light pos="0 0 3"/>
    <body name="pole" pos="0 0 1">
      <joint name="hinge" type="hinge" axis="0 1 0" damping="0.1"/>
      <geom type="capsule" size="0.02" fromto="0 0 0 0 0 0.3" mass="0.2"/>
    </body>
  </worldbody>
  <actuator><motor joint="hinge" ctrlrange="-1 1"/></actuator>
</mujoco>
"""
TASK = """\
description: Hold a pole that hangs, of a file with a lamp of its own.
physics: {physics_dt: 0.01}
max_episode_steps: 8
robot: {uid: pole, fpath: lamp.xml, fix_base: true}
actions:
  torque: {func: joint_effort, params: {of: {uid: pole}}}
observations:
  qpos: {func: joint_position, params: {of: {uid: pole}}}
rewards:
  still: {func: joint_position, shape: l2, weight: -1, params: {of: {uid: pole}}}
suggested:
  train:
    num_envs: 4
    total_timesteps: 64
    algo:
      name: ppo
      n_steps: 8
      batch_size: 16
      n_epochs: 1
"""
STUDY = """\
tasks: [lamp]
seeds: [0, 1]
arms: {ppo: []}
evaluate:
  episodes: 2
  variations:
    clean: {}
    noisy: {noise: 1.0}
compare: {metrics: [return]}
"""


@pytest.mark.slow
def test_a_study_says_each_note_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for folder, text in (("task", TASK), ("study", STUDY)):
        file = tmp_path / "conf" / folder / "lamp.yaml"
        file.parent.mkdir(parents=True)
        file.write_text(text)
    (tmp_path / "lamp.xml").write_text(LAMP)
    assert main(["study", "lamp", "hydra/launcher=basic"]) == 0
    err = capsys.readouterr().err
    assert err.count("lights left out: 'unnamed'") == 1
    assert err.count("variations change what was in training") == 1
    assert err.count("2 updates in all") == 1
    line = 1 + TASK[: TASK.index("      n_steps")].count("\n")
    assert f"conf/task/lamp.yaml:{line}: algo.n_steps: 2 updates in all" in err
    assert "changed since training" not in err

    assert main(["verify", "outputs/studies/lamp", "--all", "--quiet"]) == 0
    err = capsys.readouterr().err
    assert err.count("lights left out") == 1
    assert "training" not in err


def test_processes_of_one_command_share_what_was_shown(caplog: pytest.LogCaptureFixture) -> None:
    log = logging.getLogger("embodichain.test_notes")
    warn_once(log, "a note")
    warn_once(log, "of b: the same", key="the same")
    warn_once(log, "of c: the same", key="the same")
    log.warning("a note")
    note, of_b, of_c, plain = caplog.records
    with shared_by_jobs():
        forget_shown()  # as in a new process
        assert [is_new(record) for record in (note, note, of_b, of_c)] == [True, False, True, False]
        forget_shown()  # another process of the same command
        assert [is_new(record) for record in (note, of_c, plain, plain)] == [
            False,
            False,
            True,
            True,
        ]
    forget_shown()
    assert is_new(note)
