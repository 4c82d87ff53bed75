"""Exports a log to formats of other programs: tables, demonstrations, ROS 2, Rerun.

Names are imported on first use: each format imports only what it needs.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "episodes": ["export_episodes"],
        "format_register": [
            "EPISODE_FORMATS",
            "FORMATS",
            "episode_format",
            "log_format",
            "required",
        ],
        "log_export": ["export"],
        "log_parts": ["Part"],
    },
)
