"""Managers, one file each: what runs a task's declared terms. Also the registry of terms."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "action_manager": ["ActionManager"],
        "check": ["check_terms"],
        "command_manager": ["CommandManager"],
        "curriculum_manager": ["CurriculumManager"],
        "dry_run": ["check_shapes"],
        "event_manager": ["EventManager"],
        "metric_manager": ["MetricManager"],
        "observation_manager": ["ObservationManager"],
        "registry": ["TERMS", "TermSpec", "register_term", "resolve_term"],
        "reward_manager": ["RewardManager"],
        "scene_entity": ["ResolvedEntity", "resolve_entity"],
        "term": ["ActionTerm", "CommandTerm", "Term"],
        "termination_manager": ["TerminationManager"],
    },
)
