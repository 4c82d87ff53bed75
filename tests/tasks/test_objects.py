"""Objects and scenes that ship: they compose, stand still where they are placed, and are hollow."""

import importlib.util
import json
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import mujoco
import numpy as np
import pytest
import torch
import yaml

import embodichain
from embodichain.cli import main
from embodichain.config.composition.composed import list_options
from embodichain.data import get_data_path
from embodichain.lab.gym.envs.base_env import BaseEnv
from embodichain.utils.errors import ConfigError

ROOT = Path(__file__).parents[2]
OBJECTS = list_options("object")
HOLLOW = {"mug": "peg", "bowl": "ball", "box": "cube", "bin": "can", "shelf/upper": "bottle"}
TABLE = {"scene": {"table": {"size": [2, 2, 0.7]}}}


@pytest.fixture
def make(tmp_path: Path) -> Iterator[object]:
    built: list[BaseEnv] = []

    def build(
        defaults: list[dict[str, str]],
        placing: dict[str, dict[str, object]],
        **sections: dict[str, object],
    ) -> BaseEnv:
        arranged = {"func": "arrange_objects", "mode": "reset", "params": {"objects": placing}}
        tree = {
            "defaults": [*defaults, "_self_"],
            "description": "Things on a table.",
            "physics": {"physics_dt": 0.005},
            "sim_steps_per_control": 1,
            **TABLE,
            "events": {"layout": arranged},
            **sections,
        }
        (tmp_path / "task").mkdir()
        (tmp_path / "task" / "things.yaml").write_text(yaml.safe_dump(tree, sort_keys=False))
        env = embodichain.make("things", 8, ["seed=1"], config_dir=tmp_path)
        built.append(env)
        env.reset()
        return env

    yield build
    for env in built:
        env.close()


def option(name: str) -> dict[str, str]:
    return {f"/object@objects.{name}": name}


def moved(env: BaseEnv, steps: int) -> dict[str, float]:
    """How far each object moves in some control steps, metres."""
    handles = env.sim.rigid_objects
    before = {uid: handle.get_local_pose() for uid, handle in handles.items()}
    for _ in range(steps):
        env.step(torch.zeros(8, 0))
    after = {uid: handle.get_local_pose() for uid, handle in handles.items()}
    return {uid: float((after[uid] - before[uid])[:, :3].abs().max()) for uid in handles}


def test_every_object_stands_still_on_a_table(make) -> None:
    placing = {name: {"on": "table"} for name in OBJECTS}
    env = make([option(name) for name in OBJECTS], placing)
    for row in range(8):
        contacts = env.sim.engine.data_of(row).contact
        assert min((contact.dist for contact in contacts), default=0.0) >= -1e-6
    assert {uid: d for uid, d in moved(env, 100).items() if d > 1e-3} == {}


def test_things_stay_in_what_is_hollow(make) -> None:
    names = {uid.partition("/")[0] for uid in HOLLOW} | set(HOLLOW.values())
    placing: dict[str, dict[str, object]] = {}
    for container, thing in HOLLOW.items():
        placing[container.partition("/")[0]] = {"on": "table"}
        placing[thing] = {"in": container}
    env = make([option(name) for name in sorted(names)], placing)
    distances = moved(env, 100)
    assert {uid: d for uid, d in distances.items() if d > 1e-3} == {}


def test_a_lid_closes_its_box(make) -> None:
    placing = {
        "box": {"on": "table"},
        "cube": {"in": "box"},
        "lid": {"on": "box/lid", "yaw": 0},
    }
    env = make([option(name) for name in placing], placing)
    handles = env.sim.rigid_objects
    offset = (handles["lid"].get_local_pose() - handles["box"].get_local_pose())[:, :3]
    # The board of the lid begins on the edge of the box, 45 mm above its middle, and the origin of
    # the lid is the upper side of the board.
    np.testing.assert_allclose(offset, np.tile([0, 0, 0.045 + 0.008], (8, 1)), atol=1e-5)
    assert {uid: d for uid, d in moved(env, 100).items() if d > 1e-3} == {}


def test_what_is_above_an_inside_counts(tmp_path: Path, make) -> None:
    """A bottle of 20 cm does not stand in a compartment of 22.6 cm if it is 20 % larger."""
    with pytest.raises(ConfigError, match=r"no free place for 'bottle' in 'shelf/upper'"):
        make(
            [option("shelf"), option("bottle")],
            {"shelf": {"on": "table"}, "bottle": {"in": "shelf/upper"}},
            objects={"bottle": {"body_scale": [1, 1, 1.2]}},
        )


def test_masses_are_those_of_the_files(make) -> None:
    env = make([option(name) for name in OBJECTS], {"cube": {"on": "table"}})
    for name in OBJECTS:
        tree = yaml.safe_load((ROOT / "conf" / "object" / f"{name}.yaml").read_text())
        if tree.get("body_type", "dynamic") == "dynamic":
            mass = float(env.sim.rigid_objects[name].get_mass()[0])
            assert mass == pytest.approx(tree["attrs"]["mass"])


def test_a_mug_turns_like_a_hollow_thing(make) -> None:
    """Its moment about the vertical is that of a tube and a disc, and of a small handle."""
    env = make([option("mug")], {"mug": {"on": "table"}})
    moments = env.sim.rigid_objects["mug"].get_inertia()[0].numpy()
    tube = 0.5 * (0.036**2 + 0.04**2)
    disc = 0.5 * 0.04**2
    assert disc * 0.3 < moments.min() < 1.1 * tube * 0.3


def script() -> ModuleType:
    spec = importlib.util.spec_from_file_location("objects", ROOT / "scripts" / "objects.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name", sorted(script().meshes()))
def test_a_mesh_is_that_of_the_script(name: str) -> None:
    """MuJoCo's volume, of the file and of each piece's hull."""
    pieces = script().meshes()[name]
    spec = mujoco.MjSpec()
    whole = spec.add_mesh(name="whole", file=str(get_data_path(f"Objects/{name}.obj")))
    whole.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_EXACT
    body = spec.worldbody.add_body()
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="whole", density=1.0)
    for number, piece in enumerate(pieces):
        spec.add_mesh(name=f"{number}", uservert=piece.ravel())
        part = spec.worldbody.add_body()
        part.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=f"{number}", density=1.0)
    mass = spec.compile().body_mass
    assert mass[1] == pytest.approx(mass[2:].sum(), rel=1e-3)


def test_objects_and_scenes_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list", "objects", "--json"]) == 0
    rows = {row["name"]: row for row in json.loads(capsys.readouterr().out)["objects"]}
    assert list(rows) == OBJECTS
    assert rows["mug"]["what"] == "A mug, 8 cm wide and 9 cm high"
    assert rows["mug"]["from"] == "embodichain"
    assert main(["list", "scenes"]) == 0
    assert "table_top" in capsys.readouterr().out
