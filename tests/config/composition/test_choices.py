"""What is said of choices of groups: one report each, at the line or word that is wrong."""

from pathlib import Path

import pytest

from embodichain.cli import main


def said(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    """What a command says of a mistake, on one line."""
    assert main([*words]) == 2
    return " ".join(capsys.readouterr().err.split())


def write(name: str, text: str) -> None:
    path = Path("conf") / f"{name}.yaml"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


@pytest.mark.usefixtures("empty_cwd")
def test_a_second_choice_is_told_where_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    assert said(capsys, "validate", "task=reach", "+embodiment=panda") == (
        "error: command line: embodiment: an option is chosen already: write embodiment=NAME, "
        "without +"
    )
    write("task/mine", "defaults:\n  - reach\n  - /embodiment@_here_: panda\n  - _self_\n")
    text = said(capsys, "validate", "task=mine")
    assert text.startswith("error: conf/task/mine.yaml:3: defaults: ")
    assert "reach.yaml:4 chooses an option already" in text
    assert text.endswith("write `override /embodiment@_here_: panda`")


@pytest.mark.usefixtures("empty_cwd")
def test_an_option_that_a_file_names_wrongly_is_told_its_line(
    capsys: pytest.CaptureFixture[str],
) -> None:
    write("task/mine", "defaults:\n  - reach\n  - /scene@scene: lba\n  - _self_\n")
    text = said(capsys, "validate", "task=mine")
    assert text.startswith("error: conf/task/mine.yaml:3: scene: unknown option 'lba'")
    assert text.endswith("Did you mean 'lab'?")


@pytest.mark.parametrize(
    ("earlier", "later"),
    [
        ("task=push_cube", "task=reach"),
        ("embodiment=panda", "embodiment@task=ur10"),
        ("record=mcap", "record=none"),
        ("scene@task.scene=lab", "scene@task.scene=studio"),
        ("variation=[mass]", "variation=[noise]"),
    ],
)
def test_the_last_of_two_choices_counts_and_is_noted(
    capsys: pytest.CaptureFixture[str], earlier: str, later: str
) -> None:
    task = [] if earlier.startswith("task=") else ["task=reach"]
    assert main(["validate", *task, earlier, later]) == 0
    err = capsys.readouterr().err
    assert err.count(f"{earlier} is not used, because {later} comes later") == 1
    assert main(["validate", *task, later, later]) == 0
    assert "is not used" not in capsys.readouterr().err


@pytest.mark.usefixtures("empty_cwd")
def test_an_empty_embodiment_is_one_mistake(capsys: pytest.CaptureFixture[str]) -> None:
    write("embodiment/mine", "")
    assert said(capsys, "validate", "task=reach", "embodiment=mine") == (
        "error: conf/embodiment/mine.yaml: embodiment: the file is empty: an embodiment has at "
        "least a robot"
    )


@pytest.mark.usefixtures("empty_cwd")
def test_an_embodiment_has_nothing_of_a_task(capsys: pytest.CaptureFixture[str]) -> None:
    reward = "rewards: {up: {func: height, params: {of: {uid: robot, link: tool}}}}\n"
    objects = "objects: {cup: {shape: {shape_type: Sphere, radius: 0.02}}}\n"
    write("embodiment/mine", f"defaults: [ur10, _self_]\n{reward}{objects}")
    assert said(capsys, "validate", "task=reach", "embodiment=mine") == (
        "error: conf/embodiment/mine.yaml:3: embodiment: it names no object and no task: write "
        "objects, rewards in a task"
    )
    # It is not advised to others, either.
    assert "mine" not in said(capsys, "validate", "task=reach", "embodiment=go2")


@pytest.mark.usefixtures("empty_cwd")
def test_embodiments_that_cannot_load_are_listed_with_their_lines(
    capsys: pytest.CaptureFixture[str],
) -> None:
    write("embodiment/broken", "robot: [1, 2\n")
    write("embodiment/lost", "defaults:\n  - nothere\n  - _self_\nrobot: {uid: robot}\n")
    assert main(["list", "embodiments"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "broken: conf/embodiment/broken.yaml:2: malformed YAML" in text
    assert "lost: conf/embodiment/lost.yaml:2: embodiment: unknown option 'nothere'" in text


@pytest.mark.slow
def test_joints_that_a_robot_lacks_are_one_mistake(capsys: pytest.CaptureFixture[str]) -> None:
    text = said(capsys, "validate", "task=humanoid_velocity", "embodiment=go2")
    text = text[text.index("error: ") :]  # files that take long to read are told, too
    assert text == (
        "error: command line: embodiment: go2 lacks what the task needs: joints "
        ".*_hip_roll_joint, .*_hip_yaw_joint. Embodiments that have it: g1."
    )


def test_a_task_without_its_embodiment_is_one_mistake(capsys: pytest.CaptureFixture[str]) -> None:
    assert said(capsys, "validate", "task=reach", "~embodiment") == (
        "error: command line: embodiment: the task has no robot without it. Write "
        "embodiment=NAME in place of ~embodiment."
    )
    wrong = "task.rewards.near.wieght=1"
    text = said(capsys, "validate", "task=reach", "~embodiment", wrong)
    assert text.startswith("2 mistakes:")
    assert "task.rewards.near.wieght" in text


def test_a_package_that_the_config_lacks_is_a_mistake(capsys: pytest.CaptureFixture[str]) -> None:
    show = ["run", "task=reach", "--cfg", "job", "--package"]
    assert "error: --package: there is no 'variation' in the config" in said(
        capsys, *show, "variation"
    )
    assert "Did you mean 'goal'?" in said(capsys, *show, "task.objects.gaol")
    assert main([*show, "task.objects"]) == 0
    assert "@package task.objects" in capsys.readouterr().out


@pytest.mark.usefixtures("empty_cwd")
def test_an_unknown_key_of_an_object_is_one_mistake(capsys: pytest.CaptureFixture[str]) -> None:
    plate = "plate: {shpe: {shape_type: Sphere, radius: 0.02}}"
    layout = "events: {layout: {params: {objects: {plate: {on: table}}}}}"
    write("task/mine", f"defaults: [clutter_pick, _self_]\nobjects:\n  {plate}\n{layout}\n")
    text = said(capsys, "validate", "task=mine")
    assert text.startswith("error: conf/task/mine.yaml:3: task.objects.plate.shpe: unknown key")
    write("object/mine", "shpe: {shape_type: Cube}\ncollision: pieces\n")
    text = said(capsys, "validate", "task=clutter_pick", "object@task.objects.mug=mine")
    assert text.startswith("error: conf/object/mine.yaml:1: task.objects.mug.shpe: unknown key")


def test_a_region_says_how_many_numbers_it_has(capsys: pytest.CaptureFixture[str]) -> None:
    region = "task.events.layout.params.objects.bowl.region"
    text = said(capsys, "validate", "task=clutter_pick", f"{region}=[[0,1]]")
    assert text == f"error: command line: {region}: expected at least 2 items, got [[0, 1]]"
    text = said(capsys, "validate", "task=clutter_pick", f"{region}=[[0,1,2],[0,1]]")
    assert text == f"error: command line: {region}.0: expected at most 2 items, got [0, 1, 2]"
