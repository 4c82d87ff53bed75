"""Trainings side by side: what is one group, what its intervals are, and the picture."""

import json
import sys

import numpy as np
import pytest
from PIL import Image
from stable_baselines3.common.logger import CSVOutputFormat

from embodichain.cli import main
from embodichain.learning.evaluation.comparison import (
    RETURN,
    SUCCESS,
    Curve,
    band,
    group_runs,
    read_run,
)
from embodichain.learning.evaluation.plots import plot_curves, set_axes
from embodichain.utils.errors import ConfigError


@pytest.fixture
def make_run(tmp_path):
    """Writes what a training leaves in its folder, with a curve from 0 to `success`."""

    def make(name, seed=0, success=1.0, overrides=(), curve=True, **more):
        folder = tmp_path / "outputs/2026-01-01" / name
        folder.mkdir(parents=True)
        summary = {"task": "reach", "algo": "ppo", "seed": seed, "success_rate": success}
        summary |= {"mean_return": -10.0 + seed, "env_steps": 300, "train_seconds": 2.0}
        summary |= {"env_steps_per_second": 150.0, **more}
        (folder / "summary.json").write_text(json.dumps(summary))
        lines = ["task=reach", f"seed={seed}", *overrides]
        (folder / "overrides.yaml").write_text("".join(f"- {line}\n" for line in lines))
        if curve:
            output = CSVOutputFormat(str(folder / "progress.csv"))
            for i in range(4):
                row = {"time/total_timesteps": 100 * i, "rollout/ep_rew_mean": -20.0 + i + seed}
                row |= {"rollout/success_rate": success * i / 3} if i else {}
                output.write(row, {key: () for key in row}, step=i)
            output.close()
        return folder

    return make


def test_runs_that_differ_by_their_seed_are_one_group(make_run):
    faster = ["algo.learning_rate=1e-3"]
    folders = [
        make_run("a", seed=0, success=0.9),
        make_run("b", seed=0, overrides=faster),
        make_run("c", seed=1, success=0.5, overrides=["quiet=true", "output_dir=x"]),
        make_run("d", seed=2, success=0.7),
    ]
    groups = group_runs(map(read_run, folders))
    assert [g.label for g in groups] == ["reach ppo", "reach ppo algo.learning_rate=1e-3"]
    assert [r.seed for r in groups[0].runs] == [0, 1, 2]
    success = groups[0].number("success_rate")
    assert success.mean == pytest.approx(0.7)
    assert success.values == (0.9, 0.5, 0.7)
    assert success.mean_interval is None and "3 seeds" in success.note
    assert groups[1].number("success_rate").mean_interval is None
    assert groups[1].number("eval_return") is None


def test_the_same_training_twice_is_refused(make_run):
    runs = [read_run(make_run(name)) for name in ("a", "b")]
    with pytest.raises(ConfigError, match="the same training with the same seed 0"):
        group_runs(runs)


def test_curves_are_read_where_they_have_values(make_run):
    curves = read_run(make_run("a", success=0.6)).curves
    assert curves[RETURN].steps.tolist() == [0, 100, 200, 300]
    assert curves[RETURN].values.tolist() == [-20, -19, -18, -17]
    assert curves[SUCCESS].steps.tolist() == [100, 200, 300]
    np.testing.assert_allclose(curves[SUCCESS].values, [0.2, 0.4, 0.6])


def test_newest_evaluation_of_the_training_counts(make_run):
    folder = make_run("a")
    for number, (policy, rate) in enumerate(
        [(folder / "checkpoints/final.zip", 0.25), (folder.parent / "other/x.zip", 0.75)]
    ):
        beside = folder.parent / f"eval_{number}"
        beside.mkdir()
        data = {"policy": str(policy), "success": {"rate": rate}, "returns": {"mean": -3.0}}
        (beside / "eval.json").write_text(json.dumps(data))
    numbers = read_run(folder).numbers
    assert (numbers["eval_success"], numbers["eval_return"]) == (0.25, -3.0)
    own = make_run("b", eval={"success": {"rate": 1.0}, "returns": None})
    assert read_run(own).numbers["eval_success"] == 1.0


def test_band_by_hand():
    steps = np.array([0.0, 10.0, 20.0])
    curves = [Curve(steps, np.array([0.0, 1.0, 2.0])), Curve(steps[:2], np.array([2.0, 3.0]))]
    at, mean, low, high = band(curves, points=3)
    assert at.tolist() == [0, 5, 10]  # as far as the shorter one goes
    np.testing.assert_allclose(mean, [1.0, 1.5, 2.0])
    assert low is None and high is None  # of two seeds
    five = [Curve(steps, np.array([value, 0.0, 1.0])) for value in (1.0, 2.0, 3.0, 4.0, 5.0)]
    _, mean, low, high = band(five, points=3)
    half = 2.776445 * np.sqrt(2.5 / 5)  # Student's t of 4 degrees of freedom
    np.testing.assert_allclose([low[0], high[0]], [3 - half, 3 + half], rtol=1e-6)
    assert low[1] == high[1] == 0.0
    shares = [Curve(steps, np.zeros(3)) for _ in range(5)]
    _, _, low, high = band(shares, points=2, share=True)
    np.testing.assert_allclose(high, 3.841459 / (500 + 3.841459), rtol=1e-6)  # 0 of 500 episodes
    assert (low == 0.0).all()
    with pytest.raises(ValueError, match="no steps in common"):
        band([curves[0], Curve(np.array([30.0]), np.array([1.0]))])


def test_picture_and_table(make_run, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "140")  # no cell is folded
    folders = [str(make_run(f"s{i}", seed=i, success=0.5 + 0.1 * i)) for i in range(3)]
    out = tmp_path / "curves.png"
    assert main(["compare", *folders, "-o", str(out)]) == 0
    text = capsys.readouterr().out
    assert "reach ppo" in text
    assert "60.0% (seeds 50.0, 60.0, 70.0)" in text
    assert "no interval from 3 seeds, it needs at least 5" in text
    picture = np.asarray(Image.open(out).convert("RGB"))
    assert picture.std() > 5  # something is drawn
    before = out.read_bytes()
    assert main(["compare", *folders, "-o", str(out)]) == 2
    assert "exists; it is never replaced" in capsys.readouterr().err
    assert out.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir() if p.is_file()] == ["curves.png"]


def test_json_holds_seeds_and_intervals(make_run, capsys):
    folders = [str(make_run(f"s{i}", seed=i)) for i in range(2)]
    assert main(["compare", *folders, folders[0], "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["groups"][0]["seeds"] == [0, 1]
    assert data["groups"][0]["numbers"]["mean_return"]["mean"] == -9.5
    assert data["groups"][0]["numbers"]["mean_return"]["values"] == [-10.0, -9.0]
    assert data["groups"][0]["numbers"]["mean_return"]["mean_interval"] is None


def test_seeds_that_agree_have_the_interval_of_their_episodes(make_run, capsys):
    for i in range(5):
        found = {"success": {"rate": 0.0, "count": 0, "trials": 16}, "returns": {"mean": 1.0 * i}}
        make_run(f"s{i}", seed=i, success=0.0, episodes=40, eval=found, objective=0.0)
    folders = sorted((make_run("other", seed=9).parent).glob("s*"))
    assert main(["compare", *map(str, folders), "--json"]) == 0
    numbers = json.loads(capsys.readouterr().out)["groups"][0]["numbers"]
    high = 3.841459 / (80 + 3.841459)  # Wilson, 0 of 5 x 16: z^2 / (n + z^2)
    assert numbers["eval_success"]["mean_interval"] == pytest.approx([0.0, high], rel=1e-6)
    high = 3.841459 / (200 + 3.841459)  # 40 episodes of each training
    assert numbers["success_rate"]["mean_interval"] == pytest.approx([0.0, high], rel=1e-6)
    half = 2.7764451 * np.sqrt(2.5 / 5)  # a return has no range and no Wilson's interval
    assert numbers["eval_return"]["mean_interval"] == pytest.approx([2 - half, 2 + half], rel=1e-6)
    assert main(["compare", *map(str, folders)]) == 0
    text = capsys.readouterr().out
    assert "0.0% [0.0%, 4.6%]" in text and "no interval" not in text


def test_mistakes(make_run, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    plain = make_run("plain", curve=False)
    for arguments, message in (
        (["nowhere"], "there is no run 'nowhere'"),
        (["last"], "no training in outputs yet"),
        ([str(tmp_path)], "has no finished training"),
        ([str(plain), "-o", "x.png"], f"no curves in progress.csv of: {plain}"),
    ):
        assert main(["compare", *arguments]) == 2
        err = capsys.readouterr().err
        assert err.startswith("error: ") and message in err
    (plain / "summary.json").write_text('{"train_seconds": 1')
    assert main(["compare", str(plain)]) == 2
    assert "cannot read" in capsys.readouterr().err


def test_what_a_pattern_finds_besides_is_left_out(make_run, tmp_path, capsys):
    training = make_run("a")
    (tmp_path / "eval").mkdir()
    assert main(["compare", str(training), str(tmp_path / "eval"), "--json"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["groups"][0]["folders"] == [str(training)]
    assert err == f"left out: {tmp_path / 'eval'} is not a training\n"


def test_the_folder_of_a_sweep_is_its_trainings(make_run, tmp_path, capsys):
    how = ["hydra/launcher=joblib", "hydra.launcher.n_jobs=2", "sim.num_threads=1"]
    for job in range(12):
        overrides = [f"++{line}" for line in ("algo.n_steps=8", *how)]
        make_run(str(job), seed=job, overrides=overrides)
    sweep = tmp_path / "outputs/2026-01-01"
    (sweep / "optimization_results.yaml").write_text("best_value: 1\n")
    (sweep / "12").mkdir()  # a job that failed
    alone = make_run("../alone", seed=20, overrides=["algo.n_steps=8"])
    assert main(["compare", str(sweep), str(alone), "--json"]) == 0
    out, err = capsys.readouterr()
    (group,) = json.loads(out)["groups"]
    assert group["label"] == "reach ppo algo.n_steps=8"
    assert group["seeds"] == [*range(12), 20]
    assert err == ""
    files = sorted(map(str, sweep.iterdir()))  # as a shell's pattern gives them
    assert main(["compare", *files, "--json"]) == 0
    out, err = capsys.readouterr()
    assert len(json.loads(out)["groups"][0]["seeds"]) == 12
    assert err.count("left out: ") == 2 and "optimization_results.yaml is not a training" in err


@pytest.mark.parametrize(
    ("values", "share", "limits"),
    [
        ([0.0, 0.0], True, (-0.05, 1.05)),
        ([0.2, 0.9], True, (-0.05, 1.05)),
        ([300.0, 306.0], False, (294.75, 311.25)),  # at least 5 % high, and a margin
        ([300.0, 300.0001], False, (-15.0, 315.0)),  # a constant, from 0
        ([0.0], False, (-0.55, 0.55)),
        ([-10.0, 10.0], False, (-11.0, 11.0)),
    ],
)
def test_flat_curves_look_flat(values, share, limits):
    from matplotlib.figure import Figure

    axes = Figure().subplots()
    axes.plot([100.0] * len(values), values)
    set_axes(axes, 100.0, values, share=share)
    assert axes.get_ylim() == pytest.approx(limits, rel=1e-3)
    assert axes.get_xlim() == pytest.approx((0.0, 105.0))
    axes.figure.canvas.draw()
    assert axes.yaxis.get_offset_text().get_text() == ""


def test_odd_pictures(make_run, tmp_path, monkeypatch):
    groups = group_runs([read_run(make_run("a"))])
    with pytest.raises(ConfigError, match=r"cannot write .*curves\.what"):
        plot_curves(groups, tmp_path / "curves.what")
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(ConfigError, match=r"pip install 'embodichain\[plot\]'"):
        plot_curves(groups, tmp_path / "curves.png")
