"""Where robot and object files come from: lookup, catalogue, and the bundled assets.

Nothing here reads a model: `embodichain.lab.sim` does. No torch, no mujoco.
"""

from typing import TYPE_CHECKING

import lazy_loader

if TYPE_CHECKING:
    from embodichain.data.catalog import Asset, list_assets, list_robots
    from embodichain.data.errors import DataNotFoundError
    from embodichain.data.faults import fault_of
    from embodichain.data.lookup import get_data_path, resolve_package_uri
    from embodichain.data.places import data_root

__getattr__, __dir__, _ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "catalog": ["Asset", "list_assets", "list_robots"],
        "errors": ["DataNotFoundError"],
        "faults": ["fault_of"],
        "lookup": ["get_data_path", "resolve_package_uri"],
        "places": ["data_root"],
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
