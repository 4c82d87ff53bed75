"""The log of a run: an MCAP file (or several) that is recorded, read, replayed and verified.

Names are imported on first use, so importing this package is cheap.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "api": ["Log"],
        "demonstrations": ["Episode", "read_episodes"],
        "joining": ["inspect", "open", "verify"],
        "log_diff": ["DiffReport", "LogDifference", "diff"],
        "options": ["ImageOptions", "RecordOptions"],
        "recorder": ["McapRecorder"],
        "summary": ["LogSummary"],
        "verification": ["Difference", "VerifyReport"],
    },
)
