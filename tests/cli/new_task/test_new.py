"""`new task`: what is written validates and passes its own tests, and nothing is overwritten."""

import itertools
import json
import math
import os
import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

from embodichain.cli import main
from tests.helpers.commands import Commands
from tests.helpers.mjcf_robots import ROBOTS

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]

REPO = Path(__file__).parents[3]


def python(*arguments: str, cwd: Path | None = None) -> str:
    """Runs python without the working directory on its path, as the installed command does."""
    done = subprocess.run(
        [sys.executable, "-P", *arguments],
        cwd=cwd,
        env={**os.environ, "PYTEST_ADDOPTS": ""},
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def new(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, list[str]]:
    assert main(["new", "task", *arguments, "--json"]) == 0, capsys.readouterr().err
    data: dict[str, list[str]] = json.loads(capsys.readouterr().out)
    return data


@pytest.fixture
def follow(commands: Commands) -> Callable[..., str]:
    """Executes the `next` commands of `new`, with short runs; returns the output of pytest."""

    def execute(*steps: list[str]) -> str:
        files: list[str] = []
        for program, *words in (command.split() for step in steps for command in step):
            if program == "python":
                assert words[:-1] == ["-m", "pytest"]
                files.append(words[-1])
                continue
            assert program == "embodichain"
            if words[0] == "train":  # minutes
                continue
            short = ["max_steps=2", "record=none", "--quiet"] if words[0] == "run" else []
            done = commands.run(*words, *short, safe_path=True)
            assert done.returncode == 0, done.stdout + done.stderr
        assert len(files) == len(steps)
        quiet = ("-q", "-p", "no:cacheprovider")
        done = commands.run(*files, *quiet, program="pytest", safe_path=True)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    return execute


def lint(*files: str) -> None:
    settings = ["--config", str(REPO / "pyproject.toml"), "--no-cache"]
    python("-m", "ruff", "check", *settings, *files)
    python("-m", "ruff", "format", "--check", *settings, *files)


def test_a_task_in_yaml_works_at_once(
    follow: Callable[..., str], capsys: pytest.CaptureFixture[str]
) -> None:
    made = new(capsys, "my_reach")
    assert made["wrote"] == ["conf/task/my_reach.yaml", "tests/test_my_reach.py"]
    assert made["pyproject"] == ""
    assert "4 passed" in follow(made["next"])
    lint("tests/test_my_reach.py")


def test_a_task_in_python_works_at_once(
    follow: Callable[..., str], capsys: pytest.CaptureFixture[str]
) -> None:
    made = new(capsys, "my_push", "--python")
    assert made["wrote"] == ["conf/task/my_push.yaml", "my_push.py", "tests/test_my_push.py"]
    assert "4 passed" in follow(made["next"])
    lint("my_push.py", "tests/test_my_push.py")
    code = "import sys; sys.path.append('.'); import gymnasium as gym; "
    code += "env = gym.make('my_push:MyPush-v0', num_envs=3); print(env.unwrapped.num_envs)"
    assert python("-c", code) == "3\n"


@pytest.mark.parametrize("source", [".", "src"])
def test_a_package_gets_both_inside_and_is_told_its_entry_points(
    source: str, follow: Callable[..., str], capsys: pytest.CaptureFixture[str]
) -> None:
    project = '[project]\nname = "my-robots"\nversion = "1"\n'
    Path("pyproject.toml").write_text(project)
    package = Path(source, "my_robots")
    package.mkdir(parents=True)
    (package / "__init__.py").write_text('"""Mine."""\n')
    made = new(capsys, "stack", "--python")
    assert set(made["wrote"]) == {
        (package / "conf/__init__.py").as_posix(),
        (package / "conf/task/stack.yaml").as_posix(),
        (package / "tasks/__init__.py").as_posix(),
        (package / "tasks/stack.py").as_posix(),
        "tests/test_stack.py",
    }
    if source == "src":  # the harder one: nothing is installed
        assert "4 passed" in follow(made["next"])
    lint(source, "tests")
    assert Path("pyproject.toml").read_text() == project
    needed = tomllib.loads(str(made["pyproject"]))
    assert needed["tool"]["setuptools"]["package-data"] == {"my_robots": ["conf/**/*.yaml"]}
    points = needed["project"]["entry-points"]
    assert points == {
        "embodichain.conf": {"my_robots": "my_robots.conf"},
        "embodichain.tasks": {"stack": "my_robots.tasks.stack"},
    }
    Path("pyproject.toml").write_text(project + str(made["pyproject"]))
    again = new(capsys, "sort")
    assert again["pyproject"] == ""
    assert again["wrote"] == [(package / "conf/task/sort.yaml").as_posix(), "tests/test_sort.py"]


def test_nothing_is_overwritten(capsys: pytest.CaptureFixture[str]) -> None:
    Path("tests").mkdir()
    Path("tests/test_mine.py").write_text("# mine\n")
    assert main(["new", "task", "mine"]) == 2
    assert "files exist, and are never replaced: tests/test_mine.py" in capsys.readouterr().err
    assert [str(path) for path in Path().rglob("*.*")] == ["tests/test_mine.py"]
    assert Path("tests/test_mine.py").read_text() == "# mine\n"
    Path("tests/test_mine.py").unlink()
    assert main(["new", "task", "mine"]) == 0
    before = Path("conf/task/mine.yaml").read_text()
    assert "next:\n  embodichain validate task=mine" in capsys.readouterr().out
    assert main(["new", "task", "mine", "--python"]) == 2
    assert Path("conf/task/mine.yaml").read_text() == before
    assert not Path("mine.py").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("task", "push-cube"), "'push-cube' is not a name for a task"),
        (("task", "../reach2"), "is not a name for a task"),
        (("task", "class"), "is not a name for a task"),
        (("task", "2fast"), "is not a name for a task"),
        (("task", "reach"), "there is a task 'reach' already"),
        (("task", "json", "--python"), "Python has a module 'json' already"),
        (("taks", "mine"), "'taks' is not one of 'task', 'embodiment'."),
        (("task",), "NAME"),
        (("task", "mine", "--pyhton"), "Did you mean '--python'?"),
    ],
)
def test_what_cannot_be_made_is_refused(
    arguments: tuple[str, ...], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["new", *arguments]) == 2
    assert words in capsys.readouterr().err
    assert list(Path().iterdir()) == []


def test_a_broken_pyproject_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    Path("pyproject.toml").write_text("[project\n")
    assert main(["new", "task", "mine"]) == 2
    assert "pyproject.toml cannot be read" in capsys.readouterr().err


def test_a_packages_wheel_holds_its_tasks(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    project = '[project]\nname = "my-robots"\nversion = "1"\n'
    Path("src/my_robots").mkdir(parents=True)
    Path("src/my_robots/__init__.py").write_text('"""Mine."""\n')
    Path("pyproject.toml").write_text(project)
    needed = str(new(capsys, "stack")["pyproject"])
    Path("pyproject.toml").write_text(f"{project}\n{needed}\n")
    assert new(capsys, "sort")["pyproject"] == ""
    pip = ["-m", "pip", "--disable-pip-version-check", "install", "--quiet", "--no-deps"]
    target = tmp_path / "installed"
    python(*pip, "--no-index", "--no-build-isolation", "--target", str(target), ".")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(target))
    assert {"stack", "sort"} <= set(python("-m", "embodichain", "list", "tasks").split())
    python("-m", "embodichain", "validate", "task=stack")


def test_a_table_that_is_there_is_not_written_again(capsys: pytest.CaptureFixture[str]) -> None:
    Path("mine").mkdir()
    Path("mine/__init__.py").write_text('"""Mine."""\n')
    project = '[project]\nname = "mine"\nversion = "1"\n'
    data = '[tool.setuptools.package-data]\nmine = ["*.txt"]\n'
    Path("pyproject.toml").write_text(project + data)
    needed = str(new(capsys, "stack")["pyproject"])
    assert '# in [tool.setuptools.package-data], which exists:\nmine = ["conf' in needed
    Path("pyproject.toml").write_text(
        f'[build-system]\nbuild-backend = "hatchling.build"\nrequires = []\n{project}'
    )
    assert "package-data" not in str(new(capsys, "sort")["pyproject"])


_SMALL = """<mujoco model="small"><worldbody><body name="base">
  <geom type="cylinder" size="0.05 0.02" pos="0 0 0.02"/>
  <body name="upper" pos="0 0 0.04">
    <joint name="turn" axis="0 0 1" range="-90 90"/>
    <geom type="capsule" fromto="0 0 0 0 0 0.15" size="0.015"/>
    <body name="lower" pos="0 0 0.15">
      <joint name="bend" axis="0 1 0" range="10 120"/>
      <geom type="capsule" fromto="0 0 0 0.15 0 0" size="0.012"/>
      <body name="rod" pos="0.15 0 0">
        <joint name="reach" type="slide" axis="1 0 0" range="0 0.08"/>
        <geom type="capsule" fromto="0 0 0 0.08 0 0" size="0.008"/>
      </body>
    </body>
  </body>
</body></worldbody></mujoco>"""


_NAMED = [
    ("UniversalRobots/UR10/UR10.urdf", []),
    ("panda_description/urdf/panda.urdf", []),
    ("panda_description/urdf/panda.urdf", ["--python"]),
    ("small.xml", []),
    ("small.xml", ["--python"]),
    ("ur5e.xml", []),
    ("ur5e.xml", ["--python"]),
    ("hand.xml", []),
]


def test_a_task_fits_the_robot_that_is_named(
    follow: Callable[..., str], capsys: pytest.CaptureFixture[str]
) -> None:
    for name, text in {"small": _SMALL, **ROBOTS}.items():
        Path(f"{name}.xml").write_text(text)
    made = [
        new(capsys, f"reach_{Path(file).stem.lower()}{len(flags)}", "--robot", file, *flags)
        for file, flags in _NAMED
    ]
    assert f"{4 * len(_NAMED)} passed" in follow(*(task["next"] for task in made))
    lint(*(path for task in made for path in task["wrote"] if path.endswith(".py")))


def test_what_is_written_of_a_robot(capsys: pytest.CaptureFixture[str]) -> None:
    Path("small.xml").write_text(_SMALL)
    new(capsys, "mine", "--robot", "small.xml")
    task = yaml.safe_load(Path("conf/task/mine.yaml").read_text())
    # `bend` is at rest in the middle of its range, 65 degrees down: the rod's end would be below
    # the ground, at 0.04 + 0.15 - (0.15 + 0.04 + 0.08) sin 65 - 0.008 = -0.06
    assert task["robot"]["init_qpos"] == [0, 1.1345, 0.04]
    assert task["robot"]["init_pos"] == [0, 0, pytest.approx(0.07, abs=0.011)]
    pedestal = {"size": [0.2, 0.2, task["robot"]["init_pos"][2]], "pos": [0, 0, 0]}
    assert task["scene"]["pedestal"] == {**pedestal, "collision": False}
    params = task["actions"]["arm"]["params"]
    assert params["scale"] == {"turn": 0.6, "bend": 0.6, "reach": 0.02}
    pair = task["rewards"]["distance"]["params"]
    assert pair["from"] == {"uid": "small", "link_names": ["lower"]}


def test_a_robot_with_mimicking_joints_and_long_names(capsys: pytest.CaptureFixture[str]) -> None:
    inertia = 'ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"'
    inertial = f'<inertial><mass value="1"/><inertia {inertia}/>'
    lead, free = "lead" * 120, "free" * 150  # no key of a flow mapping has both
    limits = {lead: (0, 0.5), "twice": (-1, 0.4), free: (0, 0.5), "mirror": (0, 0.5)}
    mimics = {"twice": (lead, 2), "mirror": (free, -1)}
    parts = [f'<link name="base">{inertial}</inertial></link>']
    for name, (low, high) in {**limits, "slide.x": (0, 0.2)}.items():
        parent, slope = mimics.get(name, ("", 1))
        mimic = f'<mimic joint="{parent}" multiplier="{slope}"/>' if parent else ""
        kind = "prismatic" if name == "slide.x" else "revolute"
        parts.append(
            f'<link name="{name}_link">{inertial}</inertial></link>'
            f'<joint name="{name}" type="{kind}"><parent link="base"/><child link="{name}_link"/>'
            f'<limit lower="{low}" upper="{high}" effort="9" velocity="1"/>{mimic}</joint>'
        )
    Path("fingers.urdf").write_text(f'<robot name="fingers">{"".join(parts)}</robot>')
    new(capsys, "mine", "--robot", "fingers.urdf")
    task = yaml.safe_load(Path("conf/task/mine.yaml").read_text())
    # `twice` is inside up to 0.4, so its leader up to 0.2; `mirror` only at 0.
    assert task["robot"]["init_qpos"] == [0.1, 0.2, 0, 0, 0.1]
    scale = {lead: 0.6, free: 0.6, r"slide\.x": 0.05}
    assert task["actions"]["arm"]["params"]["scale"] == scale
    assert main(["validate", "task=mine"]) == 0, capsys.readouterr().err


def test_a_file_with_actuators_is_driven_by_them(capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("ur5e", "hand"):
        Path(f"{name}.xml").write_text(ROBOTS[name])
        new(capsys, f"my_{name}", "--robot", f"{name}.xml")
    arm, hand = (
        yaml.safe_load(Path(f"conf/task/my_{name}.yaml").read_text()) for name in ("ur5e", "hand")
    )
    assert arm["robot"]["drive_pros"] == hand["robot"]["drive_pros"] == {"stiffness": "file"}
    assert arm["actions"]["arm"]["func"] == "default_offset_joint_position"
    assert hand["actions"]["ctrl"]["func"] == "actuator_ctrl"
    assert main(["new", "task", "my_class", "--python", "--robot", "hand.xml"]) == 2
    assert "these joints have no position servo: right_coupler_joint" in capsys.readouterr().err


def test_a_robot_that_cannot_act_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    Path("stone.xml").write_text(
        '<mujoco><worldbody><body name="a"><geom size="1"/></body></worldbody></mujoco>'
    )
    assert main(["new", "task", "mine", "--robot", "stone.xml"]) == 2
    assert "no joint moves" in capsys.readouterr().err
    assert main(["new", "task", "mine", "--robot", "nowhere.urdf"]) == 2
    assert "nowhere.urdf" in capsys.readouterr().err
    assert not Path("conf").exists()


REED = """<mujoco>
  <option timestep="{dt}"/>
  <worldbody>
    <body name="base" pos="0 0 .5"><geom type="box" size=".05 .05 .05"/>
      <body name="reed" pos="0 0 .06">
        <joint name="bend" axis="0 1 0" stiffness="6" damping="0.001" springref="20"/>
        <geom type="box" size=".005 .005 .04" mass=".004" contype="0" conaffinity="0"/></body>
      <body name="stick" pos=".1 0 .06"><joint name="turn" axis="0 1 0" range="-60 60"/>
        <geom type="capsule" fromto="0 0 0 0 0 .2" size=".01" mass=".2"/></body></body>
  </worldbody>
  <actuator><position name="t" joint="turn" kp="20" kv="2" ctrlrange="-1 1"/></actuator>
</mujoco>"""


@pytest.mark.parametrize(
    ("dt", "written", "words"),
    [(0.0004, 0.0004, ["the file's; stable"]), (0.005, 0.001, ["largest", "0.005, 0.002 s"])],
)
def test_the_time_step_is_the_files_or_the_largest_that_is_stable(capsys, dt, written, words):
    # a spring of 6 N m/rad on 2.1e-6 kg m^2: 1700 rad/s, stable up to 2 / 1700 s = 1.2 ms
    Path("reed.xml").write_text(REED.format(dt=dt))
    made = new(capsys, "reed", "--robot", "reed.xml")
    task = yaml.safe_load(Path("conf/task/reed.yaml").read_text())
    assert made["physics_dt"] == task["physics"]["physics_dt"] == written
    assert task["sim_steps_per_control"] == round(0.02 / written)
    assert all(word in made["why"] for word in words)
    assert main(["run", "task=reed", "policy=zero", "max_steps=60", "record=none", "seed=1"]) == 0
    assert "diverged" not in capsys.readouterr().err


def test_a_urdf_gets_the_largest_time_step_that_is_stable(capsys):
    new(capsys, "arm", "--robot", "UniversalRobots/UR10/UR10.urdf")
    task = yaml.safe_load(Path("conf/task/arm.yaml").read_text())
    assert (task["physics"]["physics_dt"], task["sim_steps_per_control"]) == (0.005, 4)


_GANTRY = """<mujoco><worldbody><body name="x" pos="0 0 0.5">
  <joint name="x" type="slide" axis="1 0 0" range="-0.05 0.05"/><geom size="0.02"/>
  <body name="y"><joint name="y" type="slide" axis="0 1 0" range="-0.05 0.05"/><geom size="0.02"/>
  <body name="z"><joint name="z" type="slide" axis="0 0 1" range="-0.05 0.05"/><geom size="0.02"/>
  </body></body></body></worldbody><actuator><position joint="x" kp="50"/>
  <position joint="y" kp="50"/><position joint="z" kp="50"/></actuator></mujoco>"""


def test_the_marker_is_only_where_the_tool_gets(capsys: pytest.CaptureFixture[str]) -> None:
    """Slides move 0.03 m, a quarter of their range; an arm of 0.5 m would have 0.12 m."""
    Path("gantry.xml").write_text(_GANTRY)
    new(capsys, "mine", "--robot", "gantry.xml")
    task = yaml.safe_load(Path("conf/task/mine.yaml").read_text())
    assert task["actions"]["arm"]["params"]["scale"] == 0.03
    place = task["events"]["place_marker"]["params"]["position_range"]
    assert place == [[-0.03] * 3, [0.03] * 3]


_TWO_LINKS = """<mujoco><compiler angle="radian"/><worldbody><body name="upper" pos="0 0 0.2">
  <joint name="lift" axis="0 1 0" range="-2 2"/><geom type="capsule" fromto="0 0 0 0 0 0.3"
  size="0.02"/><body name="lower" pos="0 0 0.3"><joint name="bend" axis="0 1 0" range="-2 2"/>
  <geom type="capsule" fromto="0 0 0.05 0 0 0.2" size="0.02"/><site name="tcp" pos="0 0 0.2"/>
  </body></body></worldbody><actuator><position joint="lift" kp="50"/>
  <position joint="bend" kp="50"/></actuator>{key}</mujoco>"""


def test_a_stretched_arm_is_bent_and_its_marker_stays_in_its_plane(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Its tool moves in x and z; upright, at 0.5 m above the base, it cannot move in z at all.

    `lift` is the first joint of the chain and stays; of `bend` 1.2 rad is the most that is tried.
    """
    Path("two.xml").write_text(_TWO_LINKS.format(key=""))
    new(capsys, "mine", "--robot", "two.xml")
    task = yaml.safe_load(Path("conf/task/mine.yaml").read_text())
    lift, bend = task["robot"]["init_qpos"]
    assert (lift, abs(bend)) == (0, pytest.approx(1.2))
    x, z = 0.2 * math.sin(bend), 0.5 + 0.2 * math.cos(bend)
    assert task["objects"]["marker"]["init_pos"] == pytest.approx([x, 0, z], abs=0.006)
    low, high = task["events"]["place_marker"]["params"]["position_range"]
    assert low == [-value for value in high]
    assert high[1] == 0
    assert high[0] == high[2] > 0.03
    for corner in itertools.product((-high[0], high[0]), repeat=2):
        # The law of cosines; the upper link is 0.3 m long, the lower one 0.2 m.
        goal_x, goal_z = x + 0.9 * corner[0], z - 0.2 + 0.9 * corner[1]
        square = goal_x**2 + goal_z**2
        elbow = math.copysign(math.acos((square - 0.3**2 - 0.2**2) / (2 * 0.3 * 0.2)), bend)
        fore = math.atan2(0.2 * math.sin(elbow), 0.3 + 0.2 * math.cos(elbow))
        assert abs(elbow - bend) <= 0.61
        assert abs(math.atan2(goal_x, goal_z) - fore - lift) <= 0.61


def test_a_files_own_pose_is_kept(capsys: pytest.CaptureFixture[str]) -> None:
    key = '<keyframe><key name="home" qpos="0.1 0.2"/></keyframe>'
    Path("two.xml").write_text(_TWO_LINKS.format(key=key))
    new(capsys, "mine", "--robot", "two.xml")
    task = yaml.safe_load(Path("conf/task/mine.yaml").read_text())
    assert task["robot"]["init_qpos"] == [0.1, 0.2]


@pytest.mark.parametrize(
    ("file", "tool"),
    [
        # Both are stretched at zero. The jaw of the first has one more joint than its tool.
        ("so_arm_description/urdf/so101.urdf", "gripper_frame_link"),
        ("ur_description/urdf/ur5_robot.urdf", "tool0"),
        ("kinova_description/robots/kinova.urdf", "j2s6s200_end_effector"),
    ],
)
def test_package_arms_have_room_around_their_tool(
    capsys: pytest.CaptureFixture[str], file: str, tool: str
) -> None:
    new(capsys, "mine", "--robot", file)
    task = yaml.safe_load(Path("conf/task/mine.yaml").read_text())
    place = task["events"]["place_marker"]["params"]
    assert place["relative_to"]["link_names"] == [tool]
    half = place["position_range"][1][0]
    assert half >= 0.05
    near = task["metrics"]["success"]["params"]["threshold"]
    assert near <= 0.5 * half + 0.005
