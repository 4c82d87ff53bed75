"""`embodichain verify`: check a receipt against its files, its logs and its policy."""

from __future__ import annotations

import sys
from dataclasses import asdict, dataclass
from pathlib import Path

import click

from embodichain.cli.terminal.output import print_json, print_table
from embodichain.cli.terminal.process import FAILED, OK
from embodichain.cli.terminal.reporting import warnings_on_stderr
from embodichain.cli.verb import verb

__all__ = ["command"]


@dataclass(frozen=True)
class VerifyOptions:
    """What was typed after `verify`.

    Attributes:
        receipt: The receipt, or the folder of its run or study.
        policy: The policy's file, where it is not where the receipt says.
        every: Simulate all evaluations of a study.
        trust: Run code of the policy's file, if it cannot be read without.
        sample_seed: Chooses the sample of a study; None draws a seed.
        quiet: Print nothing.
        json: Print the result as one JSON object.
    """

    receipt: str
    policy: str | None
    every: bool
    trust: bool
    sample_seed: int | None
    quiet: bool
    json: bool


@verb(
    "verify",
    ("verify outputs/latest", "an evaluation: files, numbers, physics, actions"),
    ("verify outputs/studies/reach_light", "a study: every file, a sample of its evaluations"),
    ("verify outputs/studies/reach_light --all", "all of them"),
    ("verify receipt.json --policy final.zip", "with the policy's file elsewhere"),
    options=VerifyOptions,
    quiet=True,
)
@click.argument("receipt", metavar="RECEIPT")
@click.option("--policy", metavar="FILE", help="The policy's file.")
@click.option("--all", "every", is_flag=True, help="Simulate all evaluations of a study.")
@click.option("--trust", is_flag=True, help="Run code of the policy's file, if it needs that.")
@click.option("--sample-seed", type=click.IntRange(0), metavar="S", help="Draws a sample again.")
def command(options: VerifyOptions) -> int:
    """Check that files, numbers, physics and actions are those of a receipt."""
    from embodichain.cli.proof.receipt_check import check_receipt

    with warnings_on_stderr():
        report = check_receipt(
            Path(options.receipt),
            policy=None if options.policy is None else Path(options.policy),
            every=options.every,
            trust=options.trust,
            sample_seed=options.sample_seed,
        )
    if options.json:
        findings = [asdict(finding) for finding in report.findings]
        print_json({"ok": report.ok, "findings": findings, "notes": report.notes})
    elif not options.quiet:
        words = {True: "as stated", False: "NOT as stated", None: "not checked"}
        rows = [
            {"checked": finding.what, "result": words[finding.ok], "found": finding.text}
            for finding in report.findings
        ]
        title = "verified" if report.ok else "NOT verified"
        print_table(f"{title}: {report.path}", rows)
        sys.stdout.write("".join(f"note: {note}\n" for note in report.notes))
    return OK if report.ok else FAILED
