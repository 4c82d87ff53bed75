"""The log: one MCAP file a run, written beside the simulation, read, replayed and verified.

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
        "replay": ["inspect", "verify"],
        "summary": ["LogSummary"],
        "verify_report": ["Difference", "VerifyReport"],
    },
)
