"""Terrains: heights of each kind of patch, where patches are, what is refused."""

from typing import Any

import mujoco
import numpy as np
import pytest

from embodichain.lab.sim.cfg import SimulationManagerCfg
from embodichain.lab.sim.compiler.compile_scene import compile_scene
from embodichain.lab.sim.compiler.scene.terrain import Terrain, terrain_heights
from embodichain.lab.sim.compiler.scene_parts import SceneParts
from embodichain.lab.sim.configs.scene_cfg import (
    BlocksPatchCfg,
    FlatPatchCfg,
    GapsPatchCfg,
    PatchCfg,
    RoughPatchCfg,
    SceneCfg,
    SlopePatchCfg,
    StairsPatchCfg,
    StonesPatchCfg,
    TerrainCfg,
    WavesPatchCfg,
)
from embodichain.utils.errors import ConfigError


def terrain(**changes: Any) -> TerrainCfg:
    patches = changes.pop("patches", {"flat": FlatPatchCfg()})
    sizes = {"levels": 2, "size": 4.0, "border": 0.0, "platform": 1.0}
    return TerrainCfg(patches=patches, **{**sizes, **changes})


def middle_line(patch: PatchCfg, **changes: Any) -> tuple[np.ndarray, np.ndarray]:
    """x in metres from the middle, and heights along it at y = 0, of one patch at level 0."""
    heights, _ = terrain_heights(terrain(patches={"it": patch}, levels=1, **changes))
    count = heights.shape[1]
    return (np.arange(count) - 0.5 * (count - 1)) * 0.1, heights[count // 2]


def test_a_slope_rises_to_its_edge_or_falls_to_it() -> None:
    x, up = middle_line(SlopePatchCfg(slope=(0.2, 0.2)))
    # Rise over run 0.2 from the edge at 2 m to the platform's at 0.5 m: 0.3 m below.
    assert up[np.abs(x) < 0.5] == pytest.approx(-0.3)
    assert up[0] == pytest.approx(-0.2 * 0.05) and up[-1] == up[0]
    _, down = middle_line(SlopePatchCfg(slope=(0.2, 0.2), direction="down"))
    assert down == pytest.approx(-up)


def test_stairs_have_steps_of_one_height() -> None:
    x, heights = middle_line(StairsPatchCfg(step_height=(0.1, 0.1), step_depth=0.5))
    # 1.5 m from the edge to the platform: three steps of half a metre.
    assert sorted(set(heights)) == pytest.approx([-0.3, -0.2, -0.1, 0.0])
    assert heights[np.abs(x) > 1.5] == pytest.approx(0.0)
    assert heights[(np.abs(x) > 1.0) & (np.abs(x) < 1.5)] == pytest.approx(-0.1)
    assert heights[np.abs(x) < 0.5] == pytest.approx(-0.3)


def test_gaps_are_as_wide_and_deep_as_configured() -> None:
    x, heights = middle_line(GapsPatchCfg(width=(0.3, 0.3), land=0.6, depth=0.4))
    ditch = (np.abs(x) > 0.5) & (np.abs(x) < 0.8) | (np.abs(x) > 1.4) & (np.abs(x) < 1.7)
    assert heights[ditch] == pytest.approx(-0.4)
    assert heights[~ditch] == pytest.approx(0.0)


def test_stones_have_gaps_between_them() -> None:
    cfg = StonesPatchCfg(size=(0.6, 0.6), gap=(0.4, 0.4), height=(0.0, 0.0), depth=0.5)
    x, heights = middle_line(cfg)
    # A stone of 0.6 m is in the middle of every metre, counted from the middle of the patch.
    near = np.abs(x - np.round(x))
    beyond = np.abs(x) > 0.5
    assert (heights[beyond & (near < 0.3)] == 0.0).all()
    assert (heights[beyond & (near > 0.3)] == -0.5).all()


@pytest.mark.parametrize(
    ("patch", "low", "high"),
    [
        (RoughPatchCfg(height=(0.05, 0.05)), -0.05, 0.05),
        (WavesPatchCfg(height=(0.05, 0.05)), -0.05, 0.05),
        (BlocksPatchCfg(height=(0.05, 0.05)), 0.0, 0.05),
        (FlatPatchCfg(), 0.0, 0.0),
    ],
)
def test_heights_are_within_their_limits(patch: PatchCfg, low: float, high: float) -> None:
    heights, _ = terrain_heights(terrain(patches={"it": patch}, levels=1))
    assert low <= heights.min() and heights.max() <= high
    if high:
        assert heights.max() > 0.8 * high and np.unique(heights).size > 20
    middle = heights[16:24, 16:24]
    assert (middle == 0.0).all()


def test_levels_are_rows_of_growing_difficulty() -> None:
    patches: dict[str, Any] = {"waves": WavesPatchCfg(height=(0.02, 0.12), columns=2)}
    heights, found = terrain_heights(terrain(patches=patches, levels=3))
    assert heights.shape == (80, 120)
    # Nodes are 0.1 m apart, so none is at a crest: the highest is a little lower.
    for level, amplitude in enumerate((0.02, 0.07, 0.12)):
        highest = heights[:, 40 * level : 40 * level + 40].max()
        assert 0.9 * amplitude < highest <= amplitude
    assert found.kinds == ("waves", "waves")
    assert found.origins[:, 0, 0] == pytest.approx([-4.0, 0.0, 4.0])
    assert found.origins[0, :, 1] == pytest.approx([-2.0, 2.0])


def test_the_seed_alone_chooses_the_bytes() -> None:
    rough = {"rough": RoughPatchCfg(), "blocks": BlocksPatchCfg()}
    first, same = (terrain_heights(terrain(patches=rough))[0] for _ in range(2))
    assert first.tobytes() == same.tobytes()
    assert not np.array_equal(first, terrain_heights(terrain(patches=rough, seed=1))[0])
    # A patch does not change when another is added, and its levels and columns are not alike.
    more, _ = terrain_heights(terrain(patches={"flat": FlatPatchCfg(), **rough}))
    assert np.array_equal(more[40:80, :40], first[:40, :40])
    twice = {"rough": RoughPatchCfg(height=(0.1, 0.1), columns=2)}
    pair, _ = terrain_heights(terrain(patches=twice))
    corners = [pair[r : r + 40, c : c + 40] for r in (0, 40) for c in (0, 40)]
    assert len({corner.tobytes() for corner in corners}) == 4


def compiled(cfg: TerrainCfg) -> tuple[mujoco.MjModel, Terrain]:
    sim = SimulationManagerCfg(headless=True, scene=SceneCfg(terrain=cfg))
    scene = compile_scene(SceneParts(sim))
    if scene.terrain is None:
        raise RuntimeError("no terrain")
    return scene.model, scene.terrain


def ground_below(model: mujoco.MjModel, data: mujoco.MjData, x: float, y: float) -> float:
    hit = np.zeros(1, np.int32)
    start, down = np.array([x, y, 5.0]), np.array([0.0, 0.0, -1.0])
    return 5.0 - float(mujoco.mj_ray(model, data, start, down, None, 1, -1, hit))


def test_the_model_has_the_heights_with_the_first_patch_at_the_origin() -> None:
    slope = SlopePatchCfg(slope=(0.2, 0.4), direction="down")
    model, found = compiled(terrain(patches={"hill": slope}, border=1.0))
    assert found.half == pytest.approx((4.95, 2.95))
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    # The hill is 0.3 m high; its top is the environment's origin. One metre off, it is 0.1 m lower.
    assert found.origins[0, 0, 2] == pytest.approx(0.3)
    assert ground_below(model, data, 0.0, 0.0) == pytest.approx(0.0, abs=1e-6)
    assert ground_below(model, data, 1.0, 0.3) == pytest.approx(-0.1, abs=1e-6)
    assert ground_below(model, data, -2.5, 0.0) == pytest.approx(-0.3, abs=1e-6)
    assert ground_below(model, data, 4.0, 0.0) == pytest.approx(0.3, abs=1e-6)
    data.mocap_pos[0] = -found.origins[1, 0]
    mujoco.mj_kinematics(model, data)
    assert ground_below(model, data, -4.0, 0.0) == pytest.approx(-0.3, abs=1e-6)


def test_a_flat_terrain_is_a_plane() -> None:
    model, _ = compiled(terrain())
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    assert [ground_below(model, data, x, 0.4) for x in (-1.3, 0.0, 1.9)] == pytest.approx([0] * 3)


@pytest.mark.parametrize(
    ("changes", "path", "words"),
    [
        ({"resolution": 0.6}, "resolution", "an eighth of size"),
        ({"platform": 4.0}, "platform", "less than size"),
        ({"platform": 0.1}, "platform", "twice the resolution"),
        ({"resolution": 0.002}, "resolution", "4e+06"),
        ({"patches": {}}, "patches", "names no patch"),
    ],
)
def test_numbers_that_do_not_fit_are_refused(
    changes: dict[str, Any], path: str, words: str
) -> None:
    with pytest.raises(ConfigError) as caught:
        terrain_heights(terrain(**changes))
    problem = caught.value.problems[0]
    assert problem.path == f"scene.terrain.{path}"
    assert words in problem.message
