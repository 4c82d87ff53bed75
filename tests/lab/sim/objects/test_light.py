"""Lights: moved, tinted and dimmed in each environment by itself."""

import numpy as np
import pytest
import torch

from embodichain.lab.sim import SimulationManager, SimulationManagerCfg
from embodichain.lab.sim.cfg import LightCfg, RigidObjectCfg
from embodichain.lab.sim.objects import Light


@pytest.fixture
def sim():
    manager = SimulationManager(SimulationManagerCfg(headless=True, num_envs=4))
    manager.add_rigid_object(RigidObjectCfg(uid="box"))
    yield manager
    manager.destroy()


@pytest.fixture
def lamp(sim):
    values = {"light_type": "point", "color": [0.1, 0.2, 0.3], "radius": 10.0}
    return sim.add_light(LightCfg.from_dict({"uid": "lamp", "init_pos": [0, 0, 2.0], **values}))


def shown(sim, field):
    light = int(sim.engine.model.light("lamp").id)
    return sim.engine.model_field(field)[:, 3 * light : 3 * light + 3]


def test_adding_one_returns_its_handle(sim, lamp):
    assert isinstance(lamp, Light) and sim.get_light("lamp") is lamp
    assert sim.get_light_uid_list() == ["lamp"] and sim.get_light("sun") is None
    assert lamp.num_instances == 4 and lamp.cfg.radius == 10.0
    assert lamp.get_local_pose().tolist() == [[0.0, 0.0, 2.0]] * 4
    np.testing.assert_allclose(shown(sim, "light_diffuse"), [[0.1, 0.2, 0.3]] * 4, atol=1e-6)


def test_colour_and_intensity_of_some_environments(sim, lamp):
    lamp.set_color(torch.tensor([0.5, 0.5, 0.5]))
    lamp.set_color(torch.tensor([0.9, 0.8, 0.7]), env_ids=[1, 3])
    lamp.set_intensity(torch.tensor([15.0, 60.0]), env_ids=[0, 1])
    expected = [[0.25] * 3, [1.8, 1.6, 1.4], [0.5] * 3, [0.9, 0.8, 0.7]]
    np.testing.assert_allclose(shown(sim, "light_diffuse"), expected, atol=1e-6)
    np.testing.assert_allclose(shown(sim, "light_specular"), 0.3 * np.asarray(expected), atol=1e-6)
    lamp.set_falloff(torch.tensor(7.0), env_ids=[2])  # remembered
    assert lamp.state_dict()["falloff"].reshape(-1).tolist() == [10.0, 10.0, 7.0, 10.0]
    saved = sim.state_dict()
    lamp.reset()
    np.testing.assert_allclose(shown(sim, "light_diffuse"), [[0.1, 0.2, 0.3]] * 4, atol=1e-6)
    sim.load_state_dict(saved)
    lamp.set_intensity(30.0)  # the colours are those that were saved
    expected = [[0.5] * 3, [0.9, 0.8, 0.7], [0.5] * 3, [0.9, 0.8, 0.7]]
    np.testing.assert_allclose(shown(sim, "light_diffuse"), expected, atol=1e-6)


def test_poses_as_vectors_and_matrices(lamp):
    lamp.set_local_pose(torch.eye(4), to_matrix=True)
    assert torch.equal(lamp.get_local_pose(to_matrix=True), torch.eye(4).repeat(4, 1, 1))
    lamp.set_local_pose(torch.tensor([[1.0, 2.0, 3.0]] * 2), env_ids=[0, 2])
    assert lamp.get_local_pose().tolist() == [[1, 2, 3], [0, 0, 0], [1, 2, 3], [0, 0, 0]]
    matrix = lamp.get_local_pose(to_matrix=True)
    assert matrix[2, :3, 3].tolist() == [1, 2, 3] and torch.equal(matrix[2, :3, :3], torch.eye(3))


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda lamp: lamp.set_color(torch.tensor([2.0, 0, 0])), r"RGB in \[0, 1\]"),
        (lambda lamp: lamp.set_color(torch.zeros(3, 3)), r"\(4, 3\) or \(3,\), got \(3, 3\)"),
        (lambda lamp: lamp.set_intensity(-1.0), "must not be negative"),
        (lambda lamp: lamp.set_local_pose(torch.zeros(3), to_matrix=True), r"\(n, 4, 4\)"),
        (lambda lamp: lamp.set_color(torch.zeros(3), env_ids=[4]), r"\[0, 4\)"),
    ],
)
def test_wrong_values_raise_at_the_call(lamp, call, words):
    with pytest.raises(ValueError, match=words):
        call(lamp)
