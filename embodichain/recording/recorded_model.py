"""The model that a log was recorded with, from its attachments, if the log's rows fit it.

What is left to do across versions of MuJoCo is decided where a log is read or verified.
"""

from __future__ import annotations

from collections.abc import Callable

import mujoco

from embodichain.lab.sim.engine.api import row_layout
from embodichain.recording.archive import load_mjz
from embodichain.recording.attachments import MODEL, load_mjb, model_digest, unpack_model
from embodichain.recording.header import Header
from embodichain.recording.log_error import LogError

__all__ = ["approximate_model", "check_rows", "exact_model", "model_to_simulate"]

_SHOWN = {"qpos", "qvel", "mocap_pos", "mocap_quat", "ctrl"}
"""Components that are drawn, exported or named by the model."""


def exact_model(header: Header, packed: bytes) -> mujoco.MjModel:
    """The recorded model, to the bit: for the same version of MuJoCo.

    Args:
        header: The log's metadata.
        packed: Its attachment `MODEL`.

    Raises:
        LogError: It is another model, or this MuJoCo does not read it.
    """
    mjb = unpack_model(packed)
    if model_digest(mjb) != header.model:
        raise LogError(f"the attachment {MODEL} is not the model that was recorded")
    try:
        model = load_mjb(mjb)
    except ValueError as error:
        raise LogError(f"the attachment {MODEL} cannot be loaded: {error}") from error
    check_rows(header, model)
    return model


def model_to_simulate(header: Header, attachment: Callable[[str], bytes]) -> mujoco.MjModel:
    """The model with which a log is simulated to the bit.

    Args:
        header: The log's metadata.
        attachment: Name to content of its attachments.

    Raises:
        LogError: If it cannot be with this MuJoCo, or the model is damaged.
    """
    if header.mujoco_version != mujoco.__version__:
        raise LogError(f"need mujoco=={header.mujoco_version}, this is {mujoco.__version__}")
    return exact_model(header, attachment(MODEL))


def approximate_model(header: Header, mjz: bytes) -> mujoco.MjModel:
    """The model compiled from the scene's XML, which has six digits: for another version.

    Args:
        header: The log's metadata.
        mjz: Its attachment scene.mjz.

    Raises:
        LogError: It cannot be compiled, or a component of its state has another size. What only
            one of the versions has makes no difference to what is read; `check_rows` minds it.
    """
    try:
        model = load_mjz(mjz)
    except ValueError as error:
        raise LogError(f"the attachment scene.mjz cannot be loaded: {error}") from error
    here, there = row_layout(model), header.slices()
    for name in here.keys() & there.keys() & _SHOWN:
        mine, recorded = (s.stop - s.start for s in (here[name], there[name]))
        if mine != recorded:
            raise LogError(f"rows have {recorded} numbers of {name!r}, the model has {mine}")
    return model


def check_rows(header: Header, model: mujoco.MjModel) -> None:
    """Check that a log's rows are those of a model's state, column by column.

    Raises:
        LogError: They are not.
    """
    size = mujoco.mj_stateSize(model, int(mujoco.mjtState.mjSTATE_INTEGRATION))
    if size != header.nstate:
        raise LogError(f"the model has {size} numbers of state, the rows have {header.nstate}")
    here = row_layout(model)
    for name, columns in header.slices().items():
        if name not in here or here[name] != columns:
            there = f"columns {columns.start} to {columns.stop} of rows"
            raise LogError(f"the metadata says that {name!r} is {there}, the model does not")
