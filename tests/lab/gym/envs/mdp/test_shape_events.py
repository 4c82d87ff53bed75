"""Objects of a drawn shape: each environment simulates, shows and logs the shape it has."""

import numpy as np
import pytest
import torch
import yaml
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

import embodichain
from embodichain.learning.checkpoints.physics_values import physics_values
from embodichain.recording import McapRecorder, verify
from embodichain.recording import open as open_log
from embodichain.recording.views.scene import Scenes
from embodichain.utils.errors import ConfigError
from tests.helpers.hollow_meshes import CUP, write_revolved

NAMES = ("box", "can", "cup")
BOX, CAN, CUP_INDEX = range(3)
TASK = """
description: A thing falls on a slope.
physics: {physics_dt: 0.005}
max_episode_steps: 50
objects:
  slope: {shape: {shape_type: Cube, size: [2, 2, 0.1]}, body_type: static, init_rot: [0, 10, 0]}
  thing:
    any_of: {}
    attrs: {mass: 0.3, dynamic_friction: 0.8, linear_damping: 0.1, angular_damping: 0.2}
    init_pos: [0, 0, 0.3]
    init_rot: [20, 50, 0]
sensors:
  above: {sensor_type: camera, width: 24, height: 16, fovy: 20, data_types: [mask],
          extrinsics: {eye: [0, 0, 1.5], target: [0, 0, 0], up: [1, 0, 0]}}
  beam: {sensor_type: ray, pos: [0.01, 0.004, 1.5], pattern: {directions: [[0, 0, -1]]}}
observations:
  shape: {func: shape_index, params: {of: {uid: thing}, one_hot: true}}
  place: {func: position, params: {of: {uid: thing}}}
"""


def shapes(folder):
    return {
        "box": {"shape": {"shape_type": "Cube", "size": [0.05, 0.08, 0.1]}},
        "can": {
            "shape": {"shape_type": "Cylinder", "radius": 0.03, "height": 0.12},
            "mass": 0,
            "density": 400,
            "dynamic_friction": 0.3,
        },
        "cup": {
            "shape": {"shape_type": "Mesh", "fpath": write_revolved(folder / "cup.obj", CUP)},
            "mass": 0.1,
            "body_scale": [1.5, 1.5, 1.5],
        },
    }


@pytest.fixture
def make(tmp_path):
    """Builds the task with events; `only` gives the thing one shape, without `any_of`."""
    built = []

    def build(events=None, num_envs=3, only=None, **thing):
        tree = yaml.safe_load(TASK)
        tree["events"] = events or {}
        tree["objects"]["thing"] |= {"any_of": shapes(tmp_path), **thing}
        if only is not None:
            del tree["objects"]["thing"]["any_of"], tree["observations"]["shape"]
            one = shapes(tmp_path)[only]
            own = {"shape", "body_scale"} & one.keys()
            attrs = {key: value for key, value in one.items() if key not in own}
            tree["objects"]["thing"]["attrs"] |= attrs
            tree["objects"]["thing"] |= {key: one[key] for key in own}
        (tmp_path / "task").mkdir(exist_ok=True)
        (tmp_path / "task" / "falls.yaml").write_text(yaml.safe_dump(tree, sort_keys=False))
        env = embodichain.make("falls", num_envs, ["seed=1"], config_dir=tmp_path)
        built.append(env)
        env.reset()
        return env

    yield build
    for env in built:
        env.close()


def draw(mode="reset", **params):
    return {"func": "randomize_shape", "mode": mode, "params": {"of": {"uid": "thing"}, **params}}


def thing(env):
    return env.sim.get_rigid_object("thing")


def step(env, count=1):
    for _ in range(count):
        out = env.step(torch.zeros(env.num_envs, 0))
    return out


def path(env, count=25):
    """(count, N, 7) poses on the way down."""
    found = []
    for _ in range(count):
        step(env)
        found.append(thing(env).get_local_pose().numpy())
    return np.array(found)


def test_each_shape_moves_as_an_object_that_has_only_this_one(make):
    env = make()
    assert thing(env).shape_names == NAMES
    thing(env).set_shape([CUP_INDEX, BOX, CAN])
    assert thing(env).get_shape().tolist() == [CUP_INDEX, BOX, CAN]
    mass, inertia = thing(env).body_data.mass, thing(env).body_data.inertia
    damping = env.sim.engine.model_field("dof_damping").copy()
    paths = path(env)
    for column, name in enumerate(("cup", "box", "can")):
        alone = make(num_envs=1, only=name)
        data = thing(alone).body_data
        np.testing.assert_array_equal(mass[column], data.mass[0])
        np.testing.assert_array_equal(inertia[column], data.inertia[0])
        np.testing.assert_allclose(damping[column], alone.sim.engine.model.dof_damping, rtol=1e-12)
        np.testing.assert_allclose(paths[:, column], path(alone)[:, 0], atol=2e-6)
    assert np.ptp(paths[-1, :, 0]) > 0.01  # they do not move alike


def test_a_shape_that_comes_back_is_the_same_to_the_bit(make):
    env = make()
    first = path(env, 16)
    thing(env).set_shape([CAN], env_ids=[1])
    thing(env).set_shape([CUP_INDEX], env_ids=[2])
    env.reset()
    other = path(env, 16)
    assert (other[:, 0] == first[:, 0]).all() and (other[-1, 1:] != first[-1, 1:]).any(1).all()
    thing(env).set_shape([BOX, BOX, BOX])
    env.reset()
    assert (path(env, 16) == first).all()
    with pytest.raises(ValueError, match="indices of the shapes box, can, cup, got"):
        thing(env).set_shape([0, 1, 3])


def test_draws_by_weight_whatever_the_number_of_environments(make):
    env = make({"which": draw(weights={"cup": 0, "can": 3})}, num_envs=400)
    drawn = thing(env).get_shape()
    share = np.bincount(drawn, minlength=3) / 400
    np.testing.assert_allclose(share, [0.25, 0.75, 0.0], atol=0.08)
    few = make({"which": draw(weights={"cup": 0, "can": 3})}, num_envs=3)
    assert thing(few).get_shape().tolist() == drawn[:3].tolist()
    rows = path(env, 10)[:, :3]
    assert (rows == path(few, 10)).all()
    even = np.bincount(thing(make({"which": draw()}, num_envs=300)).get_shape(), minlength=3)
    np.testing.assert_allclose(even / 300, 1 / 3, atol=0.1)


def test_a_shape_is_drawn_once_or_in_every_episode(make):
    once, often = (make({"which": draw(mode)}, num_envs=12) for mode in ("startup", "reset"))
    for env, changes in ((once, False), (often, True)):
        before = thing(env).get_shape()
        env.reset()
        assert bool((thing(env).get_shape() != before).any()) is changes
    seen = often.get_obs()["shape"]
    assert (seen.argmax(-1) == thing(often).get_shape()).all() and (seen.sum(-1) == 1).all()


def test_what_is_drawn_touched_and_seen_is_the_present_shape(make):
    env = make({"which": draw()}, init_rot=[0, 0, 0], num_envs=8)
    drawn = thing(env).get_shape().numpy()
    assert set(drawn) == {0, 1, 2}
    top = np.array([0.05, 0.06, 0.005 * 1.5])  # a ray meets the bottom of the cup
    hit = 1.5 - env.get_sensor("beam").read_distance()[:, 0]
    np.testing.assert_allclose(hit, 0.3 + top[drawn], atol=1e-6)
    body = thing(env).entity.root_body_id
    seen = (np.asarray(env.get_sensor("above").read("mask")) == body).reshape(8, -1).sum(1)
    for shape in range(3):
        assert len(set(seen[drawn == shape])) == 1
    assert len(set(seen)) == 3
    kinds = {BOX: "cubes", CAN: "cylinders", CUP_INDEX: "models"}
    for row, shape in enumerate(drawn):
        update = SceneUpdate.FromString(Scenes().encode(0, env.sim.engine.model_of(row), row))
        (entity,) = (e for e in update.entities if e.id.endswith("thing"))
        found = {kind: len(getattr(entity, kind)) for kind in kinds.values()}
        assert found == {kind: int(kind == kinds[int(shape)]) for kind in kinds.values()}
    thing(env).set_visible(False)
    assert not (np.asarray(env.get_sensor("above").read("mask")) == body).any()
    thing(env).set_visible(True)
    again = (np.asarray(env.get_sensor("above").read("mask")) == body).reshape(8, -1).sum(1)
    assert (again == seen).all()
    thing(env).enable_collision(np.zeros(8, bool))
    step(env, 20)
    assert (thing(env).get_local_pose()[:, 2] < -0.2).all()  # through the slope
    thing(env).enable_collision(np.ones(8, bool))
    thing(env).reset()
    step(env, 25)
    assert (thing(env).get_local_pose()[:, 2] > -0.2).all()


def test_a_log_repeats_and_restores_the_shapes(make, tmp_path):
    env, log = make({"which": draw()}, num_envs=3), tmp_path / "run.mcap"
    env.add_observer(McapRecorder(log, env))
    env.reset()
    first = path(env, 55)
    drawn, saved, episode = thing(env).get_shape(), env.state_dict(), int(env.episode_ids[0])
    later = path(env, 10)
    env.close()
    assert verify(log).ok
    other = make({"which": draw()}, num_envs=1)
    with open_log(log) as found:
        assert {d.term for d in found.events()} == {"which"}
        for row in range(3):
            thing(other).set_shape([(int(drawn[row]) + 1) % 3])
            other.restore(found, env=row, episode=episode, step=2)
            assert thing(other).get_shape() == drawn[row]
            assert (path(other, 3)[:, 0] == first[52:, row]).all()
    other = make({"which": draw()}, num_envs=3)
    thing(other).set_shape((drawn + 1) % 3)
    other.load_state_dict(saved)
    assert (thing(other).get_shape() == drawn).all()
    assert (path(other, 10) == later).all()


def test_a_shape_that_is_not_the_first_is_part_of_the_physics(make, tmp_path):
    here = physics_values(make().sim.engine.model)
    other = shapes(tmp_path)
    other["can"]["shape"]["radius"] = 0.031
    there = physics_values(make(any_of=other).sim.engine.model)
    (changed,) = (element for element in here if here[element] != there[element])
    assert changed.startswith("geom") and here.keys() == there.keys()


def test_randomizers_act_on_the_present_shape(make):
    few = {"func": "randomize", "mode": "reset"}
    which = {"which": draw(weights={"box": 0, "can": 0})}
    weigh = {**few, "params": {"of": {"uid": "thing"}, "mass": [0.4, 0.4], "friction": [0.9, 0.9]}}
    env = make({**which, "weigh": weigh})
    cup = make(only="cup", num_envs=1)
    data, alone = thing(env).body_data, thing(cup).body_data
    np.testing.assert_allclose(data.mass, 0.4, rtol=1e-6)
    np.testing.assert_allclose(data.inertia[0], 4 * alone.inertia[0], rtol=1e-6)
    model = env.sim.engine.model_of(0)
    touching = model.geom_contype[thing(env).entity.geom_ids] != 0
    assert (model.geom_friction[thing(env).entity.geom_ids[touching], 0] == 0.9).all()
    for given, message in (
        ({"mass": [0.5, 2], "operation": "scale"}, "each of its shapes has a mass of its own"),
        ({"com": [[0, 0, 0], [0, 0, 0.1]]}, "each of its shapes has a centre of mass of its own"),
        ({"scale": [0.5, 2]}, "list shapes of several sizes there"),
    ):
        with pytest.raises(ConfigError, match=message):
            make({"bad": {**few, "params": {"of": {"uid": "thing"}, **given}}})


@pytest.mark.parametrize(
    ("params", "message"),
    [
        ({"of": {"uid": "slope"}}, "events.which.params.of.uid: 'slope' has no any_of"),
        ({"weights": {"cann": 2}}, "no shape is called 'cann'; there are: box, can, cup. .*'can'"),
        ({"weights": dict.fromkeys(NAMES, 0)}, "weights: all are 0"),
    ],
)
def test_what_cannot_be_drawn_is_named(make, params, message):
    with pytest.raises(ConfigError, match=message):
        make({"which": draw(**params)})
