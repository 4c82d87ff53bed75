"""`require_files`: the package's own files lie in a folder."""

from __future__ import annotations

from pathlib import Path

__all__ = ["require_files"]


def require_files(module_file: str) -> None:
    """Check that the package was not imported from an archive.

    MuJoCo, Hydra and PyTorch open tasks, robots and policies by their paths.

    Args:
        module_file: ``__file__`` of the package.

    Raises:
        ImportError: If it was imported from a zip file; gives the file and what to do.
    """
    package = Path(module_file).parent
    if package.is_dir():
        return
    archive = next((path for path in package.parents if path.is_file()), package)
    raise ImportError(
        f"embodichain cannot be imported from an archive ({archive}): MuJoCo and Hydra open its "
        "tasks, robots and policies by path. Install it with pip, or unpack the archive"
    )
