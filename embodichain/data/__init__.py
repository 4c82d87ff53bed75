"""Robot and object files: lookup, catalogue, and the bundled assets.

`embodichain.lab.sim` reads the models. Nothing here imports torch or mujoco.
"""

from typing import TYPE_CHECKING

import lazy_loader

from embodichain.utils.errors import DataNotFoundError

if TYPE_CHECKING:
    from embodichain.data.faults import fault_of
    from embodichain.data.lookup import (
        Asset,
        data_root,
        get_data_path,
        list_assets,
        list_robots,
        resolve_package_uri,
    )

__getattr__, __dir__, _ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "faults": ["fault_of"],
        "lookup": [
            *("Asset", "data_root", "get_data_path", "list_assets", "list_robots"),
            "resolve_package_uri",
        ],
    },
)

__all__ = [
    "Asset",
    "DataNotFoundError",
    "data_root",
    "fault_of",
    "get_data_path",
    "list_assets",
    "list_robots",
    "resolve_package_uri",
]
