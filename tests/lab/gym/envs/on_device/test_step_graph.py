"""Steps as CUDA graphs: against steps that are launched one by one.

Without a GPU the capture is tried on the CPU, where it runs at once, and nothing is replayed.
"""

import contextlib
import logging
import re

import numpy as np
import pytest
import torch

import embodichain
import embodichain.recording as recording
from embodichain.lab.gym.envs.managers.term import Term
from embodichain.lab.gym.envs.on_device import kept_arrays as walk
from embodichain.lab.gym.envs.on_device.step_graph import StepGraph
from embodichain.lab.sim.engine.device.device_array import DeviceArray
from embodichain.lab.sim.engine.device.packed_arrays import ArrayPacker, HostBuffers
from embodichain.recording import McapRecorder
from tests.helpers.warp_scene import DEVICE

pytestmark = pytest.mark.slow

N = 3
LINES = (
    *(f"device={DEVICE}", "sim.engine=warp", "sim.warp.arrays=device", "sim.num_threads=1"),
    *("sim.warp.nconmax=64", "sim.warp.njmax=200", "seed=3", "task.max_episode_steps=6"),
)
TASKS = ["cart_pole", "quadruped_velocity"]


class NothingToReplay:
    """Stands for `torch.cuda.CUDAGraph`: the launches that it should capture ran at once."""

    def replay(self):
        pass


@pytest.fixture(autouse=DEVICE == "cpu")
def captured_at_once(monkeypatch):
    nothing = lambda *args, **kwargs: contextlib.nullcontext()  # noqa: E731
    monkeypatch.setattr(torch.cuda, "CUDAGraph", NothingToReplay)
    monkeypatch.setattr(torch.cuda, "graph", nothing)
    monkeypatch.setattr(torch.cuda, "synchronize", lambda: None)


def captured(graph):
    """The CUDA graph; None while kernels are launched one by one, with the same results."""
    # Results do not tell whether a step was captured, and nothing else reads it.
    return graph._graph


@contextlib.contextmanager
def made(task, *lines):
    """An environment that steps by graph, and one that launches all kernels."""
    both = [embodichain.make(task, N, [*LINES, *lines]) for _ in range(2)]
    try:
        for env in both:
            env.reset()
            # An environment captures its steps on CUDA alone; here one of two does, on any device.
            env._graph = None
        graph = both[0]._graph = StepGraph(both[0])
        if DEVICE == "cpu":
            # The CPU's engine captures nothing: it has to believe that it does.
            engine = graph._engine
            vars(engine)["capturing"] = lambda: contextlib.nullcontext(engine._mark(None))
        yield *both, graph
    finally:
        for env in both:
            env.close()


def actions(env, steps):
    rng, space = np.random.default_rng(0), env.single_action_space
    drawn = rng.uniform(space.low, space.high, (steps, N, *space.shape)).astype(np.float32)
    return torch.from_numpy(drawn).to(env.device)


def same(a, b):
    loose = 0.0 if DEVICE == "cpu" else 1e-3
    np.testing.assert_allclose(a.cpu(), b.cpu(), rtol=loose, atol=loose)


STEPS = 4 if DEVICE == "cpu" else 30
"""The fourth is captured."""


@pytest.mark.parametrize("task", TASKS)
def test_captured_steps_are_as_others(task):
    with made(task) as (one, other, graph):
        for action in actions(one, STEPS):
            (obs, *numbers, info), (obs2, *numbers2, info2) = one.step(action), other.step(action)
            same(torch.as_tensor(obs.rows.tensor), torch.as_tensor(obs2.rows.tensor))
            for found, wanted in zip(numbers, numbers2, strict=True):
                same(found, wanted)
            # A learner reads them, which must not make them part of the state.
            for group in ("rewards", "episode_sums"):
                assert list(info[group]) == list(info2[group])
                for name, values in info[group].items():
                    same(values, info2[group][name])
            for name, values in one.termination_manager.values.items():
                same(values.float(), other.termination_manager.values[name].float())
        assert graph.reason == "" and captured(graph) is not None
        assert one.control_step == other.control_step == STEPS
        same(one.elapsed_steps, other.elapsed_steps)


CAMERA = "sensor_type: camera, width: 24, height: 16, fovy: 60, extrinsics: {eye: [0, -3, 1], "
PICTURES = (
    f"+task.sensors.eye={{{CAMERA} target: [0, 0, 0.5]}}, data_types: [color, depth]}}",
    f"+task.sensors.slow={{{CAMERA} target: [0, 0, 1]}}, rate: 20, observe: true}}",
    "+task.observations.eye={func: camera_image, params: {sensor: eye}, delay: 1, noise: {std: 3}}",
    "+task.observations.depth={func: camera_image, params: {sensor: eye, channels: depth}}",
    "+task.events.eye={func: randomize_camera_pose, mode: reset, params: {camera: eye, "
    "position_range: [[-1, 0, 0], [1, 0, 0]]}}",
)


def test_pictures_are_drawn_in_captured_steps():
    """A camera with a rate keeps its picture, one with a delay its last; a learner keeps all."""
    pictures = (("eye",), ("depth",), ("sensor", "slow", "color"))
    earlier = []
    with made("cart_pole", *PICTURES) as (one, other, graph):
        for action in actions(one, STEPS):
            obs, obs2 = one.step(action)[0], other.step(action)[0]
            for path in pictures:
                same(obs[path].float(), obs2[path].float())
            earlier.append((obs, {path: obs[path].clone() for path in pictures}))
        assert graph.reason == "" and captured(graph) is not None
        for obs, images in earlier:
            for path, image in images.items():
                assert torch.equal(obs[path], image)
        addresses = {obs["depth"].data_ptr() for obs, _ in earlier}
        assert len(addresses) == STEPS
        # What a captured step keeps is seen only if it is missing: as memory that is used again.
        assert any("_readings" in path for path in graph._kept)
        assert obs["depth"].shape == (N, 1, 16, 24) and (obs["depth"] > 0).any()
        assert len({image.tobytes() for image in obs["depth"].cpu().numpy()}) == N


def test_what_is_kept_stays_at_its_address():
    with made("cart_pole") as (one, _, graph):
        for action in actions(one, 4):
            one.step(action)
        # Of the arrays that a captured step writes to, by their paths from the environment.
        assert any(path[-1] == "_sums" for path in graph._kept)
        kept = dict(graph._kept)
        one.reset()
        assert one.arrays_moved
        places = graph._places()[0]
        moved = [path for path, array in kept.items() if places[path].get() is not array]
        assert moved
        wanted = {path: torch.clone(_tensor(places[path].get())) for path in kept}
        assert graph._make_valid(one.arrays_moved)
        places = graph._places()[0]
        for path, array in kept.items():
            assert places[path].get() is array
            assert torch.equal(_tensor(array), wanted[path])
        one.step(action)
        assert not one.arrays_moved


def _tensor(value):
    return value.tensor if isinstance(value, DeviceArray) else value


class Inside:
    """Stands for `torch.cuda.graph`: knows whether a step is being captured."""

    on = False

    def __enter__(self):
        Inside.on = True

    def __exit__(self, *error):
        Inside.on = False


def test_a_log_is_gathered_in_the_captured_step_and_copied_after_it(tmp_path, monkeypatch):
    packed, sent = [], []
    for cls, name, into in ((ArrayPacker, "pack", packed), (HostBuffers, "send", sent)):
        before = getattr(cls, name)
        noted = lambda *args, b=before, i=into: (i.append(Inside.on), b(*args))[1]  # noqa: E731
        monkeypatch.setattr(cls, name, noted)
    if DEVICE == "cpu":
        monkeypatch.setattr(torch.cuda, "graph", lambda *args, **kwargs: Inside())
    with made("cart_pole") as (one, other, graph):
        for env, name in ((one, "one"), (other, "other")):
            env.add_observer(McapRecorder(tmp_path / f"{name}.mcap", env))
            env.reset()
        packed.clear()
        sent.clear()
        for action in actions(one, STEPS):
            one.step(action)
            other.step(action)
        assert graph.reason == "" and captured(graph) is not None
        assert len(sent) == 2 * STEPS and not any(sent)
        if DEVICE == "cpu":  # the fourth step of the first environment
            assert packed == [False] * 6 + [True, False]
    if DEVICE == "cpu":
        assert recording.diff(tmp_path / "one.mcap", tmp_path / "other.mcap").same
    assert recording.verify(tmp_path / "one.mcap").ok


def test_other_weights_are_captured_anew():
    with made("cart_pole") as (one, _, graph):
        steps = actions(one, 7)
        for action in steps[:4]:
            one.step(action)
        first = captured(graph)
        name = next(iter(one.reward_manager.weights))
        one.reward_manager.set_weight(name, 3.0)
        for action in steps[4:6]:  # one to check the terms again, one that is observed
            one.step(action)
            assert captured(graph) is None
        one.step(steps[6])
        assert graph.reason == ""
        assert captured(graph) not in (None, first)


def test_what_code_outside_of_steps_writes_counts():
    """A state is in the graph's own arrays; a number of the host makes it out of date."""
    with made("reach") as (one, _, graph):
        steps = actions(one, 8)
        for action in steps[:4]:
            one.step(action)
        first = captured(graph)
        one.robot.set_qpos(np.zeros((N, 6), np.float32), target=False)
        one.step(steps[4])
        assert captured(graph) is first
        one.robot.set_joint_drive(max_velocity=np.full((N, 6), 0.5))
        one.step(steps[5])
        assert captured(graph) is None


class Counting(Term):
    """Counts its calls on the host."""

    def __init__(self, env):
        self.calls = 0

    def __call__(self, env, obs, action, info):
        self.calls += 1
        return env.arrays.full(env.num_envs, float(self.calls))


class Growing(Term):
    """Keeps all earlier values, in an array that grows."""

    def __init__(self, env):
        self.values = env.arrays.full((env.num_envs, 1), 0.0)

    def __call__(self, env, obs, action, info):
        self.values = np.concatenate([self.values, self.values[:, :1] + 1.0], axis=1)
        return self.values.sum(axis=1)


@pytest.mark.parametrize(
    ("term", "reason"),
    [(Counting, r"changes .*calls, which is on the host"), (Growing, r"changes .*values from")],
)
def test_what_cannot_be_captured_is_launched(term, reason, caplog):
    """A number of the host, or an array of another shape, would be that of the captured step."""
    line = f"+task.rewards.own={{func: '{__name__}:{term.__name__}', weight: 1.0}}"
    with made("cart_pole", line) as (one, other, graph):
        caplog.set_level(logging.WARNING)
        for action in actions(one, 6):
            same(one.step(action)[1], other.step(action)[1])
        assert captured(graph) is None and one.control_step == 6
        assert caplog.text.count("steps are not captured as a CUDA graph") == 1
        assert re.search(reason, graph.reason)


class Node:
    __slots__ = ("left", "right")

    def __init__(self, left, right):
        self.left, self.right = left, right


def test_every_place_is_found_and_can_be_set():
    arrays = [DeviceArray(torch.full((2,), float(i))) for i in range(6)]
    shared = {"a": arrays[0], "b": [arrays[1], (arrays[2], 5)]}
    closure = lambda: shared  # noqa: E731
    root = Node(closure, {"again": shared, "deep": Node(arrays[3], (1.5, np.arange(3)))})
    places, numbers = walk.kept_arrays(root)
    held = {id(place.get()) for place in places.values()}
    assert held == {id(array) for array in arrays[:4]}
    assert 5 in numbers.values() and np.arange(3).tobytes() in numbers.values()
    for place in places.values():
        place.set(arrays[5])
    assert shared["a"] is shared["b"][0] is shared["b"][1][0] is arrays[5]
    assert root.right["deep"].left is arrays[5] and shared["b"][1][1] == 5
    assert walk.kept_arrays(root, (Node,)) == ({}, {})


def looks(env, obs, action, info):
    """A metric of EmbodiChain's signature: it takes the observation, which is made before it."""
    return obs["robot"]["qpos"][:, 0]


def test_steps_that_observe_before_judging_are_captured():
    """After pushes and new commands they observe once more, with the same noise."""
    mine = "+task.metrics.mine={func: 'tests.lab.gym.envs.on_device.test_step_graph:looks'}"
    with made("quadruped_velocity", mine) as (one, other, graph):
        # Both make a step observe once more: without them the test would try nothing.
        assert one._judge.obs_is_needed and one.command_manager.acts_in_steps
        for action in actions(one, STEPS):
            (obs, *_, info), (obs2, *_, info2) = one.step(action), other.step(action)
            same(torch.as_tensor(obs.rows.tensor), torch.as_tensor(obs2.rows.tensor))
            same(info["metrics"]["mine"], info2["metrics"]["mine"])
        assert graph.reason == "" and captured(graph) is not None
