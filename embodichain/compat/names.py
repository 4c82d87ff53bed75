"""EmbodiChain's public names: a table of their equivalents, and the import hook that finds them.

For each name the table has the object here, or what to use instead. `install` inserts the hook,
which applies only to modules of EmbodiChain: a module of this package is loaded as usual, and only
a name that it lacks is looked up in the table.

Functors (events, observations, rewards, actions) are not in it: they are looked up among the terms,
and `compat.gym_config.functors` has reasons for missing ones. This module imports no other module
of the package; `scripts/names_table.py` makes a table in docs/compatibility.md from it.
"""

from __future__ import annotations

import importlib
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from pathlib import Path
from types import ModuleType
from typing import Any, Final

__all__ = ["OURS", "REASONS", "install", "reason", "upstream_modules", "upstream_names"]

_ROOT = "embodichain."
_ENVS = "embodichain.lab.gym.envs"
_MANAGERS = f"{_ENVS}.managers"
_SIM = "embodichain.lab.sim"
_DATA = "embodichain.data"
_UTILS = "embodichain.utils"

_PLACES: Final[Mapping[str, tuple[str, ...]]] = {
    f"{_ENVS}.base_env": ("BaseEnv", "EmbodiedEnv"),
    f"{_ENVS}.cfg": ("EnvCfg", "SceneEntityCfg"),
    "embodichain.compat.embodied_cfg": ("EmbodiedEnvCfg",),
    "embodichain.compat.gym_utils": (
        "DEFAULT_MANAGER_MODULES",
        "add_env_launcher_args_to_parser",
        "build_env_cfg_from_args",
        "config_to_cfg",
    ),
    "embodichain.compat.functor_cfgs": (
        "ActionTermCfg",
        "DatasetFunctorCfg",
        "EventCfg",
        "FunctorCfg",
        "ObservationCfg",
        "RewardCfg",
    ),
    "embodichain.recording.viewers.visualization": (
        "ViserServerCfg",
        "VisualizationCfg",
        "add_viser_args_to_parser",
        "visualization_cfg_from_args",
    ),
    f"{_SIM}.cfg": (
        "ArticulationCfg",
        "ClothObjectCfg",
        "GizmoCfg",
        "LightCfg",
        "RigidObjectCfg",
        "RigidObjectGroupCfg",
        "RobotCfg",
        "SoftObjectCfg",
        "SolverCfg",
    ),
    f"{_SIM}.objects": (
        "BatchEntity",
        "ClothObject",
        "Gizmo",
        "Light",
        "RigidObjectGroup",
        "SoftObject",
    ),
    f"{_SIM}.sensors": (
        "BaseSensor",
        "Camera",
        "CameraCfg",
        "SensorCfg",
        "StereoCamera",
        "StereoCameraCfg",
    ),
    f"{_SIM}.shapes": ("VisualMaterialCfg",),
    f"{_MANAGERS}.drawing": ("EventManager",),
    f"{_MANAGERS}.term": ("ActionTerm",),
    f"{_MANAGERS}.value_managers": ("RewardManager",),
    f"{_DATA}.lookup": ("get_data_path",),
    f"{_UTILS}.configclass": ("configclass", "is_configclass"),
}
OURS: Final[Mapping[str, str]] = {
    **{name: f"{place}:{name}" for place, names in _PLACES.items() for name in names},
    "class_to_dict": f"{_UTILS}.configclass:config_to_dict",
    "build_env": "embodichain.lab.gym.utils.registration:build_env",
}
"""Name -> where it is here, for every module of EmbodiChain that has the name."""

_SOLVERS = "declare solver_cfg, and call robot.compute_ik: the solver follows from the arm"
_PLANNERS = "motions are declared: `expert:` in a task, with steps such as move_to, grasp and place"
_LLM = "agents driven by language models are not available"
_RL = "train with `embodichain train task=NAME`, on Stable-Baselines3"
_LEROBOT = "a run's log becomes a data set: `embodichain export last --format lerobot`"
_TASK = "run its gym config, `embodichain run --gym-config FILE`, or declare the task in YAML"
_ENGINE = "it belongs to EmbodiChain's engine; here physics is MuJoCo's"
_ROBOT = "name the robot's file: RobotCfg(fpath=...), or assemble it: RobotCfg(urdf_cfg=...)"
_ASSET = "nothing is downloaded: put the file below EMBODICHAIN_DATA_ROOT and name it in fpath"
_CACHE = "no such files are cached: meshes and materials are compiled into the model"
_HELPER = "a helper of EmbodiChain's own tasks; use torch or numpy"
_LIFETIME = "environments are registered with embodichain.lab.gym.utils.registration.register_env"
_ASSEMBLY = "robots are assembled when they are read: RobotCfg(urdf_cfg=URDFCfg(components=[...]))"
_SOFT = "soft bodies are not available"
_CLOTH = "cloth is not available"
_GROUP = "object groups are not available: add objects one by one"
_TEXTURES = (
    "declare visual_material on a shape; randomize_visual_material and randomize_texture change it"
)

REASONS: Final[Mapping[str, str]] = {
    "embodichain.embodichain_dir": "use pathlib.Path(embodichain.__file__).parent",
    "embodichain.agents.datasets": _LEROBOT,
    "embodichain.agents.engine": _LEROBOT,
    "embodichain.agents.hierarchy": _LLM,
    "embodichain.agents.mllm": _LLM,
    "embodichain.agents.rl": _RL,
    _DATA: "use embodichain.data.data_root()",
    f"{_DATA}.assets": _ASSET,
    f"{_DATA}.constants": "use embodichain.data.data_root()",
    f"{_DATA}.dataset": _ASSET,
    f"{_DATA}.download": _ASSET,
    f"{_DATA}.enum": _HELPER,
    "embodichain.gen_sim": "assets are not generated here: name the files of finished ones",
    "embodichain.lab.devices": "policy=teleop moves a simulated robot; real robots are not driven",
    f"{_ENVS}.action_bank": "declare `expert:` in a task, then `embodichain collect`",
    f"{_MANAGERS}.dataset_manager": _LEROBOT,
    f"{_MANAGERS}.datasets": _LEROBOT,
    f"{_MANAGERS}.events": _HELPER,
    f"{_MANAGERS}.manager_base": f"write a term: a function, or a class below {_MANAGERS}.Term",
    f"{_MANAGERS}.object": _HELPER,
    f"{_MANAGERS}.randomization": _HELPER,
    f"{_ENVS}.tasks": _TASK,
    f"{_ENVS}.wrapper": "override is_task_success",
    "embodichain.lab.gym.utils.gym_utils": _HELPER,
    "embodichain.lab.gym.utils.misc": _HELPER,
    "embodichain.lab.gym.utils.registration": _LIFETIME,
    "embodichain.lab.scripts": "use the command: embodichain run, embodichain show",
    f"{_SIM}.atom_actions": _PLANNERS,
    f"{_SIM}.atomic_actions": _PLANNERS,
    f"{_SIM}.cfg.ClothPhysicalAttributesCfg": _CLOTH,
    f"{_SIM}.cfg.SoftbodyPhysicalAttributesCfg": _SOFT,
    f"{_SIM}.cfg.SoftbodyVoxelAttributesCfg": _SOFT,
    f"{_SIM}.init_dynamic_pybind": _ENGINE,
    f"{_SIM}.material": _TEXTURES,
    f"{_SIM}.objects.cloth_object": _CLOTH,
    f"{_SIM}.objects.gizmo": "gizmos are not available",
    f"{_SIM}.objects.rigid_object_group": _GROUP,
    f"{_SIM}.objects.robot.ControlGroup": "Robot.control_parts has each part's joint names",
    f"{_SIM}.objects.set_projective_uv": _ENGINE,
    f"{_SIM}.objects.soft_object": _SOFT,
    f"{_SIM}.planners": _PLANNERS,
    f"{_SIM}.robots": _ROBOT,
    f"{_SIM}.sensors.contact_sensor": "ContactSensorCfg(of=...) names the links",
    f"{_SIM}.sensors.stereo.PairCameraView": "StereoCamera.get_left_right_arena_pose has the poses",
    f"{_SIM}.sim_manager": _CACHE,
    f"{_SIM}.solvers": _SOLVERS,
    f"{_SIM}.utility": _ENGINE,
    f"{_SIM}.utility.action_utils": _PLANNERS,
    f"{_SIM}.utility.atom_action_utils": _PLANNERS,
    f"{_SIM}.utility.cfg_utils": "a config is changed with its method replace",
    f"{_SIM}.utility.solver_utils": _SOLVERS,
    f"{_SIM}.utility.tensor": "use torch.as_tensor",
    f"{_SIM}.utility.workspace_analyzer": (
        "no map is kept: poses that are reached are drawn, by sampling"
    ),
    "embodichain.toolkits.acd": "`collision: decompose` splits a mesh into convex parts",
    "embodichain.toolkits.code_generation": _LLM,
    "embodichain.toolkits.graspkit": "the step `grasp` of an `expert:` takes declared ones",
    "embodichain.toolkits.toolkits": _LLM,
    "embodichain.toolkits.urdf_assembly": _ASSEMBLY,
    f"{_UTILS}.GLOBAL_SEED": "EnvCfg.seed, or reset(seed=...)",
    f"{_UTILS}.set_seed": "EnvCfg.seed, or reset(seed=...)",
    f"{_UTILS}.cfg": "configs are configclasses; files are read by Hydra",
    f"{_UTILS}.configclass": "use configclass, and the methods to_dict, from_dict and replace",
    f"{_UTILS}.device_utils": "device=cpu, cuda or cuda:N says where physics runs",
    f"{_UTILS}.file": "use pathlib",
    f"{_UTILS}.img_utils": "use numpy or pillow",
    f"{_UTILS}.math": "embodichain.utils.math has quaternions and poses in numpy",
    f"{_UTILS}.module_utils": "use importlib and inspect",
    f"{_UTILS}.string": "use re.fullmatch",
    f"{_UTILS}.utility": _HELPER,
    f"{_UTILS}.visualizer": "embodichain compare RUN -o curves.png draws curves; view opens a log",
    f"{_UTILS}.warp": "device=cuda runs physics on MuJoCo Warp, with its own kernels",
}
"""Missing module, or a name of it -> what to use instead; the most specific entry applies."""

_LATER: Final[Mapping[str, tuple[str, ...]]] = {
    "embodichain.lab.visualization": _PLACES["embodichain.recording.viewers.visualization"],
    "embodichain.lab.visualization.cfg": ("ViserServerCfg", "VisualizationCfg"),
    "embodichain.lab.visualization.cli": (
        "add_viser_args_to_parser",
        "visualization_cfg_from_args",
    ),
}
"""Modules of release 0.2.4 that its tutorials import."""
_KINDS: Final = ("event", "observation", "reward", "action")


@cache
def _upstream() -> dict[str, frozenset[str]]:
    text = Path(__file__).with_name("upstream_names.json").read_text(encoding="utf-8")
    return {m: frozenset(names) for m, names in (*json.loads(text).items(), *_LATER.items())}


def upstream_modules() -> frozenset[str]:
    """Modules of EmbodiChain 0.2.1 and a few later ones, by their dotted names."""
    return frozenset(_upstream())


def upstream_names(module: str) -> frozenset[str]:
    """Public names of a module of EmbodiChain; empty if there is no such module."""
    return _upstream().get(module, frozenset())


def available(module: str) -> list[str]:
    """The names of a module that are available, in order."""
    return sorted(
        name for name in upstream_names(module) if name in OURS or _term(module, name) is not None
    )


def find(module: str, name: str) -> Any:
    """Return the object here for a name of EmbodiChain.

    Args:
        module: The module it is imported from.
        name: One of `upstream_names`.

    Raises:
        NotImplementedError: It is not available; names what to use instead.
    """
    target = OURS.get(name)
    if target is not None:
        place, _, attribute = target.partition(":")
        return getattr(importlib.import_module(place), attribute)
    term = _term(module, name)
    if term is None:
        raise NotImplementedError(f"{module}.{name} is not available: {reason(module, name)}")
    return term


def reason(module: str, name: str) -> str:
    """What to use instead of a name that is not available; never empty."""
    if module.startswith(_MANAGERS):
        from embodichain.compat.gym_config.functors import LEFT_OUT

        for kind in _KINDS:
            if name in LEFT_OUT[kind]:
                return LEFT_OUT[kind][name]
    reason_of_name = REASONS.get(f"{module}.{name}")
    if reason_of_name:
        return reason_of_name
    modules = [other for other, names in _upstream().items() if name in names]
    modules.sort(key=len, reverse=True)
    # A package's `__init__` has names of its modules, whose reasons are more specific.
    submodules = [other for other in modules if other.startswith(f"{module}.")]
    for place in (*submodules, module, *modules):
        reason_of_module = _closest_reason(place)
        if reason_of_module:
            return reason_of_module
    return ""


def _closest_reason(module: str) -> str:
    """The reason for a module, or for its nearest parent package that has one."""
    while module and not REASONS.get(module):
        module = module.rpartition(".")[0]
    return REASONS.get(module, "")


def _term(module: str, name: str) -> Any:
    """The term for a functor of EmbodiChain (for an alias, its name), or None."""
    if not module.startswith(_MANAGERS):
        return None
    from embodichain.compat.gym_config.functors import ACTIONS
    from embodichain.lab.gym.envs.managers.terms.aliases import AliasSpec
    from embodichain.lab.gym.envs.managers.terms.registry import TERMS

    for kind in _KINDS:
        spec = TERMS[kind].get(ACTIONS.get(name, name))
        if isinstance(spec, AliasSpec):
            return spec.name
        if spec is not None:
            return spec.func
    return None


# -- the import hook -------------------------------------------------------------------------------


class _Completed(SourceFileLoader):
    """Loads a module of this package and adds the EmbodiChain names that it lacks."""

    def exec_module(self, module: ModuleType) -> None:
        super().exec_module(module)
        complete(module)


class _Alias(Loader):
    """Creates a module that exists only in EmbodiChain, with its names."""

    def create_module(self, spec: ModuleSpec) -> None:
        """Return None, so that Python creates the module."""

    def exec_module(self, module: ModuleType) -> None:
        module.__doc__ = (
            f"EmbodiChain's `{module.__name__}`; docs/compatibility.md lists its names."
        )
        module.__dir__ = lambda: available(module.__name__)  # type: ignore[method-assign]
        complete(module)


class _Finder(MetaPathFinder):
    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if not fullname.startswith(_ROOT) or fullname not in upstream_modules():
            return None
        spec = PathFinder.find_spec(fullname, path, target)
        if spec is None or spec.origin is None:  # no such module, or a folder without Python
            prefix = f"{fullname}."
            is_package = any(name.startswith(prefix) for name in upstream_modules())
            alias = ModuleSpec(fullname, _Alias(), is_package=is_package)
            if spec is not None:
                alias.submodule_search_locations = spec.submodule_search_locations
            return alias
        if type(spec.loader) is SourceFileLoader and upstream_names(fullname):
            spec.loader = _Completed(fullname, spec.loader.path)
        return spec


def complete(module: ModuleType) -> None:
    """Look up EmbodiChain's names in a module that lacks them."""
    module_name = module.__name__
    names = upstream_names(module_name)
    getattr_of_module: Callable[[str], Any] | None = module.__dict__.get("__getattr__")

    def look_up(name: str) -> Any:
        if getattr_of_module is not None:
            try:
                return getattr_of_module(name)
            except AttributeError:
                if name not in names:
                    raise
        if name in names:
            return find(module_name, name)
        if name == "__all__" and module.__spec__ and isinstance(module.__spec__.loader, _Alias):
            return available(module_name)
        raise AttributeError(f"module {module_name!r} has no attribute {name!r}")

    module.__getattr__ = look_up  # type: ignore[method-assign]


def install() -> None:
    """Insert the finder first and complete the modules already loaded; once per process."""
    if any(isinstance(finder, _Finder) for finder in sys.meta_path):
        return
    for name, module in list(sys.modules.items()):
        if name == "embodichain" or name.startswith(_ROOT) and upstream_names(name):
            complete(module)
    sys.meta_path.insert(0, _Finder())
