"""Where `get_data_path` and `resolve_package_uri` look, in which order, and what a miss says."""

import pickle
import sys
from pathlib import Path

import pytest

from embodichain.data import DataNotFoundError, data_root, get_data_path, resolve_package_uri
from embodichain.utils.errors import OutsideError

UR10 = "UniversalRobots/UR10/UR10.urdf"


def put(path, text="<robot/>"):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return str(path)


@pytest.fixture(autouse=True)
def world(tmp_path, monkeypatch):
    """Folders of our own for everything that is searched, apart from installed packages."""
    for name in ("work", "store", "cache"):
        (tmp_path / name).mkdir()
    monkeypatch.chdir(tmp_path / "work")
    monkeypatch.setenv("EMBODICHAIN_DATA_ROOT", str(tmp_path / "store"))
    monkeypatch.setenv("ROBOT_DESCRIPTIONS_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("MENAGERIE_CACHE_DIR", str(tmp_path / "menagerie"))
    for name in ("ROS_PACKAGE_PATH", "MENAGERIE_PATH", "MENAGERIE_ROOT"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    return tmp_path


def test_bundled_robot_is_found_offline(world):
    path = Path(get_data_path(UR10))
    assert path.is_absolute()
    assert path.parts[-6:] == ("embodichain", "data", "assets", *UR10.split("/"))
    assert path.is_file()
    assert isinstance(get_data_path(UR10), str)


def test_each_place_wins_over_those_after_it(world):
    bundled = get_data_path(UR10)
    for place in ("store/extract", "store", "work", "conf"):
        expected = put(world / place / UR10)
        assert expected != bundled
        assert get_data_path(UR10, near=world / "conf" / "task.yaml") == expected
    absolute = put(world / "elsewhere.urdf")
    assert get_data_path(absolute, near=world / "conf") == absolute


def test_cached_menagerie_comes_last(world):
    model = put(world / "cache/mujoco_menagerie/franka_emika_panda/panda.xml", "<mujoco/>")
    assert get_data_path("franka_emika_panda/panda.xml") == model
    assert get_data_path("mujoco_menagerie/franka_emika_panda/panda.xml") == model
    own = put(world / "store/franka_emika_panda/panda.xml", "<mujoco/>")
    assert get_data_path("franka_emika_panda/panda.xml") == own
    shadow = put(world / "cache/mujoco_menagerie" / UR10)
    assert get_data_path(UR10) != shadow


def test_example_robot_data_has_a_long_and_a_short_name():
    long = get_data_path("example-robot-data/robots/panda_description/urdf/panda.urdf")
    assert long.endswith("share/example-robot-data/robots/panda_description/urdf/panda.urdf")
    assert get_data_path("panda_description/urdf/panda.urdf") == long
    assert (
        get_data_path("package://example-robot-data/robots/panda_description/urdf/panda.urdf")
        == long
    )


def test_home_and_folders_and_path_objects(world, monkeypatch):
    monkeypatch.setenv("HOME", str(world))
    model = put(world / "robots/mine.urdf")
    assert get_data_path("~/robots/mine.urdf") == model
    assert get_data_path(Path(model)) == model
    assert get_data_path("~/robots") == str(world / "robots")
    assert get_data_path("../robots/./mine.urdf") == model


def test_default_data_root_is_upstreams(world, monkeypatch):
    monkeypatch.setenv("HOME", str(world))
    monkeypatch.delenv("EMBODICHAIN_DATA_ROOT")
    assert data_root() == world / ".cache/embodichain_data"
    model = put(world / ".cache/embodichain_data/Mine/mine.urdf")
    assert get_data_path("Mine/mine.urdf") == model


def test_a_miss_lists_places_in_order_closest_name_and_a_command(world):
    with pytest.raises(DataNotFoundError) as raised:
        get_data_path("UniversalRobots/UR10/ur10.urdf", near=world / "conf" / "task.yaml")
    error = raised.value
    assert isinstance(error, FileNotFoundError)
    name = "UniversalRobots/UR10/ur10.urdf"
    assert [label for label, _ in error.searched] == [
        "beside the file that names it",
        "working directory",
        "EMBODICHAIN_DATA_ROOT",
        "EMBODICHAIN_DATA_ROOT, extracted archives",
        "bundled",
        "example-robot-data",
        "mujoco_menagerie",
    ]
    lines = str(error).splitlines()
    assert lines[0] == f"no file or folder for {name!r}. Searched, in this order:"
    assert lines[1] == f"  {world}/conf/{name}  (beside the file that names it)"
    assert lines[3] == f"  {world}/store/{name}  (EMBODICHAIN_DATA_ROOT)"
    assert lines[8] == f"Did you mean {UR10!r}?"
    assert lines[9].startswith("What is here: `embodichain list robots`.")


@pytest.mark.parametrize(
    ("wrong", "right"),
    [
        ("panda.urdf", ["panda_description/urdf/panda.urdf"]),
        ("pandda.urdf", ["panda_description/urdf/panda.urdf"]),
        ("UR10.urdf", [UR10]),
        ("UniversalRobot/UR10/UR10.urdf", [UR10]),
        (
            "anymal.urdf",
            [
                "anymal_b_simple_description/robots/anymal.urdf",
                "anymal_c_simple_description/urdf/anymal.urdf",
            ],
        ),
        ("UniversalRobots/UR10/UR10.xml", [UR10]),
        ("quite/something/else.bin", []),
    ],
)
def test_closest_names(wrong, right):
    with pytest.raises(DataNotFoundError) as raised:
        get_data_path(wrong)
    assert list(raised.value.closest) == right


def test_closest_name_of_a_missing_absolute_path_is_beside_it(world):
    model = put(world / "robots/arm.urdf")
    with pytest.raises(DataNotFoundError) as raised:
        get_data_path(world / "robots/arn.urdf")
    assert raised.value.closest == (model,)
    assert [label for label, _ in raised.value.searched] == ["absolute path"]


def test_a_path_that_says_where_it_is_is_searched_there_alone(world):
    for name in ("./meshes/my_robto.urdf", "../UniversalRobots/UR10/UR10.urdf"):
        with pytest.raises(DataNotFoundError) as raised:
            get_data_path(name, near=world / "conf" / "arm.yaml")
        assert [label for label, _ in raised.value.searched] == [
            "beside the file that names it",
            "working directory",
        ]
        assert raised.value.closest == ()


def test_the_closest_names_are_in_the_same_folder(world):
    put(world / "conf/meshes/my_robot.urdf")
    with pytest.raises(DataNotFoundError) as raised:
        get_data_path("meshes/my_robto.urdf", near=world / "conf" / "arm.yaml")
    assert raised.value.closest == ("meshes/my_robot.urdf",)


def test_a_name_that_is_not_close_to_any_has_no_suggestion(world):
    for name in ("meshes/my_robto.urdf", "cad/arm_ok.urdf"):
        with pytest.raises(DataNotFoundError) as raised:
            get_data_path(name)
        assert raised.value.closest == ()


def test_without_example_robot_data_the_command_installs_it(monkeypatch):
    # As if the package were not installed.
    monkeypatch.setattr(sys, "path", [])
    monkeypatch.setattr(sys, "prefix", "/nowhere")
    with pytest.raises(DataNotFoundError) as raised:
        get_data_path("panda_description/urdf/panda.urdf")
    assert 'pip install "embodichain[robots]"' in str(raised.value)


@pytest.mark.parametrize(
    "name", ["mujoco_menagerie/franka_emika_panda/panda.xml", "menagerie:franka_emika_panda"]
)
def test_without_menagerie_the_last_line_says_what_to_install(name):
    with pytest.raises(DataNotFoundError) as raised:
        get_data_path(name)
    assert str(raised.value).splitlines()[-1].startswith("MuJoCo Menagerie: set MENAGERIE_PATH")
    assert "pip install mujoco-menagerie" in raised.value.command


def test_the_error_survives_a_process_boundary():
    with pytest.raises(DataNotFoundError) as raised:
        get_data_path("panda.urdf")
    copy = pickle.loads(pickle.dumps(raised.value))
    assert str(copy) == str(raised.value)
    assert copy.searched == raised.value.searched


@pytest.mark.parametrize("function", [get_data_path, resolve_package_uri])
def test_empty_names_are_refused(function):
    with pytest.raises(ValueError, match="empty"):
        function("")


# ------------------------------------------------------------------------------ package URIs


def test_a_model_means_its_own_package_first(world):
    model = put(world / "mine/ur_description/urdf/arm.urdf")
    mesh = put(world / "mine/ur_description/meshes/a.stl")
    put(world / "store/ur_description/meshes/a.stl")
    assert resolve_package_uri("package://ur_description/meshes/a.stl", near=model) == mesh
    # from a package beside it
    other = put(world / "mine/cell/cell.urdf")
    assert resolve_package_uri("package://ur_description/meshes/a.stl", near=other) == mesh
    # its own folder is there, the file is in another place
    fallback = put(world / "store/ur_description/meshes/b.stl")
    assert resolve_package_uri("package://ur_description/meshes/b.stl", near=model) == fallback


@pytest.mark.parametrize("slashes", ["/", "//", "///"])
def test_package_of_example_robot_data(slashes):
    mesh = "robots/ur_description/meshes/ur10/collision/base.stl"
    path = resolve_package_uri(f"package:{slashes}example-robot-data/{mesh}")
    assert path.endswith(f"share/example-robot-data/{mesh}")
    assert resolve_package_uri("package://ur_description/meshes/ur10/collision/base.stl") == path


def test_ros_packages(world, monkeypatch):
    mesh = put(world / "ros/share/my_arm/meshes/a.stl")
    other = put(world / "catkin/my_hand/meshes/b.stl")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(world / "ros"))
    monkeypatch.setenv("ROS_PACKAGE_PATH", f"/nowhere:{world / 'catkin'}")
    assert resolve_package_uri("package://my_arm/meshes/a.stl") == mesh
    assert resolve_package_uri("package://my_hand/meshes/b.stl") == other


def test_python_package_is_found_without_importing_it(world, monkeypatch):
    put(world / "site/robot_zoo/__init__.py", "raise RuntimeError('imported')")
    mesh = put(world / "site/robot_zoo/meshes/a.stl")
    monkeypatch.syspath_prepend(str(world / "site"))
    assert resolve_package_uri("package://robot_zoo/meshes/a.stl") == mesh
    assert resolve_package_uri("package://robot-zoo/meshes/a.stl") == mesh


def test_relative_absolute_and_file_uris(world):
    model = put(world / "arm/urdf/arm.urdf")
    mesh = put(world / "arm/meshes/with space.stl")
    assert resolve_package_uri("../meshes/with space.stl", near=model) == mesh
    assert resolve_package_uri("meshes/with space.stl", near=world / "arm") == mesh
    assert resolve_package_uri(mesh, near=model) == mesh
    assert resolve_package_uri("file://" + mesh.replace(" ", "%20")) == mesh


def test_a_missing_mesh_names_the_closest_one(world):
    model = put(world / "arm/urdf/arm.urdf")
    put(world / "arm/meshes/base.stl")
    with pytest.raises(DataNotFoundError) as raised:
        resolve_package_uri("package://arm/meshes/bse.stl", near=model)
    assert raised.value.closest == ("package://arm/meshes/base.stl",)
    label, path = raised.value.searched[0]
    assert (label, path) == ("package above the model file", f"{world}/arm/meshes/bse.stl")


def test_a_missing_package_names_the_closest_one():
    with pytest.raises(DataNotFoundError) as raised:
        resolve_package_uri("package://ur_descripton/meshes/a.stl")
    assert raised.value.closest == ("package://ur_description/meshes/a.stl",)


def test_unknown_scheme_is_refused():
    with pytest.raises(ValueError, match=r"scheme 'model' is not known; use package:// or file://"):
        resolve_package_uri("model://arm/a.stl")


# ------------------------------------------------------------------------------ out of a folder


@pytest.mark.parametrize(
    "uri",
    [
        "package://../../../etc/passwd",
        "package://../secret.stl",
        "package://arm/../secret.stl",
        "package://arm/meshes/../../secret.stl",
        "package://arm/..",
        "package://arm//{world}/secret.stl",
        "package:///../secret.stl",
        "package:/arm/../secret.stl",
        "package://./../secret.stl",
        "package://arm/..\\secret.stl",
        "menagerie:arm/../../secret.stl",
    ],
)
def test_a_name_does_not_lead_out_of_its_package(world, uri):
    model = put(world / "mine/arm/urdf/arm.urdf")
    put(world / "mine/secret.stl")
    put(world / "secret.stl")
    for function in (get_data_path, resolve_package_uri):
        if uri.startswith("menagerie") and function is resolve_package_uri:
            continue
        with pytest.raises(
            OutsideError, match=r"leads out of its folder|names no package"
        ) as raised:
            function(uri.format(world=world), near=model)
        assert "secret" not in str(raised.value) or "secret" in uri


def test_dots_that_stay_in_the_package_are_taken(world):
    model = put(world / "arm/urdf/arm.urdf")
    mesh = put(world / "arm/meshes/a.stl")
    assert resolve_package_uri("package://arm/urdf/../meshes/a.stl", near=model) == mesh


def test_a_link_in_a_package_beside_the_model_does_not_lead_out_of_it(world):
    model = put(world / "arm/urdf/arm.urdf")
    secret = Path(put(world / "secret.stl"))
    (world / "arm/meshes").mkdir()
    (world / "arm/meshes/a.stl").symlink_to(secret)
    (world / "arm/all").symlink_to(world)
    for name in ("meshes/a.stl", "all/secret.stl"):
        with pytest.raises(OutsideError, match="a link in it leads to"):
            resolve_package_uri(f"package://arm/{name}", near=model)


def test_links_into_the_source_of_the_same_package_are_taken(world):
    source = Path(put(world / "src/arms/meshes/a.stl"))
    put(world / "src/arms/package.xml", "<package><name>arm</name></package>")
    model = put(world / "install/share/arm/urdf/arm.urdf")
    link = world / "install/share/arm/meshes/a.stl"
    link.parent.mkdir()
    link.symlink_to(source)  # as `colcon build --symlink-install` does
    assert resolve_package_uri("package://arm/meshes/a.stl", near=model) == str(link)
    put(world / "src/arms/package.xml", "<package><name>other</name></package>")
    with pytest.raises(OutsideError):
        resolve_package_uri("package://arm/meshes/a.stl", near=model)
