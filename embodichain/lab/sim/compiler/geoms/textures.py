"""Textures of rigid objects, from image files: checks, and MuJoCo's textures for them."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

import mujoco

from embodichain.data import DataNotFoundError, get_data_path
from embodichain.utils.errors import OutsideError, Problem
from embodichain.utils.system.pictures import open_picture

__all__ = ["add_textures", "check_textures", "declared_textures"]

_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".webp")
_MAX_PIXELS = 8192
"""Longest side."""


def check_textures(names: Sequence[str], path: str) -> list[Problem]:
    """Return a problem for each file or folder that has no readable image.

    Args:
        names: The files and folders.
        path: The key path of the list.
    """
    from PIL import Image

    if not names:
        return [Problem(path, "names no image; leave it out for a plain surface")]
    problems: list[Problem] = []
    for number, name in enumerate(names):
        key = f"{path}.{number}"
        try:
            files = _files(name)
        except (DataNotFoundError, OutsideError) as error:
            problems.append(Problem(key, str(error)))
            continue
        if not files:
            message = f"no image in {name}; known endings: {', '.join(_SUFFIXES)}"
            problems.append(Problem(key, message))
        for file in files:
            try:
                with open_picture(file) as image:
                    if max(image.size) > _MAX_PIXELS:
                        raise ValueError(
                            f"at most {_MAX_PIXELS} pixels a side, it has {image.size}"
                        )
                    image.load()
            except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
                problems.append(Problem(key, f"{file}: no texture: {_without(error, file)}"))
    return problems


def _without(error: Exception, file: Path) -> str:
    """The message without the name of the file, which is said before it."""
    return str(error).replace(f"{str(file)!r}", "").strip() or type(error).__name__


def add_textures(spec: mujoco.MjSpec, uid: str, names: Sequence[str]) -> list[str]:
    """Add the textures of checked files, and of the images in folders; return their names."""
    files = [file for name in names for file in _files(name)]
    pictures: dict[str, bytes] = {}
    for number, file in enumerate(files):
        buffer = io.BytesIO()
        with open_picture(file) as image:  # MuJoCo reads PNG only
            image.convert("RGB").save(buffer, format="PNG")
        asset = f"{uid}_texture_{number}.png"
        pictures[asset] = buffer.getvalue()
        spec.add_texture(
            name=f"{uid}/texture/{number}",
            type=mujoco.mjtTexture.mjTEXTURE_2D,
            file=asset,
        )
    spec.assets = {**spec.assets, **pictures}
    return [f"{uid}/texture/{number}" for number in range(len(files))]


def declared_textures(model: mujoco.MjModel, uid: str) -> tuple[list[int], int]:
    """Ids of an object's declared textures, and the column of ``mat_texid`` with its own."""
    names = [model.texture(i).name for i in range(model.ntex)]
    ids = [i for i, name in enumerate(names) if name.startswith(f"{uid}/texture/")]
    if not ids:
        return [], -1
    roles = model.mat_texid.shape[1]
    role = int(mujoco.mjtTextureRole.mjTEXROLE_RGB)
    return ids, roles * int(model.material(f"{uid}/material").id) + role


def _files(name: str) -> list[Path]:
    path = Path(get_data_path(name))
    if not path.is_dir():
        return [path]
    return sorted(file for file in path.iterdir() if file.suffix.lower() in _SUFFIXES)
