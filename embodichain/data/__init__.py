"""Robot and object files: lookup, catalogue, and the bundled assets.

`embodichain.lab.sim` reads the models. Nothing here imports torch or mujoco.
"""

from typing import TYPE_CHECKING

import lazy_loader

if TYPE_CHECKING:
    from embodichain.data.catalog import Asset, list_assets, list_robots
    from embodichain.data.lookup import fault_of, get_data_path, resolve_package_uri
    from embodichain.data.places import DataNotFoundError, data_root

__getattr__, __dir__, _ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "catalog": ["Asset", "list_assets", "list_robots"],
        "lookup": ["fault_of", "get_data_path", "resolve_package_uri"],
        "places": ["DataNotFoundError", "data_root"],
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
