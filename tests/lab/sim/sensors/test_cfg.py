"""Configs of sensors: built by their type, closed keys, importable without torch."""

import subprocess
import sys

import pytest

from embodichain.lab.sim.sensors import (
    ContactSensorCfg,
    ForceTorqueSensorCfg,
    FramePoseSensorCfg,
    HeightScanSensorCfg,
    ImuSensorCfg,
    JointsCfg,
    JointTorqueSensorCfg,
    LinksCfg,
    RaySensorCfg,
    SensorCfg,
)
from embodichain.utils.errors import ConfigError


@pytest.mark.parametrize(
    ("kind", "cls"),
    [
        ("contact", ContactSensorCfg),
        ("imu", ImuSensorCfg),
        ("force_torque", ForceTorqueSensorCfg),
        ("frame_pose", FramePoseSensorCfg),
        ("ray", RaySensorCfg),
        ("height_scan", HeightScanSensorCfg),
    ],
)
def test_the_type_chooses_the_class(kind, cls):
    cfg = SensorCfg.from_dict({"sensor_type": kind, "of": {"uid": "go", "link_names": [".*foot"]}})
    assert type(cfg) is cls
    assert cfg.of == LinksCfg(uid="go", link_names=[".*foot"])
    assert cfg.observe is False
    assert cls.from_dict(cfg.to_dict()).to_dict() == cfg.to_dict()


def test_a_sensor_of_joints_names_joints():
    given = {"sensor_type": "joint_torque", "of": {"uid": "go", "joint_names": "hip"}}
    cfg = SensorCfg.from_dict(given)
    assert isinstance(cfg, JointTorqueSensorCfg)
    assert cfg.of == JointsCfg(uid="go", joint_names="hip")


def test_entity_cfg_is_another_name_of_of():
    feet = LinksCfg(uid="go", link_names=[".*foot"])
    cfg = ContactSensorCfg(entity_cfg=feet)
    assert cfg == ContactSensorCfg(of=feet)
    assert cfg.entity_cfg is cfg.of
    assert cfg == SensorCfg.from_dict({"sensor_type": "contact", "entity_cfg": feet.to_dict()})
    assert "entity_cfg" not in cfg.to_dict()
    cfg.entity_cfg = LinksCfg(uid="ur10")
    assert cfg.of.uid == "ur10"
    assert cfg.replace(entity_cfg=feet).of == feet
    with pytest.raises(TypeError, match="entity_cfg means the same as of: leave one out"):
        ContactSensorCfg(of=feet, entity_cfg=feet)


def test_a_pattern_is_nested():
    given = {"sensor_type": "ray", "pattern": {"grid": {"size": [1, 2], "resolution": 0.5}}}
    cfg = SensorCfg.from_dict(given)
    assert isinstance(cfg, RaySensorCfg) and cfg.pattern.grid is not None
    assert list(cfg.pattern.grid.size) == [1.0, 2.0] and cfg.pattern.fan is None


@pytest.mark.parametrize(
    ("given", "path", "match"),
    [
        ({"sensor_type": "radar"}, "sensor_type", "one of: camera, Camera, stereo_camera"),
        ({"sensor_type": "im"}, "sensor_type", "Did you mean 'imu'"),
        ({}, "sensor_type", "unknown sensor_type ''"),
        ({"sensor_type": "imu", "agianst": {}}, "agianst", "unknown key"),
        ({"sensor_type": "contact", "of": {"uid": 3}}, "of.uid", "expected text"),
        (
            {"sensor_type": "contact", "of": {"uid": "go"}, "entity_cfg": {"uid": "go"}},
            "entity_cfg",
            "means the same as of: leave one out",
        ),
        ({"sensor_type": "ray", "pattern": {"gird": {}}}, "pattern.gird", "unknown key"),
        ({"sensor_type": "ray", "no_hit": "mx"}, "no_hit", "Did you mean 'max'"),
    ],
)
def test_a_wrong_config_is_refused_with_what_exists(given, path, match):
    with pytest.raises(ConfigError, match=match) as error:
        SensorCfg.from_dict(given)
    assert [p.path for p in error.value.problems] == [path]


@pytest.mark.unmeasured
def test_configs_need_neither_torch_nor_mujoco():
    code = (
        "import sys; from embodichain.lab.sim.sensors import ContactSensorCfg, ImuSensorCfg; "
        "print({'torch', 'mujoco'} & set(sys.modules))"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "set()"


@pytest.mark.unmeasured
def test_files_of_sensors_need_no_torch():
    code = (
        "import sys; from embodichain.lab.sim.sensors import SENSORS; "
        "print(len(SENSORS) > 8, {'torch'} & set(sys.modules))"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "True set()"
