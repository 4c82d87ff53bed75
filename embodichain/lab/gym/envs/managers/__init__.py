"""Managers, which run the declared terms of a task, and the registry of terms."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "action_manager": ["ActionManager"],
        "random_managers": ["CommandManager", "EventManager"],
        "terms.check": ["check_terms"],
        "manager": ["CurriculumManager"],
        "observation_manager": ["ObservationManager"],
        "terms.physics_draws": ["PhysicsDraw"],
        "terms.registry": ["TERMS", "TermSpec", "register_term", "resolve_term"],
        "scene_entity": ["ResolvedEntity", "resolve_entity"],
        "term": ["ActionTerm", "CommandTerm", "Term"],
        "value_managers": [
            "MetricManager",
            "RewardManager",
            "TerminationManager",
            "check_shapes",
            "check_values",
        ],
    },
)
