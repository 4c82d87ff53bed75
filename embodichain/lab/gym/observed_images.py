"""`observed_images`: names of the pictures of sensors with ``observe: true`` in data sets."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.configs.sensor_cfg import SensorCfg

__all__ = ["camera_uids", "observed_images", "rgb"]

_SENSOR = "sensor/"
_COLOR = "color"
_RIGHT = "_right"


def camera_uids(task: Mapping[str, Any]) -> set[str]:
    """Uids of the camera sensors of a task's config."""
    sensors: Mapping[str, Any] = task.get("sensors") or {}
    configs = {uid: SensorCfg.from_dict(_copy(values)) for uid, values in sensors.items()}
    return {uid for uid, cfg in configs.items() if cfg.reads_images}


def _copy(value: Any) -> Any:
    """A frozen config as maps and lists that can be changed."""
    if isinstance(value, Mapping):
        return {key: _copy(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_copy(item) for item in value]
    return value


def observed_images(
    paths: Iterable[str], cameras: Collection[str], taken: Collection[str] = ()
) -> dict[str, str]:
    """Name the pictures of observed cameras.

    The colours of a camera have its name, those of a stereo camera's right eye ``UID/right``, other
    outputs ``UID/OUTPUT``. A name that is taken is replaced by the path.

    Args:
        paths: Paths of entries of an observation; pictures are ``sensor/UID/OUTPUT``.
        cameras: Uids of the camera sensors.
        taken: Names of other pictures.

    Returns:
        Name -> path.
    """
    path_of_name: dict[str, str] = {}
    for path in paths:
        uid, _, output = path.removeprefix(_SENSOR).rpartition("/")
        if not path.startswith(_SENSOR) or uid not in cameras:
            continue
        eye = f"{uid}/right" if output.endswith(_RIGHT) else uid
        kind = output.removesuffix(_RIGHT)
        name = eye if kind == _COLOR else f"{eye}/{kind}"
        path_of_name[path if name in taken else name] = path
    return path_of_name


def rgb(pictures: NDArray[Any]) -> NDArray[Any]:
    """(n, H, W, C) pictures of a sensor: colours without alpha; other outputs have one channel."""
    if pictures.ndim == 3:
        return pictures[..., None]
    return pictures[..., :3] if pictures.dtype == np.uint8 else pictures
