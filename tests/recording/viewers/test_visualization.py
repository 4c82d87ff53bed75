"""EmbodiChain's configuration of its page in the browser serves our page."""

import argparse
import socket
import urllib.request

import pytest

from embodichain.lab.gym.envs import BaseEnv, EnvCfg
from embodichain.lab.gym.utils.gym_utils import add_env_launcher_args_to_parser
from embodichain.lab.sim import SimulationManagerCfg
from embodichain.lab.sim.cfg import RigidObjectCfg

from embodichain.recording.viewers.visualization import (  # isort: skip
    ViserServerCfg,
    VisualizationCfg,
    add_viser_args_to_parser,
    visualization_cfg_from_args,
)


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def _env(visualization: VisualizationCfg | None) -> BaseEnv:
    sim_cfg = SimulationManagerCfg(headless=True, visualization=visualization)
    return BaseEnv(EnvCfg(num_envs=2, sim_cfg=sim_cfg, objects={"cube": RigidObjectCfg()}))


def test_viser_is_the_page_of_the_web_viewer(
    caplog: pytest.LogCaptureFixture, capsys: pytest.CaptureFixture[str]
) -> None:
    port = _free_port()
    cfg = VisualizationCfg(backend="viser", viser_server=ViserServerCfg(port=port))
    env = _env(cfg)
    assert f"viewer: http://127.0.0.1:{port}" in caplog.text
    assert "token" not in caplog.text  # a log may be read by others
    url = capsys.readouterr().err.partition("viewer: ")[2].split()[0]
    with urllib.request.urlopen(url, timeout=20) as page:
        assert b"html" in page.read(2000).lower()
    env.close()
    with pytest.raises(OSError):
        urllib.request.urlopen(f"http://127.0.0.1:{port}", timeout=5)


@pytest.mark.parametrize("cfg", [None, VisualizationCfg()])
def test_nothing_is_served_unless_it_is_asked_for(cfg: VisualizationCfg | None) -> None:
    env = _env(cfg)
    assert list(env.observers) == []
    env.close()


def test_flags_of_the_launcher() -> None:
    parser = argparse.ArgumentParser()
    add_env_launcher_args_to_parser(parser)
    assert visualization_cfg_from_args(parser.parse_args([])) == VisualizationCfg()
    add_viser_args_to_parser(parser)
    flags = "--viser --viser-host 0.0.0.0 --viser-port 8090 --viser-env-ids 3 1"
    assert visualization_cfg_from_args(parser.parse_args(flags.split())) == VisualizationCfg(
        backend="viser",
        env_ids=[3, 1],
        allow_commands=True,
        viser_server=ViserServerCfg(host="0.0.0.0", port=8090),
    )
    everything = parser.parse_args(["--viser-env-ids", "all"])
    assert visualization_cfg_from_args(everything).env_ids is None


def test_an_unknown_backend_is_an_error() -> None:
    with pytest.raises(ValueError, match="unknown backend 'rerun'; one of: none, viser"):
        _env(VisualizationCfg(backend="rerun"))  # type: ignore[arg-type]
