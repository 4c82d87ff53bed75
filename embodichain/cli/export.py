"""`embodichain export`: a policy as one ONNX or TorchScript file; what a log holds, in other forms.

``export policy ...`` is here, everything else about files of logs in `export_log`.
"""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from embodichain.cli import exits
from embodichain.cli.arguments import VerbParser, add_common, print_json
from embodichain.cli.trained import Target, find_target, split_words
from embodichain.cli.verbs import VERBS
from embodichain.utils.errors import ConfigError

if TYPE_CHECKING:
    from embodichain.learning.exporting import Format

__all__ = ["main"]

_LOGS = "embodichain.cli.export_log"
_LOG_OPTIONS = "Below: `export policy`; for logs, `embodichain export last --help`."
_FORMATS: dict[Format, str] = {"onnx": ".onnx", "torchscript": ".pt"}


def main(arguments: list[str]) -> int:
    """Export a policy, or hand on to the export of logs."""
    first = next((word for word in arguments if not word.startswith("-")), None)
    if first is None and not {"-h", "--help"} & set(arguments):
        raise ConfigError("export what? One of: policy RUN, FILE (a log), last")
    if first == "policy" or first is None:
        return _policy(arguments)
    code: int = importlib.import_module(_LOGS).main(arguments)
    return code


def _policy(arguments: list[str]) -> int:
    parser = VerbParser(VERBS["export"])
    parser.description = f"{parser.description}\n{_LOG_OPTIONS}"
    parser.add_argument("what", choices=["policy"], help="what is exported")
    parser.add_argument("words", nargs="*", metavar="RUN|last|PATH|key=value", help="the policy")
    parser.add_argument("--format", choices=list(_FORMATS), default="onnx", help="else onnx")
    parser.add_argument("--output", "-o", metavar="OUT", help="a new file; else beside the policy")
    add_common(parser, config_dir=True)
    options = parser.parse(arguments)
    names, overrides = split_words(options.words)
    if len(names) != 1:
        raise ConfigError("export what? One of: RUN (a training's folder), last, PATH (a policy)")
    target = find_target(names[0])
    if target.file is None or target.file.suffix in _FORMATS.values():
        raise ConfigError(f"policy: only zips of Stable-Baselines3 are exported, not {names[0]}")
    out = Path(options.output) if options.output is not None else _beside(target, options.format)
    from embodichain.config.search_path import user_configs

    with user_configs(options.config_dir):
        facts = _export(target, overrides, out, options.format)
    if options.json:
        print_json(facts)
    else:
        worst = f"at most {facts['largest_difference']:.2g} from Stable-Baselines3's actions"
        sys.stdout.write(f"{out}: {facts['task']}, {facts['algo']}, {worst}\n")
    return exits.OK


def _beside(target: Target, form: Format) -> Path:
    """``policy.onnx`` in the run's folder, ``NAME.onnx`` beside a file that belongs to none."""
    if target.run is not None:
        return target.run / f"policy{_FORMATS[form]}"
    return Path(target.policy).with_suffix(_FORMATS[form])


def _export(target: Target, overrides: list[str], out: Path, form: Format) -> dict[str, Any]:
    from embodichain.config.factory import make_env
    from embodichain.learning.exporting import export_policy
    from embodichain.learning.policy import load_model

    fresh = {"viewer": {"name": "none"}, "algo": None, "num_envs": 1, "resume": None}
    fresh |= {"allow_changed": False}
    resolved = target.resolve(overrides, fresh)
    policy = load_model(Path(target.policy))
    policy.allow_changed = resolved.root.allow_changed
    env = make_env(resolved)
    try:
        worst = export_policy(policy, env, out, form, task=resolved.task_name)
    finally:
        env.close()
    return {
        "file": str(out),
        "format": form,
        "task": resolved.task_name,
        "algo": policy.algo,
        "policy": target.policy,
        "largest_difference": worst,
    }
