"""The table of verbs: name, what it does in one line, examples. Imports no verb.

Each verb is the module `embodichain.cli.NAME` with ``main(arguments) -> int``; a dash in its name
is an underscore in the module's.
"""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["EVERYDAY_KEYS", "EXIT_CODES", "VERBS", "Verb", "overview"]


@dataclass(frozen=True, slots=True)
class Verb:
    """One verb of the command line.

    Attributes:
        name: What people type; also the module's name.
        summary: One line for the overview.
        usage: Arguments after the verb.
        examples: Arguments and what they do, for `--help`.
        overrides: Whether it takes ``key=value`` overrides, and so completes them.
    """

    name: str
    summary: str
    usage: str
    examples: tuple[tuple[str, str], ...]
    overrides: bool = False

    def epilog(self) -> str:
        """Keys and examples as `--help` shows them."""
        width = max(len(arguments) for arguments, _ in self.examples)
        lines = [f"  embodichain {a:<{width}}   {what}" for a, what in self.examples]
        return "\n".join([*(_KEYS if self.overrides else ()), "examples:", *lines])


_RUN = Verb(
    "run",
    "Run a task: simulate, show progress, write a log.",
    "[task=NAME] [key=value ...] [options]",
    (
        ("run task=random_reach num_envs=4", "as the task suggests, four environments"),
        ("run task=random_reach episodes=2 seed=1 record=none", "two episodes each, no log"),
        ("run task=random_reach task.physics.physics_dt=0.005", "change any value of the task"),
        ("run task=reach policy=outputs/latest", "play what was trained there"),
        ("run -m task=random_reach seed=0,1", "a sweep: one run for each seed"),
        ("run --gym-config gym_config.yaml", "a task in EmbodiChain's own form"),
        ("run task=random_reach --cfg job", "print the config, run nothing"),
    ),
    overrides=True,
)
_RUN_ENV = Verb(
    "run-env",
    "EmbodiChain's command: run --gym-config, with its flags.",
    "--gym_config FILE [key=value ...] [options]",
    (
        ("run-env --gym_config gym_config.json --num_envs 4 --headless", "four environments"),
        ("run-env --gym_config gym_config.json record=none max_steps=100", "with keys of `run`"),
    ),
)
_TRAIN = Verb(
    "train",
    "Train a policy with Stable-Baselines3.",
    "[task=NAME] [key=value ...] [options]",
    (
        ("train task=reach", "as the task suggests"),
        ("train task=reach total_timesteps=8192", "shorter"),
        ("train task=reach algo.learning_rate=3e-4 seed=1", "another learning rate and seed"),
        ("train task=reach algo=sac algo.normalize=obs", "another algorithm; normalized"),
        ("train resume=last total_timesteps=400_000", "go on from the newest checkpoint"),
        ("train -m task=reach seed=0,1,2", "a sweep: one training for each seed"),
    ),
    overrides=True,
)
_EVAL = Verb(
    "eval",
    "Play a policy for exactly N episodes; say how far the numbers can be trusted.",
    "RUN|last|PATH [task=NAME] [episodes=N] [deterministic=false] [key=value ...] [options]",
    (
        ("eval last", "the newest training, 100 episodes"),
        ("eval outputs/latest episodes=500 seed=7", "more of them, others"),
        ("eval last deterministic=false", "actions drawn as in training"),
        ("eval policy.onnx task=reach", "a file, in a task"),
        ("eval random task=reach episodes=50 record=none", "what chance reaches, without a log"),
    ),
    overrides=True,
)
_PLAY = Verb(
    "play",
    "Show a trained policy in a window.",
    "RUN|last|PATH [key=value ...] [options]",
    (
        ("play last", "the newest training, five episodes"),
        ("play last --episodes 20 seed=3", "more of them"),
        ("play policy.onnx task=reach", "a file, in a task"),
        ("play last viewer=none record=mcap", "without a window, into a log"),
    ),
    overrides=True,
)
_COMPARE = Verb(
    "compare",
    "Put trainings side by side: a table, and curves with intervals over seeds.",
    "RUN RUN... [-o OUT] [options]",
    (
        ("compare outputs/2026-11-21/*_reach", "runs that differ by their seed are one line"),
        ("compare last outputs/older -o curves.png", "with learning curves"),
    ),
)
_EXPORT = Verb(
    "export",
    "Write a log for another program, or a trained policy as one ONNX or TorchScript file.",
    "FILE|last --format csv|npz|parquet|hdf5|lerobot|rrd|ros2|mp4"
    " | policy RUN|last|PATH [task=NAME] [-o OUT]",
    (
        ("export last --format csv", "the newest log as a table, beside it"),
        ("export FILE --format hdf5 -o demos.hdf5", "episodes in robomimic's layout"),
        ("export last --format ros2 --env 2 --from 0 --to 100", "a ROS 2 bag of a part"),
        ("export policy last", "policy.onnx in the run's folder"),
        ("export policy last --format torchscript -o reach.pt", "for C++ and PyTorch"),
        ("export policy my_model.zip task=reach", "a zip of your own"),
    ),
)
_REPLAY = Verb(
    "replay",
    "Say what a log holds; with --verify simulate it again and compare every bit.",
    "FILE|last [options]",
    (
        ("replay last", "the newest run's log"),
        ("replay last --verify", "simulate it again from the file alone"),
        ("replay last --verify --env 2 --episode 0", "only that environment and episode"),
        ("replay last --env 2 --from 100 --to 200", "list its episodes between these steps"),
        ("replay last --view web", "play it in a browser; --view alone: in a window"),
        ("replay last --policy zero", "the same episodes with another policy, side by side"),
        ("replay last --video film.mp4 --env 2 --speed 0.5", "film it, at half the speed"),
        ("replay outputs/latest/rollout.mcap --json", "what it holds, for scripts"),
    ),
)
_VIEW = Verb(
    "view",
    "Say how to look at a log in Foxglove or Lichtblick; open it, or play it to them.",
    "FILE|last [options]",
    (
        ("view last", "the newest run's log, and the layout beside it"),
        ("view outputs/latest --open", "with the program that the desktop has for it"),
        ("view last --serve", "play it at ws://127.0.0.1:8765, also a broken one"),
    ),
)
_RECOVER = Verb(
    "recover",
    "Write a clean log from a broken one, up to where it is good.",
    "IN|last OUT [options]",
    (
        ("recover last saved.mcap", "the newest run's log; it is only read"),
        ("recover broken.mcap saved.mcap --json", "what was saved, for scripts"),
    ),
)
_DIFF = Verb(
    "diff",
    "Name the first step and field where two logs part.",
    "A B [options]",
    (
        ("diff outputs/A outputs/B", "two runs; exits 0 if they are the same, 1 if not"),
        ("diff old.mcap new.mcap --json", "for scripts"),
    ),
)
_BENCH = Verb(
    "bench",
    "Measure control steps/s beside the bare batch of the same model.",
    "task=NAME [num_envs=1,64,1024] [key=value ...] [options]",
    (
        ("bench task=random_reach num_envs=1,64,1024", "three sizes"),
        ("bench task=push_cube num_envs=64 --rounds 3 --json", "quicker, for scripts"),
    ),
    overrides=True,
)
_LIST = Verb(
    "list",
    "List tasks, robots or terms.",
    "tasks|robots|terms [options]",
    (
        ("list tasks", "every task that task=NAME finds"),
        ("list robots", "robot files that a task can name"),
        ("list terms", "functions for events, observations, rewards, ..."),
        ("list terms --markdown", "the same as a page, with parameters and examples"),
    ),
)
_SHOW = Verb(
    "show",
    "Show a task: resolved config, scene, spaces, terms; or one term.",
    "task=NAME [key=value ...] | term NAME [options]",
    (
        ("show task=reach", "everything"),
        ("show term within_distance", "what one term takes, with an example"),
        ("show task=reach --config", "only the resolved config, as YAML"),
        ("show task=reach --json", "everything, for scripts"),
    ),
    overrides=True,
)
_VALIDATE = Verb(
    "validate",
    "Check a task, build it as `run` does, and print every mistake.",
    "[--config-dir DIR] task=NAME [key=value ...] | FILE",
    (
        ("validate task=reach", "a task that ships with embodichain"),
        ("validate --train task=reach algo=sac", "as `train` would read it"),
        ("validate task=reach task.max_episode_steps=50", "with overrides"),
        ("validate --config-dir my_conf task=random_reach", "with a folder of yours"),
    ),
    overrides=True,
)
_CONVERT = Verb(
    "convert",
    "Write EmbodiChain's own config of a task as a task file of ours.",
    "FILE [-o OUT] [options]",
    (
        ("convert gym_config.yaml", "print the task, and what cannot come along"),
        ("convert gym_config.json -o conf/task/push.yaml", "write it; then: run task=push"),
    ),
)
_NEW = Verb(
    "new",
    "Write a task and its test into your folder or package.",
    "task NAME [--robot FILE] [--python] [options]",
    (
        ("new task my_reach", "YAML: conf/task/my_reach.yaml and tests/test_my_reach.py"),
        ("new task my_reach --python", "a class, and the YAML that names it"),
        (
            "new task my_pick --robot panda_description/urdf/panda.urdf",
            "for a robot of yours: its joints, its links",
        ),
    ),
)
_DOCTOR = Verb(
    "doctor",
    "Check this machine: versions, threads, rendering, disk, optional parts.",
    "[options]",
    (("doctor", "a table, with what to do where something is missing"), ("doctor --json", "")),
)

VERBS: dict[str, Verb] = {
    verb.name: verb
    for verb in (
        *(
            _RUN,
            _TRAIN,
            _EVAL,
            _PLAY,
            _COMPARE,
            _EXPORT,
            _REPLAY,
            _VIEW,
            _RECOVER,
            _DIFF,
            _BENCH,
            _LIST,
            _SHOW,
            _VALIDATE,
            _CONVERT,
            _RUN_ENV,
            _NEW,
            _DOCTOR,
        ),
    )
}

EVERYDAY_KEYS = (
    *("task", "num_envs", "episodes", "max_steps", "total_timesteps", "seed", "policy"),
    *("record", "viewer", "device", "sim", "output_dir"),
)
_KEYS = (
    "keys:",
    f"  {' '.join(EVERYDAY_KEYS)}",
    "  all of them, with their values: embodichain show task=NAME --config",
    "",
)

EXIT_CODES = "exit codes: 0 ok, 1 the run failed, 2 wrong input, 130 interrupted"


def overview() -> str:
    """The text of `embodichain --help`."""
    lines = [f"  {verb.name:<10}{verb.summary}" for verb in VERBS.values()]
    return "\n".join(
        [
            "usage: embodichain VERB [arguments]",
            "",
            "One YAML tree is one robot experiment: scene, task, learning, and a log that replays.",
            "",
            "verbs:",
            *lines,
            "",
            "options:",
            "  -h, --help              this text; `embodichain VERB --help` for one verb",
            "  --version               versions of embodichain, Python and MuJoCo",
            "  -sc install=bash        completion for bash (zsh, fish); to switch it on, type",
            '                          eval "$(embodichain -sc install=bash)"',
            "",
            "examples:",
            "  embodichain run task=random_reach num_envs=4",
            "  embodichain replay last --verify",
            "  embodichain list tasks",
            "",
            EXIT_CODES,
            "",
        ]
    )
