"""The log of a run: an MCAP file (or several) that is recorded, read, replayed and verified.

Names are imported on first use, so importing this package is cheap.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "read.api": ["Log"],
        "demos.demonstrations": ["Episode", "read_episodes"],
        "shards.joining": ["inspect", "open", "verify"],
        "check.log_diff": ["DiffReport", "LogDifference", "diff"],
        "format.options": ["ImageOptions", "RecordOptions"],
        "write.recorder": ["McapRecorder"],
        "read.summary": ["LogSummary"],
        "check.verification": ["Difference", "VerifyReport"],
    },
)
