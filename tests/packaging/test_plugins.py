"""A package outside adds one thing of each kind with one file each: those of docs/extending.md.

The texts of the page are built into a wheel, which is installed into a folder of its own.
"""

import json
import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from PIL import Image

pytestmark = pytest.mark.unmeasured

PAGE = Path(__file__).parents[2] / "docs" / "extending.md"
FILES = re.compile(
    r"^<!-- (pyproject\.toml|my_package/\w+\.py) -->\n```\w+\n(.*?)^```", re.MULTILINE | re.DOTALL
)
UNDRAWN = "scene_png=false"
BUILD = "import setuptools.build_meta, sys; print(setuptools.build_meta.build_wheel(sys.argv[1]))"
# Each line is one command; one process, since most of a command's time goes into its imports.
RUN = """
import json, sys
from embodichain.cli import main

sys.argv[:] = ["embodichain"]
for line in json.loads(sys.stdin.read()):
    code = main(line)
    sys.stdout.flush()
    if code:
        sys.exit(f"{line} ended with {code}")
"""


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder that the wheel of the page's package is installed in."""
    source = tmp_path_factory.mktemp("my_package")
    (source / "my_package").mkdir()
    (source / "my_package" / "__init__.py").touch()
    texts = dict(FILES.findall(PAGE.read_text(encoding="utf-8")))
    assert len(texts) >= 6
    for name, text in texts.items():
        (source / name).write_text(text, encoding="utf-8")
    subprocess.run(
        [sys.executable, "-c", BUILD, "dist"], cwd=source, check=True, capture_output=True
    )
    (wheel,) = (source / "dist").glob("*.whl")
    target = tmp_path_factory.mktemp("site")
    with zipfile.ZipFile(wheel) as archive:  # what pip does with a wheel of Python alone
        archive.extractall(target)
    return target


def run(
    installed: Path, folder: Path, *lines: list[str], code: str = RUN
) -> subprocess.CompletedProcess[str]:
    path = os.pathsep.join([str(installed), os.environ.get("PYTHONPATH", str(PAGE.parents[1]))])
    return subprocess.run(
        [sys.executable, "-c", code],
        input=json.dumps(lines),
        capture_output=True,
        text=True,
        check=False,
        cwd=folder,
        env={**os.environ, "PYTHONPATH": path},
    )


def test_one_file_adds_a_thing_of_each_kind(installed: Path, tmp_path: Path) -> None:
    tiny = ["num_envs=2", "algo.steps=4", "total_timesteps=16", "eval.episodes=2", "record=none"]
    turning = "task.actions={all: {func: together, params: {of: {uid: robot}}}}"
    steps = {"steps": [{"wipe": {"of": "cube", "height": 0.2}}]}
    expert = "policy={func: expert, params: " + json.dumps(steps).replace('"', "") + "}"
    done = run(
        installed,
        tmp_path,
        ["list", "formats"],
        ["list", "learners"],
        ["run", "task=lift_cube", expert, "viewer=ticker", "num_envs=1", "episodes=1", UNDRAWN],
        ["export", "last", "--format", "jsonl", "--to", "3", "-o", "log.jsonl"],
        ["train", "task=reach", "task.max_episode_steps=4", "algo=reinforce", *tiny],
        ["run", "task=reach", turning, "max_steps=2", "record=none", UNDRAWN],
    )
    assert done.returncode == 0, done.stdout + done.stderr
    said = " ".join(done.stdout.split())
    assert "jsonl the log Lines of JSON, one for each step of each environment." in said
    assert "reinforce my_package.reinforce:Reinforce none" in said
    assert re.search(r"^episode 0 ended in step \d+$", done.stderr, re.MULTILINE)
    lines = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    assert [(line["step"], line["env"]) for line in lines] == [(0, 0), (1, 0), (2, 0)]


def test_one_file_adds_a_launcher(installed: Path, tmp_path: Path) -> None:
    sweep = ["-m", "task=cart_pole", "seed=1,2", "max_steps=2", "hydra.sweep.dir=sweep", UNDRAWN]
    done = run(
        installed,
        tmp_path,
        [
            "run",
            *sweep,
            "hydra/launcher=forks",
            "hydra.launcher.retries=1",
            "hydra.launcher.cpus=2",
        ],
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "hydra/launcher=forks" in done.stderr
    logs = [path.parent.name for path in (tmp_path / "sweep").rglob("*.mcap")]
    assert sorted(logs) == ["0", "1"], done.stderr


def test_one_file_adds_an_engine(installed: Path, tmp_path: Path) -> None:
    job = ["task=cart_pole", "policy=zero", "num_envs=3", "seed=1", "max_steps=5", UNDRAWN]
    done = run(
        installed,
        tmp_path,
        ["list", "engines"],
        ["validate", "task=cart_pole", "sim.engine=counting", "record.state=keyframes"],
        ["run", *job, "sim.engine=counting", "hydra.run.dir=counted"],
        ["replay", "counted"],
        ["replay", "counted", "--verify"],
        ["run", *job, "hydra.run.dir=plain"],
        ["diff", "counted", "plain"],
    )
    assert done.returncode == 0, done.stdout + done.stderr
    said = " ".join(done.stdout.split())
    assert "counting MuJoCo on the CPU, with a count of physics steps." in said
    counted = re.findall(r"^(\d+) physics steps$", done.stderr, re.MULTILINE)
    assert counted and int(counted[-1]) >= 15, done.stderr
    assert "identical to the bit" in said, done.stdout + done.stderr
    assert ", counting 1.0 of my-package, MuJoCo " in said
    # Where the package is not installed, the log is read, and its engine and package are named.
    alone = run(
        tmp_path / "nothing",
        tmp_path,
        ["replay", "counted"],
        ["replay", "counted", "--verify"],
        code=RUN.replace("if code:", "if code != (1 if '--verify' in line else 0):"),
    )
    assert alone.returncode == 0, alone.stdout + alone.stderr
    expected = (
        "it was recorded with 'counting 1.0', an engine of the package 'my-package', which has "
        "none of this name here: pip install my-package"
    )
    assert expected in " ".join(alone.stdout.split())
    assert expected in " ".join(alone.stderr.split())


def test_one_file_adds_a_renderer(
    installed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("EMBODICHAIN_RENDERER", "flat")
    done = run(
        installed,
        tmp_path,
        ["list", "renderers"],
        ["render", "task=cart_pole", "scene.png"],
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "flat Every picture in one colour" in " ".join(done.stdout.split())
    with Image.open(tmp_path / "scene.png") as picture:
        assert picture.convert("RGB").getcolors() == [(picture.width * picture.height, (0, 160, 0))]
    monkeypatch.setenv("EMBODICHAIN_RENDERER", "flt")
    code = RUN.replace("if code:", "if code != 2:")
    done = run(installed, tmp_path, ["render", "task=cart_pole", "b.png"], code=code)
    assert done.returncode == 0 and "Did you mean 'flat'?" in done.stderr


def test_mistakes_name_what_is_installed(installed: Path, tmp_path: Path) -> None:
    (tmp_path / "log.mcap").touch()
    code = RUN.replace("if code:", "if code != 2:")
    steps = "[{wip: cube}]"
    done = run(
        installed,
        tmp_path,
        ["export", "--help"],
        ["validate", "--train", "task=reach", "algo=reinforc"],
        ["validate", "--train", "task=reach", "algo=reinforce", "algo.step=3"],
        ["validate", "task=reach", "viewer=tickr"],
        ["validate", "task=reach", "sim.engine=countin"],
        ["validate", "task=reach", "sim.engine=counting", "device=cuda"],
        ["validate", "task=lift_cube", f"policy={{func: expert, params: {{steps: {steps}}}}}"],
        code=code.replace("code = main(line)", "code = main(line) or 2"),
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "ros2, rrd, jsonl, robomimic" in " ".join(done.stdout.split())
    said = " ".join(done.stderr.split())
    for hint in ("reinforce", "steps", "ticker", "counting", "wipe"):
        assert f"Did you mean '{hint}'?" in said
    assert "sim.engine=counting does not run on 'cuda': device=cpu, or sim.engine=warp" in said
    assert not (tmp_path / "outputs").exists()


def test_a_broken_package_is_named_where_its_things_are_asked_for(tmp_path: Path) -> None:
    site = tmp_path / "site"
    info = site / "broken-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: broken\nVersion: 1.0\n")
    groups = ("formats", "learners", "viewers", "steps", "engines")
    (info / "entry_points.txt").write_text(
        "".join(f"[embodichain.{group}]\nlost = lost_{group}\n" for group in groups)
    )
    for group in groups:
        (site / f"lost_{group}.py").write_text(f"raise RuntimeError('no {group} today')\n")
    steps = "policy={func: expert, params: {steps: [{lost: cube}]}}"
    done = run(
        site,
        tmp_path,
        ["validate", "task=reach", "viewer=lost"],
        ["validate", "task=reach", "sim.engine=lost"],
        ["validate", "--train", "task=reach", "algo=lost"],
        ["validate", "task=lift_cube", steps],
        ["validate", "task=reach"],
        code=RUN.replace("if code:", "if code != (2 if 'lost' in str(line) else 0):"),
    )
    assert done.returncode == 0, done.stdout + done.stderr
    for group in ("learners", "viewers", "steps", "engines"):
        assert f"(entry point 'lost' of broken) could not be loaded: RuntimeError: no {group}" in (
            " ".join(done.stderr.split())
        )
    assert "no formats today" not in done.stderr
