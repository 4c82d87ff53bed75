"""Films of recorded environments."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(__name__, submod_attrs={"filming": ["film_log"]})
