"""What a URDF says and MuJoCo does not read is refused or told, by file, line and name."""

import math

import pytest

from embodichain.lab.sim.cfg import AttachedFileCfg, JointDrivePropertiesCfg, RobotCfg
from embodichain.lab.sim.compiler.robot.articulation import parse_articulation
from embodichain.lab.sim.compiler.robot.parsed_articulation import ParsedArticulation
from embodichain.lab.sim.configs.urdf_cfg import URDFCfg
from embodichain.utils.errors import ConfigError
from tests.lab.sim.compiler.helpers import INERTIAL, UR10, write

ARM = f"""<robot name="arm">
  <link name="base"/>
  <link name="link">{INERTIAL}</link>
  <joint name="elbow" type="{{kind}}">
    <parent link="base"/><child link="link"/><axis xyz="0 0 1"/>
    {{limit}}
  </joint>
</robot>"""
LIMIT = '<limit lower="-1" upper="1" effort="5" velocity="2"/>'


def parse(tmp_path, limit: str = LIMIT, kind: str = "revolute", **values) -> ParsedArticulation:
    """A robot of one joint, whose `<limit>` is on line 6."""
    text = ARM.format(kind=kind, limit=limit)
    return parse_articulation("r", RobotCfg(fpath=write(tmp_path / "a.urdf", text), **values))


def drives(**values) -> JointDrivePropertiesCfg:
    return JointDrivePropertiesCfg(**values)


# ----------------------------------------------------------------------------------------- limits


def test_an_effort_of_zero_is_told_where_the_files_limits_are_taken(tmp_path):
    limit = LIMIT.replace('effort="5"', 'effort="0"')
    (note,) = parse(tmp_path, limit, drive_pros=drives(max_effort="file")).notes
    assert f"'elbow' ({tmp_path / 'a.urdf'}:6)" in note
    assert "no limit" in note and "drive_pros.max_effort: {elbow: N}" in note
    assert not parse(tmp_path, limit).notes  # the file's limits are not taken
    assert not parse(tmp_path, limit, drive_pros=drives(max_effort={"elbow": 3})).notes
    attach = {"wrist": AttachedFileCfg(fpath=str(tmp_path / "a.urdf"), to="ee_link")}
    cfg = RobotCfg(fpath=UR10, attach=attach, drive_pros=drives(max_effort="file"))
    assert any("'wrist/elbow'" in note for note in parse_articulation("r", cfg).notes)


def test_a_velocity_of_zero_is_told_where_the_files_limits_are_taken(tmp_path):
    limit = LIMIT.replace('velocity="2"', 'velocity="0.0"')
    parsed = parse(tmp_path, limit, drive_pros=drives(max_velocity="file"))
    (note,) = parsed.notes
    assert f"'elbow' ({tmp_path / 'a.urdf'}:6)" in note
    assert "no limit" in note and "drive_pros.max_velocity: {elbow: SPEED}" in note
    assert parsed.qvel_limits.tolist() == [math.inf]
    assert parsed.max_velocity.tolist() == [1e10]
    assert not parse(tmp_path, limit).notes  # the file's limits are not taken
    limited = parse(tmp_path, limit, drive_pros=drives(max_velocity=1.5))
    assert limited.max_velocity.tolist() == [1.5]
    parts = URDFCfg().set_urdf(str(tmp_path / "a.urdf"))
    cfg = RobotCfg(urdf_cfg=parts, drive_pros=drives(max_velocity="file"))
    assert any('velocity="0"' in note for note in parse_articulation("r", cfg).notes)


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
@pytest.mark.parametrize(
    ("limit", "words"),
    [
        ('<limit lower="0.5" upper="0.5" effort="1" velocity="1"/>', "(line 6: 0.5)"),
        ('<limit effort="1" velocity="1"/>', "(line 6: 0)"),  # both are 0 by default
        ('<limit lower="1" upper="-1" effort="1" velocity="1"/>', "(line 6: 1, -1)"),
        ("", "(line 4)"),
    ],
)
def test_limits_that_are_none_are_told(tmp_path, kind, limit, words):
    parsed = parse(tmp_path, limit, kind)
    (note,) = parsed.notes
    assert f"'elbow' {words}" in note and "without limits" in note
    assert parsed.qpos_limits.tolist() == [[float("-inf"), float("inf")]]


def test_a_continuous_joint_needs_no_limit(tmp_path):
    assert not parse(tmp_path, "", "continuous").notes
    assert not parse(tmp_path, '<limit lower="0" upper="0" effort="5"/>', "continuous").notes


@pytest.mark.parametrize(
    ("key", "value"), [("velocity", "fast"), ("effort", "-1"), ("upper", "nan")]
)
def test_a_limit_that_is_no_number_is_refused(tmp_path, key, value):
    limit = LIMIT.replace(f'{key}="', f'{key}="{value}" was="')
    with pytest.raises(ConfigError, match=f"a.urdf:6: joint 'elbow': {key} must"):
        parse(tmp_path, limit)


# ----------------------------------------------------------------------------------- joints, xacro


def test_a_floating_joint_at_the_root_is_left_to_fix_base(tmp_path):
    text = ARM.format(kind="floating", limit="").replace('"base"', '"world"')
    cfg = RobotCfg(fpath=write(tmp_path / "a.urdf", text))
    (note,) = parse_articulation("r", cfg).notes
    assert "'elbow' of 'link'" in note and "fix_base: false" in note
    cfg.fix_base = False
    assert not parse_articulation("r", cfg).notes


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("", "", "remove this joint and link 'base', and set fix_base: false"),
        ('<link name="base"/>', f'<link name="base">{INERTIAL}</link>', "give it another type"),
    ],
)
def test_a_floating_joint_below_a_root_says_what_to_write(tmp_path, old, new, words):
    text = ARM.format(kind="floating", limit="").replace(old, new)
    with pytest.raises(ConfigError) as raised:
        parse_articulation("r", RobotCfg(fpath=write(tmp_path / "a.urdf", text)))
    assert f"{tmp_path / 'a.urdf'}:4: joint 'elbow' is floating" in str(raised.value)
    assert words in str(raised.value)


def test_a_planar_joint_is_told_as_the_three_that_it_becomes(tmp_path):
    parsed = parse(tmp_path, "", "planar")
    assert parsed.joint_names == ("elbow_TX", "elbow_TY", "elbow_RZ")
    assert len(parsed.notes) == 1 and all(name in parsed.notes[0] for name in parsed.joint_names)
    with pytest.raises(ConfigError, match="cannot float; fix_base: true"):
        parse(tmp_path, "", "planar", fix_base=False)  # its root has no mass


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('upper="1"', 'upper="${pi / 2}"'),
        ('axis xyz="0 0 1"', 'axis xyz="$(optenv ARM_AXIS 0 0 1)"'),
        ('name="elbow"', 'name="$(arg prefix)elbow"'),
        ("<axis", "<xacro:axis"),
        ("<axis ", '<axis xacro:if="1" '),
    ],
)
def test_what_xacro_should_have_replaced_is_refused(tmp_path, old, new):
    text = ARM.format(kind="revolute", limit=LIMIT).replace(old, new)
    text = text.replace("<robot", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"')
    with pytest.raises(ConfigError) as raised:
        parse_articulation("r", RobotCfg(fpath=write(tmp_path / "a.urdf", text)))
    line = next(i for i, row in enumerate(text.splitlines(), 1) if new in row)
    assert str(raised.value).startswith(f"r.fpath: {tmp_path / 'a.urdf'}:{line}: ")
    assert "`xacro a.urdf > robot.urdf`" in str(raised.value)


def test_what_mujoco_does_not_read_may_keep_its_arguments(tmp_path):
    plugin = '<gazebo><plugin filename="$(find pkg)/lib.so"/></gazebo></robot>'
    text = ARM.format(kind="revolute", limit=LIMIT).replace("</robot>", plugin)
    assert not parse_articulation("r", RobotCfg(fpath=write(tmp_path / "a.urdf", text))).notes


def test_a_free_joint_of_an_mjcf_that_fix_base_leaves_out_is_told(tmp_path):
    text = """<mujoco><worldbody><body name="trunk"><freejoint name="float"/><geom size=".1"/>
      <body><joint name="hip"/><geom size=".1" pos=".2 0 0"/></body></body></worldbody>
      <actuator><motor joint="hip"/></actuator></mujoco>"""
    cfg = RobotCfg(fpath=write(tmp_path / "m.xml", text))
    (note,) = parse_articulation("r", cfg).notes
    assert "'float' of 'trunk' left out" in note and "fix_base: false lets it float" in note
    cfg.fix_base = False
    assert not parse_articulation("r", cfg).notes
