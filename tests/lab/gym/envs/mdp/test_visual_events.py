"""How surfaces, lights and cameras look: the numbers in each environment's model, and pictures."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from embodichain.lab.gym.envs.cfg import EventCfg
from embodichain.lab.sim.cfg import LightCfg
from embodichain.utils.errors import ConfigError
from tests.lab.gym.envs.mdp.test_events import build

CUBE = {"entity_cfg": {"uid": "cube"}}
LAMP = LightCfg(light_type="spot", init_pos=(0.5, 0.5, 2.0), color=(1.0, 0.5, 0.0), intensity=15.0)


def event(func: str, mode: str = "reset", **params) -> EventCfg:
    return EventCfg(func=func, mode=mode, params=params)


def models(env) -> list:
    return [env.sim.engine.model_of(i) for i in range(env.num_envs)]


def material(env, field: str) -> np.ndarray:
    which = env.sim.engine.model.material("cube/material").id
    return np.array([getattr(m, field)[which] for m in models(env)])


def test_an_object_gets_a_colour_and_a_finish(make) -> None:
    what = event(
        "randomize_visual_material",
        **CUBE,
        base_color_range=[[0.2, 0.0, 0.5], [0.8, 0.0, 1.0]],
        roughness_range=[0.25, 0.75],
        metallic_range=[1.0, 1.0],
    )
    env, drawn = build(make, what, num_envs=64)
    color, rough = drawn.last["base_color"], drawn.last["roughness"][:, 0]
    rgba = material(env, "mat_rgba")
    assert np.allclose(rgba[:, :3], color, atol=1e-6) and (rgba[:, 3] == 1).all()
    assert np.allclose(material(env, "mat_roughness"), rough, atol=1e-6)
    assert np.allclose(material(env, "mat_specular"), 0.5 * (1 - rough), atol=1e-6)
    assert np.allclose(material(env, "mat_shininess"), 1 - rough, atol=1e-6)
    assert (material(env, "mat_metallic") == 1).all()
    low, high = np.array([0.2, 0.0, 0.5]), np.array([0.8, 0.0, 1.0])
    assert (color >= low).all() and (color <= high).all()
    error = 4 * (high - low) / np.sqrt(12 * 64) + 1e-9
    assert (np.abs(color.mean(0) - (low + high) / 2) < error).all()
    before = material(env, "mat_rgba")
    env.reset(options={"reset_ids": [5]})
    changed = (material(env, "mat_rgba") != before).any(axis=1)
    assert np.flatnonzero(changed).tolist() == [5]


def test_links_get_colours_of_their_own(make) -> None:
    arm = {"uid": "ur10", "link_names": ["forearm_link"]}
    what = event(
        "randomize_visual_material", entity_cfg=arm, base_color_range=[[1, 0, 0], [1, 0, 0]]
    )
    env, _ = build(make, what)
    model = models(env)[1]
    body = env.robot.body_of("forearm_link")
    red = (model.geom_rgba[:, :3] == [1, 0, 0]).all(axis=1)
    visible = (model.geom_bodyid == body) & (model.geom_group < 3)
    assert np.array_equal(red, visible) and visible.any()


def test_a_material_is_set(make) -> None:
    mat = {"base_color": [0.1, 0.5, 0.2, 0.4], "roughness": 0.2, "emissive": [0.0, 0.5, 0.0]}
    env = make(
        events={"e": event("set_rigid_object_visual_material", "startup", **CUBE, mat_cfg=mat)}
    )
    assert np.allclose(material(env, "mat_rgba"), [0.1, 0.5, 0.2, 0.4], atol=1e-6)
    assert np.allclose(material(env, "mat_specular"), 0.4, atol=1e-6)
    assert np.allclose(material(env, "mat_emission"), 0.5, atol=1e-6)


def test_a_light_begins_at_what_was_declared(make) -> None:
    what = event(
        "randomize_light",
        entity_cfg={"uid": "lamp"},
        position_range=[[-0.5, 0, 0], [0.5, 0, 1]],
        intensity_range=[-5.0, 15.0],
        direction_range=[[1, 0, 0], [1, 0, 0]],
    )
    env, drawn = build(make, what, num_envs=32, lights={"lamp": LAMP})
    for _ in range(20):
        env.reset()
    number = env.sim.engine.model.light("lamp").id
    pos = np.array([m.light_pos[number] for m in models(env)])
    assert np.allclose(pos, np.array([0.5, 0.5, 2.0]) + drawn.last["position"])
    strength = (15.0 + drawn.last["intensity"]) / 30.0
    diffuse = np.array([m.light_diffuse[number] for m in models(env)])
    assert np.allclose(diffuse, strength * [1.0, 0.5, 0.0], atol=1e-6)
    specular = np.array([m.light_specular[number] for m in models(env)])
    assert np.allclose(specular, 0.3 * diffuse, atol=1e-6)
    half = np.sqrt(0.5)
    assert np.allclose([m.light_dir[number] for m in models(env)], [half, 0, -half])


def test_a_lights_colour_is_the_draw(make) -> None:
    what = event(
        "randomize_light", entity_cfg={"uid": "lamp"}, color_range=[[0.2, 0.2, 1], [0.4, 0.9, 1]]
    )
    env, drawn = build(make, what, lights={"lamp": LAMP})
    number = env.sim.engine.model.light("lamp").id
    diffuse = np.array([m.light_diffuse[number] for m in models(env)])
    assert np.allclose(diffuse, 0.5 * drawn.last["color"], atol=1e-6)


def test_a_camera_moves_around_its_place(make) -> None:
    env = make(
        events={
            "pose": event(
                "randomize_camera_pose",
                position_range=[[0.1, -0.2, 0], [0.3, 0.2, 0]],
                rotation_range=[[0, 0, 30], [0, 0, 30]],
            ),
            "view": event("randomize_camera_fovy", fovy_range=[30, 50]),
        },
        num_envs=16,
    )
    for _ in range(10):
        env.reset()
    compiled = env.sim.engine.model
    offset = np.array([m.cam_pos[0] for m in models(env)]) - compiled.cam_pos[0]
    assert (offset[:, 0] >= 0.1 - 1e-9).all() and (offset[:, 0] <= 0.3).all()
    assert (np.abs(offset[:, 1]) <= 0.2).all() and np.allclose(offset[:, 2], 0)
    quat = np.array([m.cam_quat[0] for m in models(env)])
    before = Rotation.from_quat(compiled.cam_quat[0], scalar_first=True)
    turned = before.inv() * Rotation.from_quat(quat, scalar_first=True)
    assert np.allclose(turned.as_euler("xyz", degrees=True), [0, 0, 30], atol=1e-6)
    fovy = np.array([m.cam_fovy[0] for m in models(env)])
    assert (fovy >= 30).all() and (fovy <= 50).all() and len(np.unique(fovy)) == 16


def test_pictures_show_it_in_each_environment(make) -> None:
    env = make(
        events={
            "paint": event(
                "randomize_visual_material", **CUBE, base_color_range=[[0, 0, 0], [1, 1, 1]]
            )
        },
        num_envs=2,
    )
    env.reset()
    pictures = [env.sim.render(i, width=160, height=120).astype(int) for i in range(2)]
    different = (np.abs(pictures[0] - pictures[1]).max(axis=2) > 30).sum()
    assert 10 < different < 2000  # the cube's pixels, and little else


def test_physics_does_not_notice(make) -> None:
    plain, painted = (
        make(),
        make(
            events={
                "paint": event(
                    "randomize_visual_material", **CUBE, base_color_range=[[0, 0, 0], [1, 1, 1]]
                ),
                "view": event("randomize_camera_fovy", fovy_range=[30, 50]),
            }
        ),
    )
    for env in (plain, painted):
        env.reset()
        for _ in range(3):
            env.step(env.robot.get_qpos(target=True))
    assert np.array_equal(plain.sim.engine.rows, painted.sim.engine.rows)


@pytest.mark.parametrize(
    ("what", "part"),
    [
        (
            event("randomize_visual_material", **CUBE, texture_path="textures"),
            "textures are compiled into the model",
        ),
        (event("randomize_visual_material", **CUBE), "else nothing changes"),
        (
            event("randomize_visual_material", **CUBE, base_color_range=[[0] * 3, [2] * 3]),
            "must be within [0, 1]",
        ),
        (
            event("randomize_visual_material", entity_cfg={"uid": "ur10"}, roughness_range=[0, 1]),
            "links share materials",
        ),
        (
            event(
                "set_rigid_object_visual_material",
                entity_cfg={"uid": "ur10"},
                mat_cfg={"base_color": [1, 1, 1, 1]},
            ),
            "'ur10' is not a rigid object",
        ),
        (
            event("set_rigid_object_visual_material", **CUBE, mat_cfg={"colour": [1, 1, 1, 1]}),
            "mat_cfg",
        ),
        (event("randomize_light", entity_cfg={"uid": "lmp"}), "Did you mean 'lamp'?"),
        (event("randomize_camera_pose", camera="defualt"), "Did you mean 'default'?"),
        (event("randomize_camera_fovy", fovy_range=[0, 50]), "within (0, 180)"),
    ],
)
def test_wrong_parameters(make, what, part) -> None:
    with pytest.raises(ConfigError) as caught:
        make(events={"e": what}, lights={"lamp": LAMP})
    assert part in str(caught.value)
