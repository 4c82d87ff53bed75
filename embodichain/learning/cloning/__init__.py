"""Learning from demonstrations, as an algorithm of Stable-Baselines3."""

import lazy_loader

# Configs of trainings name the class by this path.
__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__, submod_attrs={"behavior_cloning": ["BehaviorCloning"]}
)
