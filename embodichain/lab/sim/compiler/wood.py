"""`add_wood`: a seamless wood texture, drawn by filtered noise."""

from __future__ import annotations

import io
from collections.abc import Sequence
from functools import cache

import mujoco
import numpy as np

from embodichain.lab.sim.compiler.index import F64

__all__ = ["WOOD_LENGTH", "add_wood", "wood"]

WOOD_LENGTH = 1.0
"""Lengths of a plank that one image shows along x (and along y)."""
_PIXELS = 512
_PLANKS = 8
"""Planks of one image across y."""
_LEVELS = 24
"""Shades: more are not visible, and cost 3 kB a shade in every log."""


def add_wood(
    spec: mujoco.MjSpec,
    name: str,
    light: Sequence[float],
    dark: Sequence[float],
    *,
    planks: bool,
) -> None:
    """Add a wood texture to a scene.

    Args:
        spec: The scene; the image becomes one of its assets.
        name: The texture's name.
        light: RGB in [0, 1].
        dark: RGB in [0, 1], of the grain.
        planks: Whether it shows planks with joints, or one board.
    """
    file = f"{name}_wood.png"
    spec.assets = {**spec.assets, file: _png(tuple(light), tuple(dark), planks)}
    flat = mujoco.mjtTexture.mjTEXTURE_2D
    spec.add_texture(name=name, type=flat, file=file)


@cache
def _png(light: tuple[float, ...], dark: tuple[float, ...], planks: bool) -> bytes:
    from PIL import Image

    shade = np.round(_LEVELS * wood(planks)[..., None]) / _LEVELS
    rgb = np.asarray(light) * shade + np.asarray(dark) * (1.0 - shade)
    buffer = io.BytesIO()
    image = Image.fromarray(np.clip(255.0 * rgb + 0.5, 0.0, 255.0).astype(np.uint8))
    image.save(buffer, format="PNG")
    return buffer.getvalue()


def wood(planks: bool) -> F64:
    """Return (512, 512) lightness in [0, 1]; the grain runs along x, and opposite edges match."""
    rng = np.random.default_rng(7)
    rows = np.arange(_PIXELS)
    board = rows * _PLANKS // _PIXELS if planks else np.zeros(_PIXELS, np.int64)
    # Growth rings: stripes across the board, bent by slow noise.
    bend = _noise(rng, 150.0, 30.0)
    rings = np.sin(2.0 * np.pi * (rows[:, None] * 24.0 / _PIXELS + 1.6 * bend))
    fibre = _noise(rng, 60.0, 0.7)
    shade = 0.62 + 0.10 * rings + 0.09 * fibre + 0.06 * _noise(rng, 100.0, 15.0)
    if planks:
        # Boards differ in their tint and in the part of the trunk that they show.
        shift = rng.integers(0, _PIXELS, _PLANKS)[board]
        shade = np.take_along_axis(shade, (rows[None, :] + shift[:, None]) % _PIXELS, axis=1)
        ends = rng.integers(0, _PIXELS, _PLANKS)[board]
        tint = rng.uniform(-0.13, 0.13, (_PLANKS, 2))
        half = (rows[None, :] - ends[:, None]) % _PIXELS < _PIXELS // 2
        shade += np.where(half, tint[board, 0][:, None], tint[board, 1][:, None])
        across = rows % (_PIXELS // _PLANKS) < 2
        along = (rows[None, :] - ends[:, None]) % (_PIXELS // 2) < 2
        shade = np.where(across[:, None] | along, 0.35 * shade, shade)
    return np.clip(shade, 0.0, 1.0)


def _noise(rng: np.random.Generator, along: float, across: float) -> F64:
    """(512, 512) periodic Gaussian noise of unit variance, smooth over so many pixels."""
    white = np.fft.rfft2(rng.standard_normal((_PIXELS, _PIXELS)))
    fy, fx = np.fft.fftfreq(_PIXELS)[:, None], np.fft.rfftfreq(_PIXELS)[None, :]
    filtered = np.exp(-2.0 * (np.pi * np.hypot(fx * along, fy * across)) ** 2)
    smooth = np.fft.irfft2(white * filtered, (_PIXELS, _PIXELS))
    unit: F64 = smooth / smooth.std()
    return unit
