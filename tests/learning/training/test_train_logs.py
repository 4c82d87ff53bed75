"""What stands in `progress.csv` and event files, by Isaac Lab's and mjlab's names."""

import csv

import pytest
from stable_baselines3.common.logger import Logger

from embodichain.config import resolve
from embodichain.learning.training.session import PARTS
from embodichain.learning.training.train import train
from embodichain.learning.training.train_logs import log_episode

pytestmark = pytest.mark.slow

CART_POLE = ("task=cart_pole", "num_envs=4", "sim.num_threads=1", "seed=1", "algo.n_epochs=1")
CURRICULUM = (
    "+task.curriculum.alive={func: modify_reward_weight, "
    "params: {term_name: alive, weight: 0.5, num_steps: 20}}"
)


def info(rewards, metrics, terminations, ended_by):
    names = ("reward_sums", "metrics", "terminations", "ended_by")
    return dict(zip(names, (rewards, metrics, terminations, ended_by), strict=True))


def test_means_over_the_episodes_that_ended():
    logger = Logger(None, [])
    far, low = {"far": True, "low": False}, {"far": True, "low": True}
    log_episode(logger, info({"near": 1.0}, {"success": True}, far, "fail"))
    log_episode(logger, info({"near": 2.0}, {"success": False}, low, "fail"))
    log_episode(logger, info({"near": 6.0}, {"success": False}, low, "diverged"))
    log_episode(
        logger, info({"near": 3.0}, {"success": True}, dict.fromkeys(far, False), "time_out")
    )
    assert dict(logger.name_to_value) == {
        "Episode_Reward/near": 3.0,
        "Episode_Metrics/success": 0.5,
        "Episode_Termination/fail": 0.5,
        "Episode_Termination/time_out": 0.25,
        "Episode_Termination/success": 0.0,
        "Episode_Termination/diverged": 0.25,
        "Episode_Termination/far": 0.5,  # what it says of an episode that diverged does not count
        "Episode_Termination/low": 0.25,
    }


def test_a_training_logs_terms_curricula_and_time(tmp_path):
    own = ("algo.n_steps=64", "algo.batch_size=64", "total_timesteps=512", CURRICULUM)
    summary = train(resolve([*CART_POLE, *own], "train"), tmp_path)
    with (tmp_path / "progress.csv").open() as stream:
        first, last = csv.DictReader(stream)
    assert float(first["Episode_Termination/fail"]) > 0
    terms = [float(first[f"Episode_Termination/{name}"]) for name in ("fallen", "off_track")]
    assert max(terms) > 0 and sum(terms) >= float(first["Episode_Termination/fail"])
    assert 0 <= float(first["Episode_Metrics/success"]) <= 1
    assert float(last["Curriculum/alive"]) == 0.5
    assert float(last["Episode_Reward/alive"]) > 0
    shares = [float(last[f"time/{part}_fraction"]) for part in PARTS]
    assert sum(shares) == pytest.approx(1, abs=1e-3) and min(shares) > 0
    assert list(summary.time_fractions) == list(PARTS)
    assert sum(summary.time_fractions.values()) == pytest.approx(1, abs=1e-3)
