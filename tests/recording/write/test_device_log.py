"""Logs of arrays on a device: states instead of writes, read as any other log."""

import numpy as np
import pytest
import torch

import embodichain
import embodichain.recording as recording
from embodichain.recording import McapRecorder, RecordOptions, verify
from embodichain.recording.format.log_error import LogError
from embodichain.recording.format.messages.block import pack_steps, unpack_steps
from embodichain.recording.read.playback import Playback, span_of
from tests.helpers.warp_scene import RANDOMIZED
from tests.recording.rewrite import rewrite

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]

N, STEPS = 4, 18
UNCHECKED = "the log has states, not writes: resets and events are not checked"


def recorded(path, arrays, options=None):
    """Record a run, with a reset of one environment and a write between steps."""
    rng = np.random.default_rng(0)
    with embodichain.make("cart_pole", N, [*RANDOMIZED, f"sim.warp.arrays={arrays}"]) as env:
        env.add_observer(McapRecorder(path, env, task="cart_pole", options=options))
        env.reset()
        for step in range(STEPS):
            if step == 4:
                env.reset(options={"reset_ids": [1]})
            if step == 9:
                env.robot.set_qpos(np.full((1, 2), 0.05), env_ids=[2], target=False)
            action = rng.uniform(-1, 1, (N, 1)).astype(np.float32)
            env.step(torch.from_numpy(action).to(env.device))
    return path


@pytest.fixture(scope="module")
def device(tmp_path_factory):
    return recorded(tmp_path_factory.mktemp("device") / "log.mcap", "device")


@pytest.fixture(scope="module")
def host(tmp_path_factory):
    return recorded(tmp_path_factory.mktemp("host") / "log.mcap", "host")


def test_what_is_flushed_and_closed_has_every_step(tmp_path):
    """Also the steps whose copies are on their way."""
    path = tmp_path / "log.mcap"
    lines = [line for line in RANDOMIZED if not line.startswith("+")]
    with embodichain.make("cart_pole", N, [*lines, "sim.warp.arrays=device"]) as env:
        recorder = McapRecorder(path, env)
        env.add_observer(recorder)
        env.reset()
        zero = torch.zeros(N, 1, device=env.device)
        for count in (5, 6):
            while recorder.stats.steps < count:
                env.step(zero)
                recorder.flush()
            with recording.open(path) as log:
                assert len(log.read(["qpos"])) == count
        env.step(zero)
        recorder.close()
        assert verify(path).steps == env.control_step == 7


def test_it_reads_as_a_log_of_the_host(device, host):
    with recording.open(device) as a, recording.open(host) as b:
        assert (a.header.writes, b.header.writes) == ("none", "all")
        assert a.complete and a.warnings == []
        ours, theirs = a.read(), b.read()
        assert list(ours) == list(theirs) and len(ours) == STEPS
        for name in ours:
            np.testing.assert_allclose(ours[name], theirs[name], atol=1e-6, err_msg=name)
        # The states are those of the device: float32, kept exactly.
        assert (ours["qpos"].astype(np.float32) == ours["qpos"]).all()
        pairs = list(zip(a.episodes, b.episodes, strict=True))
        assert len(pairs) > 2 * N
        for one, other in pairs:
            for key in ("env", "episode", "first_step", "last_step", "truncated", "reasons"):
                assert getattr(one, key) == getattr(other, key)
            assert one.total_reward == pytest.approx(other.total_reward, rel=1e-6)
            assert one.metrics == other.metrics
        events = [
            [(e.step, e.term, e.mode, str(e.env_ids)) for e in log.events()] for log in (a, b)
        ]
        assert events[0] == events[1]
        assert [list(map(len, a.metrics(0)[1].values()))] == [
            list(map(len, b.metrics(0)[1].values()))
        ]
        topics = [{c.topic for c in log.reader.channels.values()} for log in (a, b)]
        assert topics[0] == topics[1] and "/env_0/scene" in topics[0]
        fields = {write.field for write in a.writes() if write.op == "model"}
        assert fields == {"body_mass", "body_inertia", "dof_damping", "opt.gravity"}


def test_an_environment_is_played_with_its_model(device, host):
    names = "body_mass", "body_inertia", "dof_damping", "body_invweight0", "dof_invweight0"
    masses = set()
    with recording.open(device) as a, recording.open(host) as b:
        one, other = (Playback(log, 2) for log in (a, b))
        steps = zip(*(p.steps(span_of(p.log, 2)) for p in (one, other)), strict=True)
        for step, same in steps:
            assert step == same
            models = one.engine.model_of(0), other.engine.model_of(0)
            for name in names:
                ours, theirs = (getattr(model, name) for model in models)
                np.testing.assert_allclose(ours, theirs, rtol=1e-5, err_msg=name)
            np.testing.assert_allclose(models[0].opt.gravity, models[1].opt.gravity, atol=1e-6)
            masses.add(models[0].body_mass.sum())
    assert len(masses) == 3  # as many as episodes


def test_verify_checks_physics_and_says_what_it_cannot(device):
    report = verify(device)
    assert report.ok and (report.measured, report.outside) == (N * STEPS, 0)
    assert 0 < report.largest_error["qvel"] < 1e-5
    assert UNCHECKED in str(report) and "identical to the bit" not in str(report)
    assert verify(device, env=2, episode=1).ok


def altered(data, kind, change):
    """A message of steps in which the arrays of calls of a kind are others."""
    runs = unpack_steps(data, N, *SIZES)
    steps = []
    for run in runs:
        for t in range(run.count):
            calls = []
            for call in run.calls:
                arrays = tuple(values[t].copy() for values in call.arrays.values())
                if call.kind.kind == kind:
                    change(dict(zip(call.arrays, arrays, strict=True)))
                calls.append((call.kind, arrays))
            steps.append(calls)
    return b"".join(bytes(part) for part in pack_steps(runs[0].first, steps))


SIZES = [0, 0]
CHANGES = {
    "physics": lambda arrays: arrays["rows"].__iadd__(0.01),
    "write": lambda arrays: arrays["values"].__iadd__(0.5) if "values" in arrays else None,
}


@pytest.mark.parametrize("kind", CHANGES)
def test_other_states_are_not_verified(device, tmp_path, kind):
    """With checksums that fit: results of physics, or what was written before it."""
    with recording.open(device) as log:
        SIZES[:] = log.header.moved_width, log.header.nstate

    def message(topic, data):
        return altered(data, kind, CHANGES[kind]) if topic == "/sim/steps" else data

    report = verify(rewrite(device, tmp_path / "changed.mcap", message=message))
    assert not report.ok and report.outside > 0.05 * report.measured
    assert "of the results of physics are not MuJoCo's; at most 5% are expected" in str(report)


def test_an_unknown_kind_of_log_is_refused(device, tmp_path):
    def metadata(name, values):
        return values | {"writes": "some"} if name == "embodichain" else values

    changed = rewrite(device, tmp_path / "changed.mcap", metadata=metadata)
    with pytest.raises(LogError, match="impossible values of writes"):
        verify(changed)


def test_options_are_those_of_other_logs(tmp_path):
    """After each gap the log continues with the states and model fields of that moment."""
    options = RecordOptions(every=2, view_envs=[1], compression="none")
    path = recorded(tmp_path / "log.mcap", "device", options)
    report = verify(path)
    assert report.ok and 0 < report.steps < STEPS
    assert any("only one in 2 episodes of environment 1" in note for note in report.notes)


def test_a_recorded_moment_is_restored(device):
    """In MuJoCo, from float32: with the recorded action the recorded state follows."""
    with recording.open(device) as log:
        data, mine = log.read(), [e for e in log.episodes if e.env == 1]
        lines = [line for line in RANDOMIZED if not line.startswith(("sim.", "device="))]
        with embodichain.make("cart_pole", 2, lines) as env:
            for episode, step in ((0, 0), (1, 0), (1, 2)):
                env.restore(log, env=1, episode=episode, step=step)
                at = mine[episode].first_step + step
                np.testing.assert_array_equal(env.sim.engine.state("qpos")[1], data["qpos"][at, 1])
                action = np.repeat(data["actions"][at, 1][None], 2, axis=0)
                env.step(torch.from_numpy(action))
                found = env.sim.engine.state("qpos")[1]
                np.testing.assert_allclose(found, data["qpos"][at + 1, 1], atol=1e-6)
