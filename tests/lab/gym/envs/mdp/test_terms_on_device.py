"""Every registered quantity with arrays on a device, against arrays on the host.

Two environments on Warp's CPU device, one with each kind of arrays, evaluate the example of every
term, shapes, and other parameters in each step. A term that would copy between host and device in
a step, or make an array in the wrong place, has no values.
"""

from pathlib import Path
from typing import Any, NamedTuple, get_args

import numpy as np
import pytest
import torch

from embodichain.lab.gym.envs.cfg import ObservationCfg
from embodichain.lab.gym.envs.managers.manager import Manager
from embodichain.lab.gym.envs.managers.terms.registry import SHAPES, VALUE_KINDS
from embodichain.lab.gym.envs.mdp.shapes import Sigmoid
from embodichain.lab.sim.engine.device.device_array import DeviceArray
from embodichain.utils.errors import ConfigError
from tests.helpers.example_scene import environment
from tests.lab.gym.envs.mdp.test_examples import ENTRIES, HINTS, SECTION_OF, example_of

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]

N, STEPS, WARM = 3, 8, 2
REPEATED = (6, 7)
"""Steps that are taken once more in the end, from the saved state before them."""
DRAWN = {
    "camera_image": 16.0, "camera_mask": 0.0, "camera_points": 2e-3,
    "camera_image depth": 2e-3, "camera_image bytes": 1.0, "camera_image mask": 0.0,
}  # fmt: skip
"""Terms of pictures, which another renderer draws on the host, and errors of most pixels: of 255,
of metres, or of numbers of entities. Meshes are simplified on the host, and textures smoothed."""

WITHOUT_LIMITS = "joints without limits"
TERRAIN = ("height_above_ground", "terrain_edge_distance", "terrain_level")
"""Terms that are refused with arrays on a device."""

TOOL = {"uid": "ur10", "link_names": ["ee_link"]}
TRUNK = {"uid": "go", "link_names": ["trunk"]}
DOWN = {"directions": [[0, 0, -1], [0.5, 0, -1], [0, 0, 1]]}
SENSORS: dict[str, dict[str, Any]] = {
    "ray": {"sensor_type": "ray", "entity_cfg": TRUNK, "pattern": DOWN, "no_hit": "inf",
            "data_types": ["distance", "position", "normal"]},
    "slow_ray": {"sensor_type": "ray", "entity_cfg": TOOL, "pattern": DOWN, "rate": 20.0,
                 "alignment": "yaw"},
    "slow_scan": {"sensor_type": "height_scan", "entity_cfg": TRUNK, "rate": 15.0,
                  "no_hit": "zero", "alignment": "world",
                  "pattern": {"grid": {"size": [0.2, 0.2], "resolution": 0.1}}},
    "frame": {"sensor_type": "frame_pose", "entity_cfg": TOOL, "relative_to": {"uid": "cube"}},
    "slow_frame": {"sensor_type": "frame_pose", "entity_cfg": TRUNK, "rate": 12.0},
    "slow_load": {"sensor_type": "joint_torque", "entity_cfg": {"uid": "ur10"}, "rate": 20.0},
    "slow_imu": {"sensor_type": "imu", "entity_cfg": TRUNK, "rate": 20.0},
}  # fmt: skip
READINGS = {
    "contacts": ("found", "force"),
    "imu": ("orientation", "angular_velocity", "acceleration", "projected_gravity"),
    "slow_imu": ("orientation", "acceleration"),
    "wrench": ("force", "torque"),
    "load": ("torque", "actuator", "passive", "constraint"),
    "slow_load": ("torque",),
    "frame": ("position", "orientation", "linear_velocity", "angular_velocity"),
    "slow_frame": ("position", "linear_velocity"),
    "ray": ("distance", "position", "normal"),
    "slow_ray": ("distance",),
    "slow_scan": ("height",),
}
SHAPED: dict[str, Any] = {
    "l1": "l1", "l2": "l2", "norm": "norm", "negative": ["norm", "negative"], "tanh": {"tanh": 0.5},
    "gaussian": {"gaussian": 0.5}, "above": {"above": 0.1}, "below": {"below": 0.1},
    "within": {"within": [-1, 1]}, "outside": {"outside": [-1.6, 1]},
    "excess": ["norm", {"excess": 0.3}], "rate": ["norm", "rate"],
    "clip": ["norm", {"clip": [-1, 1]}], "at_most": ["norm", {"at_most": 0.5}],
    "tolerance": ["norm", {"tolerance": {"margin": 3.0}}], "column": {"column": 1},
}  # fmt: skip
OTHERS: list[tuple[str, dict[str, Any]]] = [
    ("orientation", {"of": TOOL, "representation": "quat"}),
    ("orientation", {"of": TOOL, "representation": "matrix"}),
    ("link_pose", {"of": TOOL, "to_matrix": True}),
    ("link_pose", {"of": {"uid": "go", "link_names": [".*foot"]}, "in_root_frame": True}),
    ("link_velocity", {"of": {"uid": "go", "link_names": [".*foot"]}, "in_root_frame": True}),
    ("link_velocity", {"of": {"uid": "go"}, "in_root_frame": True}),
    ("relative_pose", {"from": TOOL, "to": {"uid": "cube"}, "representation": "matrix"}),
    ("relative_position", {"from": TOOL, "to": {"uid": "cube"}, "in_source_frame": True}),
    ("relative_velocity", {"from": TOOL, "to": {"uid": "cube"}, "in_source_frame": True}),
    ("linear_velocity", {"of": TRUNK, "frame": "yaw"}),
    ("angular_velocity", {"of": TOOL, "frame": "yaw", "axes": "xz"}),
    ("speed", {"of": TRUNK}),
    ("yaw", {"of": TRUNK}),
    ("angle", {"from": TRUNK}),
    ("get_robot_eef_pose", {}),
    ("get_object_pose", {"entity_cfg": {"uid": "cube"}, "to_matrix": True}),
    ("get_object_body_scale", {"entity_cfg": {"uid": "ur10"}}),
    ("joint_position", {"of": {"uid": "go"}, "relative": True, "periodic": True}),
    ("joint_power", {"of": {"uid": "go"}, "positive_only": True}),
    ("shape_index", {"of": {"uid": "thing"}}),
    ("contact_found", {"sensor": "contacts"}),
    ("contact_force", {"sensor": "contacts"}),
]


class Case(NamedTuple):
    """A term and the kind of manager that runs it."""

    kind: Any
    cfg: Any


def case(kind: Any, /, **declared: Any) -> Case:
    return Case(kind, get_args(HINTS[SECTION_OF[kind]])[1](**declared))


def cases() -> dict[str, Case]:
    """Name -> every example, each as the first kind that it can be, and variations."""
    found: dict[str, Case] = {}
    for entry in ENTRIES:
        for kind in [kind for kind in VALUE_KINDS if kind in entry.kinds][:1]:
            found[entry.name] = case(kind, **example_of(entry, kind))
    arm = {"of": {"uid": "ur10"}}
    for name, shape in SHAPED.items():
        found[f"shape {name}"] = case("metric", func="joint_position", shape=shape, params=arm)
    for name in get_args(Sigmoid):
        tolerance = {"tolerance": {"margin": 2.0, "sigmoid": name}}
        found[f"sigmoid {name}"] = case(
            "metric", func="joint_position", shape=["norm", tolerance], params=arm
        )
    for func, params in OTHERS:
        found[f"{func} {params}"] = case("observation", func=func, params=params)
    for sensor, names in READINGS.items():
        for reading in names:
            params = {"sensor": sensor, "reading": reading}
            found[f"{sensor} {reading}"] = case("observation", func="sensor_reading", params=params)
    for name, params in {
        "depth": {"sensor": "wrist", "channels": "depth"},
        "bytes": {"sensor": "wrist", "channels": "depth", "max_depth": 3.0},
        "mask": {"sensor": "front", "channels": "mask"},
    }.items():
        found[f"camera_image {name}"] = case("observation", func="camera_image", params=params)
    found[WITHOUT_LIMITS] = case(
        "observation", func="joint_velocity_excess", params={"of": {"uid": "go"}}
    )
    return found


CASES = cases()


class Played(NamedTuple):
    """Name -> values of a term in every step, or why there are none; rewards of the task."""

    values: dict[str, list[np.ndarray]]
    errors: dict[str, str]
    rewards: list[np.ndarray]


def on_host(value: Any) -> np.ndarray:
    tensor = value.tensor if isinstance(value, DeviceArray) else value
    array = tensor.cpu().numpy() if isinstance(tensor, torch.Tensor) else tensor
    return np.array(array, np.float64)


def no_upload(array: Any) -> Any:
    raise TypeError(f"an array of the host of shape {array.shape} is uploaded in every step")


REFUSED = (TypeError, RuntimeError, ValueError, AttributeError)
OVERRIDES = (
    "sim.engine=warp", "sim.num_threads=1", "task.max_episode_steps=5",
    "+task.curriculum.heavier={func: modify_reward_weight, "
    "params: {term_name: effort, weight: 3, num_steps: 5}}",
)  # fmt: skip


def play(arrays: str, folder: Path) -> Played:
    """Step an environment, with resets of some environments, and evaluate all terms."""
    played = Played({name: [] for name in CASES}, {}, [])
    overrides = (*OVERRIDES, f"sim.warp.arrays={arrays}")
    with environment("sensors", SENSORS, folder / arrays, N, overrides) as env:
        terms = {}
        for name, (kind, cfg) in CASES.items():
            try:
                manager = Manager(env, "tested", kind, {name: cfg})
            except ConfigError as error:
                played.errors[name] = str(error)
                continue
            env.managers[f"tested {name}"] = manager  # which is reset with the environment
            terms[name] = manager.terms[name]
        env.reset()
        home = on_host(env.action_manager.home())
        draws = np.random.default_rng(0).uniform(-0.3, 0.3, (STEPS, N, home.shape[-1]))
        saved = None
        for count, step in enumerate((*range(STEPS), *REPEATED)):
            if step == 2:
                env.reset(options={"reset_ids": [1]})
            if count == REPEATED[0]:
                saved = env.state_dict()
            if count == STEPS:
                env.load_state_dict(saved)
            action = torch.from_numpy(home + draws[step]).float().to(env.device)
            obs, reward, _, _, info = env.step(action)
            played.rewards.append(on_host(reward))
            strict = arrays == "device" and step >= WARM  # fields and constants are made at first
            with pytest.MonkeyPatch.context() as patch, torch.device("meta" if strict else "cpu"):
                if strict:  # nothing is uploaded, or made without a device
                    patch.setattr(torch, "from_numpy", no_upload)
                for name in set(terms) - set(played.errors):
                    try:
                        value = evaluated(env, terms[name], obs, action, info)
                        played.values[name].append(on_host(value))
                    except REFUSED as error:
                        played.errors[name] = f"{type(error).__name__}: {error}"
    return played


def evaluated(env: Any, term: Any, obs: Any, action: Any, info: Any) -> Any:
    """The value of a term; an array of the host is none on a device."""
    passed = (obs, action, info)
    if isinstance(term.cfg, ObservationCfg):
        passed = (obs["robot"]["qpos"] if term.cfg.mode == "modify" else obs,)
    value = term.call(env, *passed)
    if env.arrays.on_device and isinstance(value, np.ndarray):
        raise TypeError("the value is an array of the host")
    return value


def agree(found: np.ndarray, wanted: np.ndarray, what: str) -> None:
    """Check that numbers differ by rounding only, relative to the largest."""
    largest = np.abs(wanted[np.isfinite(wanted)]).max(initial=1.0)
    np.testing.assert_allclose(found, wanted, rtol=0, atol=2e-4 * largest, err_msg=what)


@pytest.fixture(scope="module")
def host(tmp_path_factory: pytest.TempPathFactory) -> Played:
    return play("host", tmp_path_factory.mktemp("host"))


@pytest.fixture(scope="module")
def device(tmp_path_factory: pytest.TempPathFactory) -> Played:
    return play("device", tmp_path_factory.mktemp("device"))


def test_every_shape_takes_part() -> None:
    assert set(SHAPED) == set(SHAPES)


@pytest.mark.parametrize("name", sorted(CASES.keys() - {*DRAWN, *TERRAIN, WITHOUT_LIMITS}))
def test_values_are_those_of_arrays_on_the_host(name: str, host: Played, device: Played) -> None:
    assert name not in host.errors, host.errors[name]
    assert name not in device.errors, device.errors[name]
    for step, (a, b) in enumerate(zip(host.values[name], device.values[name], strict=True)):
        agree(b, a, f"step {step}")


def test_a_saved_state_continues(device: Played) -> None:
    for name in set(CASES) - set(device.errors):
        for again, step in enumerate(REPEATED, STEPS):
            agree(device.values[name][again], device.values[name][step], name)


@pytest.mark.parametrize("name", DRAWN)
def test_pictures_are_close_to_those_drawn_on_the_host(
    name: str, host: Played, device: Played
) -> None:
    assert name not in host.errors, host.errors[name]
    assert name not in device.errors, device.errors[name]
    for a, b in zip(host.values[name], device.values[name], strict=True):
        assert a.shape == b.shape
        assert (np.abs(a - b) <= DRAWN[name]).mean() > 0.9
    if name == "camera_image depth":  # of the moving arm
        assert len({image.tobytes() for image in device.values[name]}) > 2


@pytest.mark.parametrize("name", TERRAIN)
def test_terms_of_a_terrain_are_refused(name: str, device: Played) -> None:
    assert "terms of a terrain" in device.errors[name]


def test_limits_are_checked(host: Played, device: Played) -> None:
    assert "none of the joints picked of 'go' has limits" in device.errors[WITHOUT_LIMITS]
    assert device.errors[WITHOUT_LIMITS] == host.errors[WITHOUT_LIMITS]


def test_a_curriculum_changes_the_rewards_of_the_device(host: Played, device: Played) -> None:
    assert (np.abs(host.rewards[6]) > 2 * np.abs(host.rewards[1])).all(), "the weight is the same"
    np.testing.assert_allclose(device.rewards, host.rewards, rtol=1e-4)
