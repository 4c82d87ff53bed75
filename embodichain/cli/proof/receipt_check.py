"""Checks a receipt: its files, its numbers, the physics of its logs, the actions of its policy."""

from __future__ import annotations

import json
import math
import secrets
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from embodichain.cli.jobs.code_digest import code_digest, file_digest
from embodichain.cli.jobs.job import policy_of
from embodichain.cli.jobs.receipt import RECEIPT, Receipt, read_receipt
from embodichain.cli.pages.run_record import named_damage
from embodichain.cli.studies.episode_table import wrong_tables
from embodichain.cli.studies.results import fits_models, read_results
from embodichain.cli.studies.study_job import StudyFolder
from embodichain.config.run_folder import versions
from embodichain.lab.gym.envs.observers import ObservedEnv, StepObserver, StepRecord
from embodichain.utils.errors import ConfigError, EmbodichainError

if TYPE_CHECKING:
    from embodichain.learning.evaluation.statistics import Estimate, Rate
    from embodichain.recording.read.api import Log
    from embodichain.recording.read.episodes import LogEpisode

__all__ = ["Finding", "ReceiptReport", "check_receipt"]

SAMPLED = 3
"""Evaluations of a study that are simulated and played again unless all are."""
_SAME_NUMBER = 1e-9
"""Relative difference of numbers that are the same: sums may be rounded in another order."""
_SAME_SUM = 1e-6
"""That of returns: a log has each episode's sum in another precision."""


@dataclass(frozen=True)
class Finding:
    """One thing that was checked.

    Attributes:
        what: What was checked.
        ok: Whether it is as the receipt says; None where it was not checked.
        text: What was found.
    """

    what: str
    ok: bool | None
    text: str


@dataclass
class ReceiptReport:
    """The result of checking a receipt.

    Attributes:
        path: The receipt.
        findings: What was checked.
        notes: How this machine differs from the one that made the receipt.
    """

    path: Path
    findings: list[Finding] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    @property
    def ok(self) -> bool:
        """Whether nothing differs from what the receipt says."""
        return all(finding.ok is not False for finding in self.findings)

    def add(self, what: str, ok: bool | None, text: str) -> None:
        """Add a finding."""
        self.findings.append(Finding(what, ok, text))


def check_receipt(
    path: Path,
    *,
    policy: Path | None = None,
    every: bool = False,
    trust: bool = False,
    sample_seed: int | None = None,
) -> ReceiptReport:
    """Check a receipt.

    A file that is not what the receipt says ends the check: nothing is simulated from it.

    Args:
        path: The receipt, or its folder.
        policy: The policy's file, where it is not where the receipt says.
        every: Whether all evaluations of a study are simulated, and not a sample.
        trust: Whether code of the policy's file may run, if it cannot be read without.
        sample_seed: Chooses the sample; None draws a seed, which the report says.

    Raises:
        ConfigError: There is no receipt, or it is damaged or of another version.
    """
    receipt = read_receipt(path)
    report = ReceiptReport(receipt.path)
    report.notes += _differences_of_machines(receipt)
    if receipt.is_sealed:
        report.add("receipt", ok=True, text="its seal fits its content")
    else:
        report.add("receipt", ok=False, text="it was changed after it was made")
    if not _check_files(receipt, report):
        return report
    if receipt.kind == "study":
        _check_study(receipt, report, every=every, trust=trust, sample_seed=sample_seed)
        return report
    with named_damage(receipt.path.parent):
        _check_numbers(receipt, report)
    for log in receipt.logs:
        _simulate(log, report)
    if not receipt.logs:
        report.add("physics", ok=None, text="no log was recorded")
    elif receipt.kind == "eval":
        _play(receipt, report, policy, trust=trust)
    else:
        report.add("actions", ok=None, text="a collection's policy is not played again")
    return report


def _differences_of_machines(receipt: Receipt) -> Iterator[str]:
    """Yield how this machine differs; floating point may then differ in the last bits."""
    from embodichain.recording.format.attachments import cpu_name

    here = versions()
    for name, version in receipt.content["versions"].items():
        if here.get(name) != version:
            yield f"{name} {version} made it, here is {here.get(name)}"
    if receipt.content.get("cpu") != cpu_name():
        yield f"{receipt.content.get('cpu')} made it, here is {cpu_name()}"
    if receipt.content.get("code") != code_digest():
        yield "other code of embodichain made it"


def _check_files(receipt: Receipt, report: ReceiptReport) -> bool:
    """Compare the digest of each file; return whether all are as the receipt says."""
    changed: list[str] = []
    for name, digest in receipt.files.items():
        path = receipt.file(name)
        if not path.is_file():
            changed.append(f"{name} is missing")
        elif file_digest(path) != digest:
            changed.append(f"{name} was changed")
    if changed:
        report.add("files", ok=False, text="; ".join(changed))
        return False
    report.add("files", ok=True, text=f"{len(receipt.files)} files are those of the receipt")
    return True


def _check_numbers(receipt: Receipt, report: ReceiptReport) -> None:
    """Compare the results in the receipt with those that follow from its files."""
    from embodichain.recording.shards import joining

    episodes: list[LogEpisode] = []
    for path in receipt.logs:
        with joining.open(path) as log:
            episodes += [episode for episode in log.episodes if episode.counted]
    if receipt.kind == "collect":
        problems = list(_wrong_counts(receipt, episodes))
    else:
        problems = list(_wrong_results(receipt, episodes))
    successes = sum(episode.success is True for episode in episodes)
    if problems:
        report.add("results", ok=False, text="; ".join(problems))
    elif receipt.logs:
        text = f"{successes} successes of {len(episodes)} episodes, counted in the log"
        report.add("results", ok=True, text=text)
    else:
        report.add("results", ok=True, text="those of eval.json; there is no log to count in")


def _wrong_counts(receipt: Receipt, episodes: Sequence[LogEpisode]) -> Iterator[str]:
    """Yield how the number of a collection's successes is not that of its logs."""
    successes = sum(episode.success is True for episode in episodes)
    stated = receipt.content["results"]["successes"]
    if receipt.logs and successes != stated:
        yield f"{successes} successes in the logs, {stated} stated"


def _wrong_results(receipt: Receipt, episodes: Sequence[LogEpisode]) -> Iterator[str]:
    """Yield what of an evaluation's results does not follow from its episodes, or from its log."""
    from embodichain.learning.evaluation.statistics import estimate, rate

    stated: Mapping[str, Any] = receipt.content["results"]
    content = json.loads(receipt.file("eval.json").read_text(encoding="utf-8"))
    played = content["per_episode"]
    for name, value in stated.items():
        if content.get(name) != value:
            yield f"{name} differ from those in eval.json"
    computed: dict[str, Estimate | Rate | None] = {
        "returns": estimate(np.array(played["return"], np.float64)),
        "length": estimate(np.array(played["length"], np.float64)),
    }
    if "success" in played:
        computed["success"] = rate(np.array(played["success"], np.bool_))
    for name, value in computed.items():
        if not is_same(stated.get(name), None if value is None else asdict(value)):
            yield f"{name} do not follow from the {len(played['env'])} episodes in eval.json"
    if receipt.content["episodes"] != len(played["env"]):
        yield f"{len(played['env'])} episodes in eval.json, {receipt.content['episodes']} stated"
    if not receipt.logs:
        return
    logged = sorted(episodes, key=lambda episode: (episode.env, episode.episode))
    columns = {
        "env": [episode.env for episode in logged],
        "length": [episode.steps for episode in logged],
        "return": [episode.total_reward for episode in logged],
    }
    if "success" in played:
        columns["success"] = [episode.success is True for episode in logged]
    for name, values in columns.items():
        if not is_same(played[name], values, _SAME_SUM):
            yield f"{name} of the episodes in eval.json differs from that in the log"


def _simulate(path: Path, report: ReceiptReport) -> None:
    """Simulate a log again, and compare every state."""
    from embodichain.recording.shards import joining

    verified = joining.verify(path)
    report.add("physics", ok=verified.ok, text=str(verified).splitlines()[0])
    if not verified.ok:
        report.notes += str(verified).splitlines()[1:]


class _ComparedActions(StepObserver):
    """Compares the actions of an environment with recorded ones.

    Args:
        log: The log.

    Attributes:
        first_difference: The first control step with another action, from 0; None if there is none.
        largest: The largest difference in that step.
        steps: Number of steps compared.
    """

    def __init__(self, log: Log) -> None:
        self._actions = log.read("actions")["actions"]
        self.first_difference: int | None = None
        self.largest = 0.0
        self.steps = 0

    def on_step(self, env: ObservedEnv, step: StepRecord) -> None:
        """Compare until actions differ: from there on the states do, too."""
        if self.first_difference is not None or self.steps >= len(self._actions):
            return
        recorded = self._actions[self.steps]
        played = np.asarray(step.action)
        if not np.array_equal(played, recorded):
            self.first_difference = self.steps
            self.largest = float(np.abs(played - recorded).max())
        self.steps += 1


def _play(receipt: Receipt, report: ReceiptReport, policy: Path | None, *, trust: bool) -> None:
    """Play the policy again on the same starts, and compare actions and successes."""
    from embodichain.config.environments.factory import make_env
    from embodichain.learning.checkpoints.task_digest import without_warnings_of_changes
    from embodichain.learning.evaluation.evaluation import evaluate
    from embodichain.recording.demos.reenactment import config_of
    from embodichain.recording.shards import joining

    try:
        name = _policy_of_receipt(receipt, policy, trust=trust)
    except ConfigError as error:
        report.add("actions", ok=False, text=str(error))
        return
    content = receipt.content
    with joining.open(receipt.logs[0]) as log:
        resolved = config_of(log).changed(allow_changed=True, trust=trust)
        compared = _ComparedActions(log)
    try:
        env = make_env(resolved)
        try:
            # What differs from the task in training was said, and written, by the evaluation.
            with without_warnings_of_changes():
                played_policy = policy_of(
                    resolved.root, env, name, deterministic=bool(content["deterministic"])
                )
            env.add_observer(compared)
            result = evaluate(
                env, played_policy, int(content["episodes"]), seed=int(content["seed"])
            )
        finally:
            env.close()
    except EmbodichainError as error:
        report.add("actions", ok=False, text=f"the policy cannot be played: {error}")
        return
    if compared.first_difference is None:
        text = f"equal to the bit in {compared.steps} steps of {content['num_envs']} environments"
        report.add("actions", ok=True, text=text)
    else:
        report.add(
            "actions",
            ok=False,
            text=f"differ from control step {compared.first_difference} on, there by "
            f"{compared.largest:.3g}; another processor may do that",
        )
    success = content["results"].get("success")
    if success is not None and result.success is not None:
        text = f"{result.success.count} of {result.success.trials} played again, "
        text += f"{success['count']} of {success['trials']} stated"
        report.add("successes", ok=result.success.count == success["count"], text=text)


def _policy_of_receipt(receipt: Receipt, policy: Path | None, *, trust: bool) -> str:
    """Return the name or the file of the policy.

    Raises:
        ConfigError: The file is missing, or another one; or the policy is code and not trusted.
    """
    stated = receipt.content.get("policy_file")
    if stated is None:
        name = str(receipt.content["policy"])
        if ":" in name and not trust:
            raise ConfigError(f"the policy is code, {name}: --trust runs it")
        return name
    path = policy if policy is not None else receipt.path.parent / stated["path"]
    if not path.is_file():
        raise ConfigError(f"there is no policy {path}: name it with --policy")
    if file_digest(path) != stated["sha256"]:
        raise ConfigError(f"{path} is not the policy of the receipt: it was changed")
    return str(path)


def _check_study(
    receipt: Receipt,
    report: ReceiptReport,
    *,
    every: bool,
    trust: bool,
    sample_seed: int | None,
) -> None:
    """Check the evaluations of a study, all or a sample of them."""
    names = [name for name in receipt.files if Path(name).name == RECEIPT]
    chosen = names
    if not every and len(names) > SAMPLED:
        if sample_seed is None:  # drawn anew: the sample cannot be known beforehand
            sample_seed = secrets.randbelow(2**31)
        rng = np.random.default_rng(sample_seed)
        drawn = rng.choice(len(names), size=SAMPLED, replace=False)
        chosen = [names[i] for i in sorted(drawn.tolist())]
        text = (
            f"{len(chosen)} of {len(names)}, drawn with --sample-seed {sample_seed}; --all for all"
        )
        report.add("evaluations", ok=None, text=text)
    for name in names:
        evaluation = read_receipt(receipt.file(name))
        if name not in chosen:
            unsimulated = ReceiptReport(evaluation.path)
            if _check_files(evaluation, unsimulated):
                with named_damage(evaluation.path.parent):
                    _check_numbers(evaluation, unsimulated)
            found = [finding for finding in unsimulated.findings if finding.ok is False]
        else:
            of_evaluation = check_receipt(evaluation.path, trust=trust)
            found = of_evaluation.findings
            report.notes += [n for n in of_evaluation.notes if n not in report.notes]
        label = str(Path(name).parent)
        for finding in found:
            report.add(f"{label}: {finding.what}", finding.ok, finding.text)
    with named_damage(receipt.path.parent):
        _check_results(receipt, report)


def _check_results(receipt: Receipt, report: ReceiptReport) -> None:
    """Compare the tables of a study, and its results, with those of its evaluations."""
    place = StudyFolder(receipt.path.parent.resolve())
    try:
        study = place.read()
        written = json.loads(receipt.file("results.json").read_text(encoding="utf-8"))
        had_models = any(factors["ranking"] is not None for factors in written["factors"])
        results = read_results(study, place, has_models=had_models and fits_models())
    except ConfigError as error:
        report.add("table", ok=False, text=str(error))
        return
    wrong = list(wrong_tables(results.episodes, place.path))
    text = f"{len(results.episodes.rows)} rows are those of the evaluations"
    report.add("table", ok=not wrong, text="; ".join(wrong) or text)
    if receipt.content["versions"].get("numpy") != versions()["numpy"]:
        text = "another version of numpy draws other samples for intervals"
        report.add("results", ok=None, text=text)
        return
    wrong = []
    computed = results.plain_dict()
    if not is_same(receipt.content["results"], computed["arms"]):
        wrong.append("those of the receipt do not follow from the episodes")
    names = ["arms", "across_tasks", "pairs"]
    texts = results.texts()
    if had_models and not fits_models():
        report.add("factors", ok=None, text="their joint model needs statsmodels")
        del texts["results.md"]  # which has it
    else:
        names.append("factors")
    for name in names:
        if not is_same(written.get(name), computed[name]):
            wrong.append(f"{name} of results.json do not follow from the episodes")
    for name, text in texts.items():
        if receipt.file(name).read_bytes() != text.encode():
            wrong.append(f"{name} does not follow from the episodes")
    report.add("results", ok=not wrong, text="; ".join(wrong) or "they follow from the episodes")


def is_same(first: Any, second: Any, tolerance: float = _SAME_NUMBER) -> bool:
    """Whether plain values are the same; a number that is not finite is None, as in JSON.

    Args:
        first: Maps, lists, numbers, texts.
        second: The others.
        tolerance: Largest difference of numbers, relative to them and to 1.
    """
    if isinstance(first, Mapping) and isinstance(second, Mapping):
        names = first.keys()
        return names == second.keys() and all(
            is_same(first[name], second[name], tolerance) for name in names
        )
    if isinstance(first, list | tuple) and isinstance(second, list | tuple):
        return len(first) == len(second) and all(
            is_same(one, other, tolerance) for one, other in zip(first, second, strict=True)
        )
    if isinstance(first, float) and isinstance(second, float):
        return math.isclose(first, second, rel_tol=tolerance, abs_tol=tolerance)
    if isinstance(second, float) and not math.isfinite(second):
        return first is None
    return bool(first == second)
