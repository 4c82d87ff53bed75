"""Headless Chromium, driven over DevTools with Playwright; WebGL is drawn in software."""

import io
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

CHROMIUM = shutil.which("chromium")

needs_chromium = pytest.mark.skipif(
    CHROMIUM is None, reason="no chromium: apt-get install chromium (scripts/system_deps.sh does)"
)

_FLAGS = [
    # WebGL without a graphics card
    *("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
    # root in a container, and no connection but to the page
    *("--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking"),
    *("--disable-component-update", "--disable-sync"),
]


@contextmanager
def chromium(watch: Callable[[Any], object] | None = None) -> Iterator[Callable[..., Any]]:
    """A function that opens an address in a new browser of some size; the end closes them all.

    Args:
        watch: Called with each page before it is opened, to add handlers of events.
    """
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:

        def visit(url: str, width: int, height: int) -> Any:
            browser = playwright.chromium.launch(executable_path=CHROMIUM, args=_FLAGS)
            # Half as many pixels each way: they are drawn by the processor.
            size = {"width": width, "height": height}
            page = browser.new_page(viewport=size, device_scale_factor=0.5)
            if watch is not None:
                watch(page)
            page.goto(url)
            return page

        yield visit


def picture(page: Any) -> NDArray[np.uint8]:
    """A screenshot, (height, width, 3)."""
    shot = page.screenshot(timeout=60_000)
    return np.asarray(Image.open(io.BytesIO(shot)).convert("RGB"))


def share_of(image: NDArray[np.uint8], color: tuple[float, float, float]) -> float:
    """How much of a picture has a colour, however bright it is lit; color: RGB from 0 to 1."""
    pixels = image.reshape(-1, 3).astype(float)
    length = np.linalg.norm(pixels, axis=1)
    alike = pixels @ np.array(color) / np.linalg.norm(color) / np.maximum(length, 1.0)
    return float(((alike > 0.992) & (length > 60)).mean())
