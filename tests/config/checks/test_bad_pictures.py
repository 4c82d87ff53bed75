"""Mistakes in cameras, rays, views, scenes, looks and films: one report, with file and line."""

from pathlib import Path

import pytest

from embodichain.cli import main
from embodichain.config import compose, validate
from tests.config.conftest import WriteTask

ROBOT = "robot: {uid: arm, fpath: UniversalRobots/UR10/UR10.urdf, init_pos: [0, 0, 1]}\n"
HEAD = f"description: A small task.\nmax_episode_steps: 20\n{ROBOT}"
LINE = 4
"""The line of the mistake."""
LINKS = (
    "base_link, shoulder_link, upper_arm_link, forearm_link, wrist_1_link, wrist_2_link, "
    "wrist_3_link, ee_link"
)


def camera(keys: str, kind: str = "camera") -> str:
    """The sensor ``eye`` with these keys."""
    return f"sensors: {{eye: {{sensor_type: {kind}, {keys}}}}}"


def ray(keys: str) -> str:
    return camera(f"{keys}", "ray")


DOWN = "pattern: {directions: [[0, 0, -1]]}"
CAMERAS = {
    "two lenses": (
        camera("fovy: 45, intrinsics: [60, 60, 32, 32]"),
        "intrinsics: fovy is given as well: leave one of them out",
    ),
    "no such link": (
        camera("entity_cfg: {uid: arm, link_names: [ee_lnk]}"),
        f"entity_cfg.link_names: no link of 'arm' matches 'ee_lnk'; there are: {LINKS}. "
        "Did you mean 'ee_link'?",
    ),
    "no such entity": (
        camera("entity_cfg: {uid: amr}"),
        "entity_cfg.uid: no entity is called 'amr'; there are: arm. Did you mean 'arm'?",
    ),
    "a link of nothing": (
        camera("entity_cfg: {link_names: [ee_link]}"),
        "entity_cfg.uid: missing: the entity that has the links, sites or geoms",
    ),
    "no width": (camera("width: 0"), "width: must be within 1 and 16384 pixels, got 0"),
    "half a pixel": (camera("width: 64.5"), "width: expected an integer, got 64.5"),
    "a huge height": (
        camera("height: 16385"),
        "height: must be within 1 and 16384 pixels, got 16385",
    ),
    "near beyond far": (
        camera("near: 2, far: 1"),
        "far: must be greater than near, 2.0 m, got 1.0",
    ),
    "an endless far": (
        camera("far: .inf"),
        "far: must be finite, metres, got inf",
    ),
    "near behind": (camera("near: -2"), "near: must be positive, metres, got -2.0"),
    "no focal length": (
        camera("intrinsics: [0, 60, 32, 32]"),
        "intrinsics: fx, fy, cx, cy in pixels, finite, fx and fy positive; "
        "got [0.0, 60.0, 32.0, 32.0]",
    ),
    "three numbers": (
        camera("intrinsics: [60, 60, 32]"),
        "intrinsics: expected 4 values, got 3: [60, 60, 32]",
    ),
    "half a turn of view": (
        camera("fovy: 180"),
        "fovy: must be greater than 0 and less than 180 degrees, got 180.0",
    ),
    "a colour": (
        camera("data_types: [colour]"),
        "data_types.0: expected one of 'color', 'depth', 'distance', 'mask', 'normal', 'position', "
        "'disparity', got 'colour'. Did you mean 'color'?",
    ),
    "no image": (camera("data_types: []"), "data_types: names no image; leave it out for [color]"),
    "disparity of one": (
        camera("data_types: [disparity]"),
        "data_types: disparity is an image of a stereo_camera",
    ),
    "one place for two": (
        camera("left_to_right_pos: [0, 0, 0]", "stereo_camera"),
        "left_to_right_pos: must be finite and not zero, metres, got [0.0, 0.0, 0.0]",
    ),
    "other axes": (
        camera("convention: ogl"),
        "convention: expected one of 'opengl', 'ros', got 'ogl'. Did you mean 'opengl'?",
    ),
    "never": (camera("rate: 0"), "rate: must be positive and finite, Hz, got 0.0"),
    "nowhere": (
        camera("extrinsics: {eye: [.nan, 0, 0], target: [1, 0, 0]}"),
        "extrinsics.eye: must be finite, got [nan, 0.0, 0.0]",
    ),
    "no rotation": (
        camera("extrinsics: {quat: [0, 0, 0, 0]}"),
        "extrinsics.quat: must not be zero: it is a rotation, wxyz",
    ),
    "at its target": (
        camera("extrinsics: {eye: [1, 0, 0], target: [1, 0, 0]}"),
        "extrinsics.target: the eye is at the target, [1.0, 0.0, 0.0]",
    ),
    "up alone": (camera("extrinsics: {up: [0, 1, 0]}"), "extrinsics.up: belongs to eye and target"),
    "two links": (
        camera("entity_cfg: {uid: arm}, extrinsics: {parent: ee_link}"),
        "extrinsics.parent: `of` is given as well: leave one of them out",
    ),
    "no such camera": (
        camera("camera: arm/wrist"),
        "camera: no camera is called 'arm/wrist'; there are: default. "
        "Nothing is attached as 'arm'.",
    ),
    "another sensor": (
        camera("width: 64", "camra"),
        "sensor_type: unknown sensor 'camra'; one of: camera, stereo_camera, contact, "
        "force_torque, frame_pose, imu, joint_torque, ray, height_scan. Did you mean 'camera'?",
    ),
    "no rays": (ray("max_range: 3"), "pattern: give one of grid, fan, directions; got none"),
    "rays of two kinds": (
        ray("pattern: {fan: {}, directions: [[0, 0, -1]]}"),
        "pattern: give one of grid, fan, directions; got fan, directions",
    ),
    "no resolution": (
        ray("pattern: {grid: {size: [1, 1], resolution: 0}}"),
        "pattern.grid.resolution: must be positive, metres, got 0.0",
    ),
    "a fan of none": (
        ray("pattern: {fan: {horizontal_count: 0}}"),
        "pattern.fan.horizontal_count: must be at least 1, got 0",
    ),
    "a ray without direction": (
        ray("pattern: {directions: [[0, 0, -1], [0, 0, 0]]}"),
        "pattern.directions.1: must not be zero: it is a direction",
    ),
    "rays backwards": (
        ray(f"{DOWN}, max_range: -1"),
        "max_range: must be positive and finite, metres, got -1.0",
    ),
    "rays on nothing": (
        ray(f"{DOWN}, hit: [amr]"),
        "hit.0: no entity is called 'amr'; there are: arm, default_plane. Did you mean 'arm'?",
    ),
    "infinite observations": (
        ray(f"{DOWN}, observe: true, no_hit: inf"),
        "no_hit: observations must be finite: use max or zero",
    ),
    "a scan from below": (
        camera("entity_cfg: {uid: arm}, start_height: -1", "height_scan"),
        "start_height: must not be negative, metres, got -1.0",
    ),
    "no such site": (
        camera("entity_cfg: {uid: arm}, site: tcp", "frame_pose"),
        "site: no site is called 'tcp'; there are: none",
    ),
}
SCENES = {
    "ground": (
        "scene: {ground: {type: tiles}}",
        "scene.ground.type: expected one of 'checker', 'grid', 'wood', 'plain', 'none', "
        "got 'tiles'",
    ),
    "too red": (
        "scene: {ground: {colors: [[2, 0, 0]]}}",
        "scene.ground.colors.0.0: must be at most 1.0, got 2",
    ),
    "tiles": ("scene: {ground: {tile: 0}}", "scene.ground.tile: must be greater than 0.0, got 0"),
    "mirror": (
        "scene: {ground: {reflectance: 2}}",
        "scene.ground.reflectance: must be at most 1.0, got 2",
    ),
    "sky": ("scene: {sky: {top: [0, 0]}}", "scene.sky.top: expected 3 values, got 2: [0, 0]"),
    "flat table": (
        "scene: {table: {size: [1, 1, 0]}}",
        "scene.table.size.2: must be greater than 0.0, got 0",
    ),
    "table top thicker than the table": (
        "scene: {table: {size: [1, 1, 0.3], thickness: 0.4}}",
        "scene.table.thickness: at most the table's height, 0.3 m, got 0.4",
    ),
    "oval pedestal": (
        "scene: {pedestal: {size: [0.2, 0.3, 1]}}",
        "scene.pedestal.size: a cylinder is as wide as long, got [0.2, 0.3, 1.0]; or shape: box",
    ),
    "torn file": (
        "scene: {fpath: torn.xml}",
        "scene.fpath: {cwd}/torn.xml:1: not well-formed XML: no element found",
    ),
    "keyframe of nothing": (
        "scene: {keyframe: home}",
        "scene.keyframe: is one of a scene's file: fpath is missing",
    ),
    "lamp": (
        "scene: {lights: {sun: {light_type: lamp}}}",
        "scene.lights.sun.light_type: expected one of 'point', 'sun', 'direction', 'directional', "
        "'spot', got 'lamp'",
    ),
    "closed spot": (
        "scene: {lights: {sun: {light_type: spot, cutoff: 0}}}",
        "scene.lights.sun.cutoff: must be greater than 0.0, got 0",
    ),
    "light without direction": (
        "scene: {lights: {sun: {light_type: directional, direction: [0, 0, 0]}}}",
        "scene.lights.sun.direction: must not be zero, got [0.0, 0.0, 0.0]",
    ),
    "dark light": (
        "scene: {lights: {sun: {intensity: -3}}}",
        "scene.lights.sun.intensity: must not be negative, got -3.0",
    ),
    "unknown key": (
        "scene: {grund: {}}",
        "scene.grund: unknown key; allowed: fpath, keyframe, ground, terrain, sky, ambient, "
        "headlight, sun, lights, table, pedestal. Did you mean 'ground'?",
    ),
    "view of no place": (
        "views: {a: {fovy: 30}}",
        "views.a: needs one of eye, direction, camera, got none",
    ),
    "view of two places": (
        "views: {a: {eye: [0, 0, 1], direction: [1, 0, 0]}}",
        "views.a: needs one of eye, direction, camera, got eye and direction",
    ),
    "view of something, from a point": (
        "views: {a: {eye: [0, 0, 1], show: [arm]}}",
        "views.a.show: needs direction: only then the distance is computed",
    ),
    "view of nothing": (
        "views: {a: {direction: [0, 1, 1], show: [arn]}}",
        "views.a.show.0: no entity is called 'arn'; there are: arm. Did you mean 'arm'?",
    ),
    "view into itself": (
        "views: {a: {eye: [0, 0, 1], target: [0, 0, 1]}}",
        "views.a.eye: the camera is at the point it looks at, [0.0, 0.0, 1.0]",
    ),
    "view of all": (
        "views: {a: {eye: [0, 0, 1], fovy: 180}}",
        "views.a.fovy: must be less than 180.0, got 180",
    ),
    "view of no camera": (
        "views: {a: {camera: arm/wrist}}",
        "views.a.camera: no camera is called 'arm/wrist'; there are: none",
    ),
    "view of no link": (
        "views: {a: {eye: [1, 0, 0], body: arm/ee_lnk}}",
        f"views.a.body: no link of 'arm' matches 'ee_lnk'; there are: {LINKS}; geoms: geom_0, "
        "geom_1, geom_2, ... (31 in all). Did you mean 'ee_link'?",
    ),
    "view that follows nothing": (
        "views: {a: {eye: [0, 0, 1], follow: pose}}",
        "views.a.follow: belongs to body: the view follows nothing",
    ),
    "name of a file's camera": (
        "views: {a/b: {eye: [0, 0, 1]}}",
        "views.a/b: a view's name must not contain '/', as those of files do",
    ),
    "name of the robot": (
        "sensors: {arm: {sensor_type: camera}}",
        "sensors.arm: uid 'arm' is taken by an entity; every entity needs its own",
    ),
    "name of a view": (
        "sensors: {default: {sensor_type: camera}}",
        "sensors.default: the scene has a camera 'default' already: choose another name",
    ),
    "mesh without triangles": (
        "objects: {cup: {shape: {shape_type: Mesh, fpath: torn.stl}}}",
        "objects.cup.shape.fpath: {cwd}/torn.stl: it contains no triangles",
    ),
    "broken texture": (
        "objects: {cup: {shape: {shape_type: Cube, visual_material: {textures: [torn.png]}}}}",
        "objects.cup.shape.visual_material.textures.0: {cwd}/torn.png: no texture: cannot identify "
        "image file",
    ),
    "no textures": (
        "objects: {cup: {shape: {shape_type: Cube, visual_material: {textures: []}}}}",
        "objects.cup.shape.visual_material.textures: names no image; leave it out for a plain "
        "surface",
    ),
    "a texture of nothing": (
        "events: {paint: {func: randomize_texture, mode: reset, params: {of: {uid: amr}}}}",
        "events.paint.params.of.uid: no entity is called 'amr'; there are: arm. Did you mean "
        "'arm'?",
    ),
}


@pytest.fixture
def said(write_task: WriteTask):
    """``said(text, *overrides)``: what `validate` says of a task with these lines at its end."""
    Path("torn.xml").write_text("<mujoco><worldbody>")
    Path("torn.stl").write_text("solid x\nnot a mesh")
    Path("torn.png").write_bytes(b"\x89PNG broken")

    def says(text: str, *overrides: str) -> list[str]:
        write_task(text=f"{HEAD}{text}\n")
        return [str(p) for p in validate(compose(["task=mine", *overrides]))]

    return says


@pytest.mark.parametrize("name", CAMERAS)
def test_sensors(said, name: str) -> None:
    text, message = CAMERAS[name]
    assert said(text) == [f"conf/task/mine.yaml:{LINE}: task.sensors.eye.{message}"]


@pytest.mark.parametrize("name", SCENES)
def test_scenes_and_views(said, name: str) -> None:
    text, message = SCENES[name]
    message = message.replace("{cwd}", str(Path.cwd()))
    assert said(text) == [f"conf/task/mine.yaml:{LINE}: task.{message}"]


def test_files_that_mujoco_refuses_are_at_their_keys(said) -> None:
    Path("flat.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 3\nf 2 4 3\n")
    Path("hole.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 9\n")
    text = (
        "objects:\n"
        "  cup: {shape: {shape_type: Cube}}\n"
        "  lid:\n"
        "    shape:\n"
        "      shape_type: Mesh\n"
        "      fpath: hole.obj\n"
        "  tray:\n"
        "    shape: {shape_type: Mesh}\n"
        "views:\n"
        "  side: {eye: [1, 0, 1]}"
    )
    hole = f"{Path.cwd()}/hole.obj: MuJoCo cannot compile it: in face 0, vertex index 8 does not"
    flat = f"{Path.cwd()}/flat.obj: MuJoCo cannot compile it: mesh 'tray/mesh' has coplanar"
    lid, tray = said(text, "+task.objects.tray.shape.fpath=flat.obj")
    assert lid.startswith(f"conf/task/mine.yaml:9: task.objects.lid.shape.fpath: {hole}")
    assert tray.startswith(f"command line: task.objects.tray.shape.fpath: {flat}")


def test_a_sensor_as_a_view_is_called(said) -> None:
    assert said("views: {a: {eye: [0, 0, 1]}}\nsensors: {a: {sensor_type: camera}}") == [
        "conf/task/mine.yaml:5: task.sensors.a: the scene has a camera 'a' already: "
        "choose another name"
    ]


def test_all_mistakes_are_in_one_report(said, capsys: pytest.CaptureFixture[str]) -> None:
    said(
        "sensors:\n"
        "  one: {sensor_type: camera, width: 0, near: 2, far: 1}\n"
        "  two: {sensor_type: camera, fovy: 0}\n"
        "views:\n"
        "  side: {eye: [0, 0, 1], up: [0, 0, 0]}\n"
        "scene:\n"
        "  keyframe: home"
    )
    assert main(["run", "task=mine", "record=none"]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "5 mistakes:"
    places = {line.split(": ")[0].strip(): line.split(": ")[1] for line in lines[1:]}
    assert places == {
        "conf/task/mine.yaml:5": "task.sensors.one.far",  # its width is on this line, too
        "conf/task/mine.yaml:6": "task.sensors.two.fovy",
        "conf/task/mine.yaml:8": "task.views.side.up",
        "conf/task/mine.yaml:10": "task.scene.keyframe",
    }
    assert any("task.sensors.one.width" in line for line in lines)


def test_pictures_beyond_the_memory(said) -> None:
    big = camera("width: 10000, height: 10000, data_types: [color, position], observe: true")
    assert said(big, "num_envs=1") == []  # 1e8 pixels of 4 and of 12 bytes
    (line,) = said(big, "num_envs=100000")
    assert line.startswith(
        "conf/task/mine.yaml:4: task.sensors.eye.width: 100000 environments x 10000 x 10000 pixels "
        "of color, position need 149011.6 GiB; there are "
    )


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("record.images={format: gif}", "record.images.format: expected one of 'h264', 'jpeg', "),
        ("record.images={rate: 0}", "record.images.rate: must be greater than 0.0, got 0"),
        ("record.images={envs: [-1]}", "record.images.envs.0: must be at least 0, got -1"),
        ("record.images=true", "record.images: expected a map, got true"),
        ("video.size=[97,64]", "video.size.0: expected a multiple of 2, got 97"),
        ("video.size=[14,64]", "video.size.0: must be at least 16, got 14"),
        ("video.size=[64,10000]", "video.size.1: must be at most 8192, got 10000"),
        ("video.every=0", "video.every: must be at least 1, got 0"),
        ("video.max_seconds=nan", "video.max_seconds: must be greater than 0.0, got nan"),
        ("video.sise=3", "video.sise: unknown key; allowed: size, every, max_seconds, format. Did"),
        ("video=3", "video: expected true or false or a map, got 3"),
    ],
)
def test_films_and_pictures_in_logs(said, line: str, message: str) -> None:
    (found,) = said("", line)
    assert found.startswith(f"command line: {message}")


EYE = camera("width: 33, height: 32")


@pytest.mark.parametrize(
    ("text", "images", "message"),
    [
        (
            EYE,
            "{cameras: [default, eey], format: png}",
            "cameras.1: no camera 'eey'. Cameras: default, eye. Did you mean 'eye'?",
        ),
        (EYE, "{envs: [0, 2], format: png}", "envs: no such environments: [2]; num_envs is 2"),
        (
            EYE,
            "{format: h264}",
            "size: h264 needs even widths and heights; eye has 33 x 32 pixels: set a size, or "
            "format: jpeg",
        ),
        ("", "{}", "cameras: the task has no camera sensors: name cameras. Cameras: default"),
        (EYE, "{cameras: []}", "cameras: expected at least 1 value, got 0: []"),
        (EYE, "{envs: []}", "envs: expected at least 1 value, got 0: []"),
        (EYE, "{size: [0, 4], format: png}", "size.0: must be at least 1, got 0"),
    ],
)
def test_pictures_of_cameras_in_logs(said, text: str, images: str, message: str) -> None:
    """The same from a file, with its line."""
    found = [f"command line: record.images.{message}"]
    assert said(text, f"record.images={images}", "num_envs=2") == found
    Path("conf/record").mkdir()
    Path("conf/record/seen.yaml").write_text(f"format: mcap\nimages: {images}\n")
    (found,) = said(text, "record=seen", "num_envs=2")
    assert found == f"conf/record/seen.yaml:2: record.images.{message}"


def test_pictures_of_cameras_are_among_the_mistakes(
    said, capsys: pytest.CaptureFixture[str]
) -> None:
    said("sensors:\n  eye: {sensor_type: camera}\nevents:\n  a: {func: reset_al}")
    images = "record.images={cameras: [ey], envs: [1]}"
    for verb in ("validate", "run"):
        assert main([verb, "task=mine", images]) == 2
        lines = capsys.readouterr().err.splitlines()
        assert [line.split(": ")[:2] for line in lines[1:]] == [
            ["  command line", "record.images.envs"],
            ["  command line", "record.images.cameras.0"],
            ["  conf/task/mine.yaml:7", "task.events.a.func"],
        ]
    assert main(["show", "task=mine", "~task.events.a", images]) == 2
    assert not Path("outputs").exists()
