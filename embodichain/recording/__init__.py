"""The log: one MCAP file a run, written while it runs, read, replayed and verified.

Names are found on first use, so that importing this package costs nothing.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "api": ["Log", "open"],
        "log_diff": ["DiffReport", "LogDifference", "diff"],
        "options": ["RecordOptions"],
        "recorder": ["McapRecorder"],
        "summary": ["LogSummary", "inspect"],
        "verification": ["Difference", "VerifyReport", "verify"],
    },
)
