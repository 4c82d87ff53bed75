"""The package's front door: `make` and `__version__`, both free of heavy imports.

`make` is found on first use, so that `import embodichain` stays fast. Importing the package also
registers ``embodichain/NAME-v0`` of every YAML task with Gymnasium, once that is imported too.
EmbodiChain's import paths are answered by `compat`, whose terms join the built-in ones.
"""

from typing import TYPE_CHECKING

import lazy_loader

from embodichain.compat import moved, names
from embodichain.config.gymnasium_ids import register_with_gymnasium
from embodichain.utils.on_disk import require_files

if TYPE_CHECKING:
    from embodichain.config.environments.factory import make

__version__ = "0.1.0"

__getattr__, __dir__, _ = lazy_loader.attach(
    __name__, submod_attrs={"config.environments.factory": ["make"]}
)

__all__ = ["__version__", "make"]

require_files(__file__)
names.install()
moved.install()

from embodichain.utils.plugins import MISSING_NAMES, TERM_MODULES  # noqa: E402  (found by the hook)

TERM_MODULES.append("embodichain.compat.terms")
MISSING_NAMES.append("embodichain.compat.unavailable")
register_with_gymnasium()
