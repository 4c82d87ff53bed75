"""Objects that are placed by relation: on, in and beside things, without overlaps."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

import embodichain
from embodichain.lab.gym.envs.base_env import BaseEnv
from embodichain.recording import McapRecorder, verify
from embodichain.recording import open as open_log
from embodichain.utils.errors import ConfigError, Problem

F64 = NDArray[np.float64]
SCENE = """
description: Things on a table.
physics: {physics_dt: 0.005}
max_episode_steps: 200
scene: {table: {size: [0.8, 1.2, 0.7], pos: [0.75, 0.1, 0]}}
objects:
  tray:
    shape: {shape_type: Cube, size: [0.3, 0.2, 0.02]}
    init_rot: [0, 0, 90]
    sites: {inside: {pos: [0, 0, 0.06], size: [0.28, 0.18, 0.1]}}
  bar: {shape: {shape_type: Cube, size: [0.2, 0.04, 0.04]}, attrs: {mass: 0.1}}
  can: {shape: {shape_type: Cylinder, radius: 0.03, height: 0.1}, attrs: {mass: 0.1}}
  lying:
    shape: {shape_type: Cube, size: [0.04, 0.04, 0.12]}
    attrs: {mass: 0.1}
    init_rot: [90, 0, 0]
  wall:
    shape: {shape_type: Cube, size: [0.1, 0.6, 0.3]}
    body_type: static
    init_pos: [0.5, 0.1, 0.85]
events:
  layout:
    func: arrange_objects
    mode: reset
    params:
      objects:
"""
LAYOUT = """
bar: {on: tray, yaw: 0}
can: {on: table, beside: {of: tray, by: 0.1}}
tray: {on: table, region: [[-0.1, -0.4], [0.4, 0.4]], yaw: [-20, 20]}
lying: {on: table}
"""
TABLE = np.array([0.75, 0.1])
HALF_TABLE = np.array([0.4, 0.6])
EDGES = {
    "tray": (0.3, 0.2, 0.02),
    "bar": (0.2, 0.04, 0.04),
    "can": (0.06, 0.06, 0.1),
    "lying": (0.04, 0.04, 0.12),
    "wall": (0.1, 0.6, 0.3),
}
Make = Callable[..., BaseEnv]


def write(folder: Path, layout: str = LAYOUT, **params: Any) -> None:
    lines = [f"        {line}\n" for line in layout.strip().splitlines()]
    lines += [f"      {key}: {value}\n" for key, value in params.items()]
    (folder / "task").mkdir(exist_ok=True)
    (folder / "task" / "things.yaml").write_text(SCENE.lstrip() + "".join(lines))


@pytest.fixture
def make(tmp_path: Path) -> Iterator[Make]:
    built: list[BaseEnv] = []

    def build(layout: str = LAYOUT, num_envs: int = 4, seed: int = 1, **params: Any) -> BaseEnv:
        write(tmp_path, layout, **params)
        env = embodichain.make("things", num_envs, [f"seed={seed}"], config_dir=tmp_path)
        built.append(env)
        env.reset()
        return env

    yield build
    for env in built:
        env.close()


def poses(env: BaseEnv) -> dict[str, F64]:
    """(N, 7) of each object."""
    handles = env.sim.rigid_objects
    return {uid: handles[uid].get_local_pose().numpy().astype(np.float64) for uid in EDGES}


def corners(uid: str, pose: F64) -> F64:
    """(8, 3) corners of an object's box, from MuJoCo's rotation of the pose."""
    import mujoco

    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, pose[3:])
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    half = 0.5 * np.array(EDGES[uid])
    return pose[:3] + signs * half @ rotation.reshape(3, 3).T


def distance(env: BaseEnv, row: int, first: str, second: str) -> float:
    """Distance of two objects in an environment, by MuJoCo; negative where they overlap."""
    import mujoco

    model = env.sim.engine.model_of(row)
    data = env.sim.engine.data_of(row)
    geoms = [model.geom(f"{uid}/geom").id for uid in (first, second)]
    return float(mujoco.mj_geomDistance(model, data, *geoms, 1.0, None))


def mistakes(folder: Path, layout: str, objects: str = "") -> tuple[Problem, ...]:
    """What is said about a layout when its task is built."""
    write(folder, layout)
    file = folder / "task" / "things.yaml"
    file.write_text(file.read_text().replace("\nevents:", f"{objects.rstrip()}\nevents:"))
    with pytest.raises(ConfigError) as caught:
        embodichain.make("things", 2, config_dir=folder)
    return tuple(caught.value.problems)


def test_relations_hold_in_each_environment(make: Make) -> None:
    env = make(num_envs=32)
    found = poses(env)
    for row in range(32):
        box = {uid: corners(uid, found[uid][row]) for uid in EDGES}
        for uid in ("tray", "can", "lying"):
            assert box[uid][:, 2].min() == pytest.approx(0.7, abs=1e-6)
            assert (np.abs(box[uid][:, :2] - TABLE) <= HALF_TABLE + 1e-6).all()
        # Within the region, by its middle; turned by 90 degrees from the start and by up to 20.
        tray = found["tray"][row]
        assert (tray[:2] - TABLE >= [-0.1 - 1e-6, -0.4 - 1e-6]).all()
        assert (tray[:2] - TABLE <= [0.4, 0.4]).all()
        turn = 2 * np.arctan2(tray[6], tray[3])
        assert abs(np.rad2deg(turn) - 90) <= 20.001
        # The bar is on the tray, parallel to it, and wholly on it.
        assert found["bar"][row, 2] == pytest.approx(0.7 + 0.02 + 0.02, abs=1e-6)
        along = rotated_back(tray, box["bar"])
        assert (np.abs(along[:, :2]) <= np.array([0.15, 0.1]) + 1e-6).all()
        assert distance(env, row, "can", "tray") == pytest.approx(0.1, abs=0.045)
        assert distance(env, row, "can", "tray") >= 0.1 - 1e-4


def rotated_back(pose: F64, points: F64) -> F64:
    import mujoco

    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, pose[3:])
    return (points - pose[:3]) @ rotation.reshape(3, 3)


def test_nothing_overlaps_and_everything_stays_where_it_was_placed(make: Make) -> None:
    env = make(num_envs=16)
    before = poses(env)
    for row in range(16):
        for first in EDGES:
            for second in EDGES:
                if first < second and {first, second} != {"bar", "tray"}:
                    assert distance(env, row, first, second) >= 0.005 - 1e-4
        assert (
            env.sim.engine.data_of(row).ncon == 0
            or min(contact.dist for contact in env.sim.engine.data_of(row).contact) >= -1e-6
        )
    for _ in range(100):
        env.step(torch.zeros(16, 0))
    after = poses(env)
    for uid in EDGES:
        assert np.abs(after[uid][:, :3] - before[uid][:, :3]).max() < 1e-3, uid


def test_an_environment_is_placed_as_if_it_were_alone(make: Make) -> None:
    together = poses(make(num_envs=5))
    for count in (1, 3):
        alone = poses(make(num_envs=count))
        for uid in EDGES:
            np.testing.assert_array_equal(alone[uid], together[uid][:count])


def test_a_reset_of_some_places_only_those(make: Make) -> None:
    env = make(num_envs=5)
    before = poses(env)
    env.reset(options={"reset_ids": [1, 3]})
    after = poses(env)
    assert (after["tray"][[0, 2, 4]] == before["tray"][[0, 2, 4]]).all()
    assert (after["tray"][[1, 3]] != before["tray"][[1, 3]]).any(axis=1).all()
    # Their second episode does not depend on who was reset with them.
    everywhere = make(num_envs=5)
    everywhere.reset()
    for uid in EDGES:
        np.testing.assert_array_equal(poses(everywhere)[uid][[1, 3]], after[uid][[1, 3]])


def test_a_log_has_the_places_repeats_and_restores_them(make: Make, tmp_path: Path) -> None:
    env = make(num_envs=3)
    path = tmp_path / "log.mcap"
    env.add_observer(McapRecorder(path, env))
    env.reset()
    placed = poses(env)
    for _ in range(4):
        env.step(torch.zeros(3, 0))
    state = env.state_dict()
    later = poses(env)
    env.close()
    assert verify(path).ok

    other = make(num_envs=1, seed=5)
    with open_log(path) as log:
        (event,) = (event for event in log.events() if event.term == "layout")
        assert set(event.drawn) == {"tray", "bar", "can", "lying"}
        # x, y, z and the yaw from the initial orientation, which is none.
        x_y_z = event.drawn["can"][:, :3]
        np.testing.assert_allclose(x_y_z, placed["can"][:, :3], atol=1e-6)
        yaw = 2 * np.arctan2(placed["can"][:, 6], placed["can"][:, 3])
        np.testing.assert_allclose(np.cos(event.drawn["can"][:, 3]), np.cos(yaw), atol=1e-5)
        for row in range(3):
            other.restore(log, env=row, episode=1, step=0)
            for uid in EDGES:
                np.testing.assert_array_equal(poses(other)[uid][0], placed[uid][row])
    again = make(num_envs=3)
    again.load_state_dict(state)
    for uid in EDGES:
        np.testing.assert_array_equal(poses(again)[uid], later[uid])
    # The next layout continues the streams.
    again.reset()
    twice = make(num_envs=3)
    twice.reset()
    twice.reset()
    np.testing.assert_array_equal(poses(again)["can"], poses(twice)["can"])


def test_things_lie_in_an_inside(make: Make) -> None:
    layout = """
    tray: {on: table, region: [[0, -0.3], [0.2, 0.3]]}
    can: {in: tray}
    bar: {in: tray, region: [[-0.03, -0.1], [0.03, 0.1]], yaw: [-10, 10]}
    """
    env = make(layout.replace("    ", ""), num_envs=8)
    found = poses(env)
    for row in range(8):
        assert distance(env, row, "can", "bar") >= 0.005 - 1e-4
        for uid in ("can", "bar"):
            inside = rotated_back(found["tray"][row], corners(uid, found[uid][row]))
            # The inside begins 1 cm above the middle of the tray, which is 2 cm thick.
            assert inside[:, 2].min() == pytest.approx(0.01, abs=1e-6)
            assert (np.abs(inside[:, :2]) <= np.array([0.14, 0.09]) + 1e-6).all()


NESTED = """
defaults:
  - /object@objects.bin: bin
  - /object@objects.shelf: shelf
  - /object@objects.box: box
  - /object@objects.bowl: bowl
  - /object@objects.mug: mug
  - /object@objects.peg: peg
  - /object@objects.ball: ball
  - /object@objects.cube: cube
  - _self_
"""


def nest(folder: Path, layout: str, **sizes: str) -> F64:
    """(N, 3) place of the cube of a layout of the package's objects, after a reset."""
    write(folder, layout)
    file = folder / "task" / "things.yaml"
    text = file.read_text()
    for uid, shape in sizes.items():
        text = text.replace("\nevents:", f"\n  {uid}: {{shape: {shape}}}\nevents:")
    file.write_text(NESTED.lstrip() + text)
    env = embodichain.make("things", 2, ["seed=1"], config_dir=folder)
    try:
        env.reset()
        return env.sim.rigid_objects["cube"].get_local_pose().numpy()[:, :3]
    finally:
        env.close()


@pytest.mark.parametrize(
    "layout",
    [
        "bin: {on: table}\nbowl: {in: bin}\nball: {in: bowl}\ncube: {on: table}",
        "bin: {on: table}\nmug: {in: bin}\npeg: {in: mug}\ncube: {on: table}",
        "bin: {on: table}\nbox: {in: bin}\ncube: {in: box}\nball: {beside: {of: cube}}",
        "shelf: {on: table}\nbox: {in: shelf/lower}\ncube: {on: box}",
    ],
)
def test_what_is_in_a_container_carries_things_too(tmp_path: Path, layout: str) -> None:
    assert (nest(tmp_path, layout)[:, 2] > 0.7).all()


def test_a_board_above_counts_for_what_stands_on_something_in_a_shelf(tmp_path: Path) -> None:
    layout = "shelf: {on: table}\nbox: {in: shelf/lower}\ncube: {on: box}"
    with pytest.raises(ConfigError, match="no free place for 'cube' on 'box'"):
        nest(tmp_path, layout, cube="{shape_type: Cube, size: [0.05, 0.05, 0.2]}")


@pytest.mark.parametrize(
    ("layout", "path", "words"),
    [
        ("kan: {on: table}", "objects.kan", "no object is called 'kan'"),
        ("can: {on: tabel}", "objects.can.on", "no entity is called 'tabel'"),
        ("can: {in: bar}", "objects.can.in", "'bar' has no inside: no site of it"),
        ("can: {in: tray/side}", "objects.can.in", "'side'"),
        ("can: {}", "objects.can", "needs a relation: on, in or beside"),
        ("can: {on: table, in: tray}", "objects.can", "gives both on and in"),
        ("can: {on: can}", "objects.can", "is placed by itself: can -> can"),
        (
            "can: {on: bar}\nbar: {in: tray}\ntray: {beside: {of: can}}",
            "objects.can",
            "is placed by itself: can -> bar -> tray -> can",
        ),
        ("can: {on: ground}", "objects.can.region", "missing; the ground has no end"),
        ("can: {beside: {of: tray, by: -1}}", "objects.can.beside.by", "must not be negative"),
        (
            "can: {on: table, beside: {of: tray, by: far}}",
            "objects.can.beside.by",
            "expected a number or [low, high]",
        ),
        ("can: {on: table, yaw: true}", "objects.can.yaw", "expected a number or [low, high]"),
        ("can: {on: table, beside: [tray]}", "objects.can.beside", "expected"),
        ("can: {onto: table}", "objects.can.onto", "unknown key"),
        ("tray: {on: can}", "objects.tray", "'tray' does not fit on 'can'"),
        (
            "can: {on: table, region: [[0.5, 0], [0.6, 0]]}",
            "objects.can.region",
            "'can' does not fit on 'table'",
        ),
        (
            "can: {on: tray}\nwall: {beside: {of: can}, region: [[0, 0], [1, 1]]}",
            "objects.wall.region",
            "is measured on or in something",
        ),
    ],
)
def test_what_cannot_be_is_said_at_its_key(
    tmp_path: Path, layout: str, path: str, words: str
) -> None:
    (problem,) = mistakes(tmp_path, layout)
    assert problem.path == f"task.events.layout.params.{path}"
    assert words in problem.message


def test_a_place_that_is_too_small_for_all_of_them(tmp_path: Path) -> None:
    # The tray is 0.3 x 0.2 m, and each of the others 0.2 x 0.2 m at least, with 0.06 m2 in all.
    layout = "tray: {on: table}\nwide: {on: tray}\nbroad: {on: tray}"
    (problem,) = mistakes(tmp_path, layout, WIDE)
    assert problem.path == "task.events.layout.params.objects.broad"
    assert "too small for wide, broad: together they cover 0.08 m2 of 0.06 m2" in problem.message
    # Middles in a square of 19 cm: boxes are within one of 0.19 + 0.283 m, 0.224 m2.
    region = "region: [[0, 0], [0.19, 0.19]]"
    names = [f"wide{number}" for number in range(6)]
    objects = [
        f"  {name}: {{shape: {{shape_type: Cube, size: [0.2, 0.2, 0.1]}}}}" for name in names
    ]
    layout = "\n".join(f"{name}: {{on: table, {region}}}" for name in names)
    (problem,) = mistakes(tmp_path, layout, "\n" + "\n".join(objects))
    assert problem.path == "task.events.layout.params.objects.wide5.region"
    assert "0.24 m2 of 0.224 m2" in problem.message


def test_a_region_in_which_two_always_overlap(tmp_path: Path) -> None:
    # The farthest middles are 3 cm apart; half the narrower edges are 3 and 2 cm.
    regions = "[[0, 0], [0, 0]]", "[[0.02, 0], [0.03, 0]]"
    layout = "can: {{on: table, region: {}}}\nbar: {{on: table, region: {}}}".format(*regions)
    (problem,) = mistakes(tmp_path, layout)
    assert problem.path == "task.events.layout.params.objects.bar.region"
    assert "too small for can and bar: they overlap wherever they are" in problem.message


WIDE = """
  wide: {shape: {shape_type: Cube, size: [0.2, 0.2, 0.02]}}
  broad: {shape: {shape_type: Cube, size: [0.2, 0.2, 0.02]}}
"""


def test_a_search_without_success_names_object_region_and_tries(make: Make) -> None:
    layout = "bar: {on: table}\ncan: {on: table, region: [[-0.25, 0], [-0.25, 0]]}"  # in the wall
    with pytest.raises(ConfigError) as caught:
        make(layout, num_envs=2, max_tries=7)
    text = str(caught.value)
    assert "events.layout" in text
    assert (
        "no free place for 'can' on 'table' in environment 0: 8 layouts with 7 tries each" in text
    )
    assert "[[-0.25, 0.0], [-0.25, 0.0]]" in text
