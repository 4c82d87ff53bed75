"""What tells two models apart: every field that physics reads, and nothing else."""

import mujoco
import numpy as np
import pytest

from embodichain.learning.checkpoints.physics_values import DESCRIBED, physics_values

XML = """
<mujoco>
  <option timestep="0.004"/>
  <asset>
    <material name="red" rgba="1 0 0 1"/>
    <mesh name="wedge" vertex="0 0 0  1 0 0  0 1 0  0 0 2"/>
  </asset>
  <worldbody>
    <geom type="plane" size="1 1 1"/>
    <body name="arm" pos="0 0 1">
      <joint name="lift" type="slide" axis="0 0 1" damping="3" range="0 1"/>
      <joint name="turn" type="ball"/>
      <geom name="look" type="box" size="1 1 1" contype="0" conaffinity="0" mass="0"/>
      <geom name="hull" type="mesh" mesh="wedge"/>
      <site name="tip" pos="0 0 0.5"/>
      <body name="tool">
        <joint name="bend" armature="0.1"/>
        <geom size="0.1" mass="2"/>
      </body>
    </body>
  </worldbody>
  <tendon>
    <fixed name="both"><joint joint="lift" coef="2"/><joint joint="bend" coef="-1"/></fixed>
  </tendon>
  <equality><joint joint1="lift" joint2="bend" polycoef="0 1 0 0 0"/></equality>
  <actuator>
    <position name="up" joint="lift" kp="50" kv="4" forcerange="-9 9"/>
    <motor name="pull" tendon="both"/>
  </actuator>
  <sensor><jointpos name="angle" joint="bend"/></sensor>
  <contact><exclude body1="arm" body2="tool"/></contact>
</mujoco>
"""


def different(old: str, new: str) -> dict[str, tuple[object, object]]:
    """``element.field`` -> values before and after a change of the text."""
    assert XML.count(old) == 1
    a, b = (physics_values(mujoco.MjModel.from_xml_string(t)) for t in (XML, XML.replace(old, new)))
    return {
        f"{element}.{field}": (a.get(element, {}).get(field), b.get(element, {}).get(field))
        for element in {*a, *b}
        for field in {*a.get(element, {}), *b.get(element, {})}
        if a.get(element, {}).get(field) != b.get(element, {}).get(field)
    }


@pytest.mark.parametrize(
    ("old", "new", "found"),
    [
        ('damping="3"', 'damping="4"', {"joint lift.damping": (3, 4)}),
        ('timestep="0.004"', 'timestep="0.005"', {"option.timestep": (0.004, 0.005)}),
        ('armature="0.1"', "", {"joint bend.armature": (0.1, None)}),
        ('size="0.1" mass="2"', 'size="0.1" mass="3"', {"body tool.mass", "body tool.inertia"}),
        ('pos="0 0 0.5"', 'pos="0 0 0.25"', {"site tip.pos": ([0, 0, 0.5], [0, 0, 0.25])}),
        ('coef="-1"', 'coef="-2"', {"tendon both.path"}),
        ('kp="50"', 'kp="60"', {"actuator up.gainprm", "actuator up.biasprm"}),
        ('forcerange="-9 9"', 'forcerange="-9 8"', {"actuator up.forcerange": ([-9, 9], [-9, 8])}),
        (
            'joint="bend"/></sensor>',
            'joint="lift"/></sensor>',
            {"sensor angle.obj": ("bend", "lift")},
        ),
        ('polycoef="0 1', 'polycoef="0 2', {"equality #0.data"}),
        ('0 0 2"/>', '0 0 2.5"/>', {"geom #0 of arm.mesh_mean", "geom #0 of arm.mesh_spread"}),
        ('<contact><exclude body1="arm" body2="tool"/></contact>', "", {"exclude.bodies"}),
    ],
)
def test_a_change_has_a_name_and_two_values(old: str, new: str, found: object) -> None:
    seen = different(old, new)
    if isinstance(found, dict):
        assert seen == found
    else:
        assert isinstance(found, set)
        assert found <= seen.keys()


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('rgba="1 0 0 1"', 'rgba="0 1 0 1"'),
        ('name="look" type="box"', 'type="sphere"'),
        ('<geom name="look" type="box" size="1 1 1" contype="0" conaffinity="0" mass="0"/>', ""),
        ("<worldbody>", '<worldbody><light pos="0 0 3"/><camera name="eye" pos="1 1 1"/>'),
    ],
)
def test_what_is_only_seen_does_not_count(old: str, new: str) -> None:
    assert different(old, new) == {}


def test_no_array_of_the_model_is_forgotten() -> None:
    """A release of MuJoCo that adds a field to physics fails here, and so does a misspelling."""
    model = mujoco.MjModel.from_xml_string(XML)
    public = [name for name in dir(model) if not name.startswith("_")]
    arrays = {name for name in public if isinstance(getattr(model, name), np.ndarray)}
    assert arrays >= DESCRIBED
    left_out = {name for name in arrays - DESCRIBED if not name.startswith(OTHERS)}
    assert left_out == set(LEFT_OUT.split())


OTHERS = (
    *(
        "cam_",
        "light_",
        "mat_",
        "tex_",
        "text_",
        "skin_",
        "tuple_",
        "numeric_",
        "name",
    ),  # not physics
    *("key_", "bvh_", "oct_", "efm0_", "efmC_", "B_", "D_", "M_", "map", "ten_J_", "flexedge_"),
    *("mesh_", "flex_", "plugin", "tree_dof", "tree_body"),  # of which moments and counts are taken
)
LEFT_OUT = """
actuator_acc0 actuator_actadr actuator_ctrladr actuator_group actuator_historyadr actuator_length0
actuator_outadr actuator_outnum actuator_plugin actuator_user
body_bvhadr body_bvhnum body_conaffinity body_contype body_dofadr body_dofnum body_geomadr
body_geomnum body_invweight0 body_jntadr body_jntnum body_margin body_plugin body_rootid
body_sameframe body_simple body_subtreemass body_treeid body_user body_weldid
dof_M0 dof_Madr dof_bodyid dof_invweight0 dof_jntid dof_length dof_parentid dof_simplenum dof_treeid
geom_aabb geom_castshadow geom_group geom_matid geom_plugin geom_rbound geom_rgba geom_sameframe
geom_user hfield_pathadr jnt_actuatorid jnt_group jnt_plasticadr jnt_user pair_signature
sensor_adr sensor_datatype sensor_historyadr sensor_needstage sensor_plugin sensor_user
site_dataid site_group site_matid site_rgba site_sameframe site_user
tendon_actuatorid tendon_group tendon_invweight0 tendon_length0 tendon_matid tendon_plasticadr
tendon_rgba tendon_treeid tendon_treenum tendon_user tendon_width
"""
"""Colours, groups, users' own numbers, indices, and what MuJoCo derives from the rest."""
