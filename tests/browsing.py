"""A page in headless Chromium: what it asks for, what it complains of, and what can be seen on it."""

from __future__ import annotations

import contextlib
import io
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest
from PIL import Image

FLAGS = (
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--disable-default-apps",
    "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
)  # fmt: skip
NAMES = ("chromium", "chromium-browser", "google-chrome")
PATIENCE = 180.0  # [s] software rendering of 130,000 triangles on two busy cores takes seconds a frame
SIZE = {"width": 800, "height": 600}
NOISE = 12  # of 255: what a pixel may differ by in two drawings of the same thing


def chromium() -> str:
    """Where it is. Without it tests are skipped, but not on a build server, where they have to run."""
    found = next(filter(None, map(shutil.which, NAMES)), None)
    if found is None:
        missing = "no Chromium to look with: apt-get install chromium"
        if os.environ.get("CI"):
            pytest.fail(missing)
        pytest.skip(missing)
    return found


@contextlib.contextmanager
def browser() -> Iterator[Any]:
    """A browser with a profile of its own, which is gone afterwards."""
    path = chromium()
    from playwright.sync_api import sync_playwright

    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile, sync_playwright() as driver:
        started = driver.chromium.launch_persistent_context(
            profile, executable_path=path, headless=True, args=list(FLAGS), viewport=SIZE,
            timeout=1000 * PATIENCE,
        )  # fmt: skip
        started.set_default_timeout(1000 * PATIENCE)
        yield started
        started.close()


class Tab:
    """A page that was opened, with a record of its requests and of its errors."""

    def __init__(self, context: Any, url: str):
        self.requests: list[str] = []
        self.errors: list[str] = []
        self.page = context.new_page()
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.on("websocket", lambda opened: self.requests.append(opened.url))
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.on("console", lambda m: self.errors.append(m.text) if m.type == "error" else None)
        self.page.goto(url)

    def foreign(self) -> list[str]:
        """Requests that would leave this computer, or read a file other than the page."""
        own, inside = ("127.0.0.1", "localhost"), ("data", "blob", "about")
        at = self.page.url
        return [
            url for url in self.requests
            if url != at and urlsplit(url).hostname not in own and urlsplit(url).scheme not in inside
        ]  # fmt: skip

    def pixels(self) -> np.ndarray:
        """(height, width, 3) of what is seen."""
        with Image.open(io.BytesIO(self.page.screenshot())) as image:
            return np.asarray(image.convert("RGB"), dtype=int)

    def settled(self) -> np.ndarray:
        """The picture once two in a row are equal."""
        last = self.pixels()
        for _ in self._trying():
            picture = self.pixels()
            if np.array_equal(picture, last):
                return picture
            last = picture
        raise AssertionError("no two equal frames")

    def until(self, holds: Callable[[], bool], what: str) -> None:
        """Wait until ``holds``."""
        for _ in self._trying():
            if holds():
                return
        raise AssertionError(f"never came true: {what}")

    def _trying(self) -> Iterator[None]:
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            yield
            time.sleep(0.1)


class Scene(Tab):
    """A page of MeshCat's viewer; ``frame`` is where the viewer is, if it is not the page itself."""

    def __init__(self, context: Any, url: str):
        super().__init__(context, url)
        self.frame = self.page.main_frame
        self.page.wait_for_function(
            "typeof viewer !== 'undefined' && document.querySelector('canvas') !== null"
        )

    def show(self, path: str, visible: bool) -> None:
        """Show or hide what is at a path of the scene."""
        script = """([path, visible]) => {
            viewer.scene_tree.find(path).object.visible = visible; viewer.set_dirty(); }"""
        self.frame.evaluate(script, [["meshcat", *path.split("/")], visible])

    def seek(self, seconds: float) -> np.ndarray:
        """The picture at a time of the recording, which stands still from then on."""
        self.frame.evaluate("t => { viewer.animator.pause(); viewer.animator.seek(t); }", seconds)
        return self.settled()

    def drawn_by(self, path: str) -> np.ndarray:
        """(n, 3) the pixels that would look different without what is at that path."""
        whole = self.settled()
        self.show(path, False)
        self.until(lambda: not np.array_equal(self.pixels(), whole), f"{path} is seen")
        without = self.settled()
        self.show(path, True)
        self.until(lambda: np.array_equal(self.pixels(), whole), f"{path} is seen again")
        return whole[np.abs(whole - without).max(axis=2) > NOISE]

    def meshes(self, path: str) -> list[str]:
        """Names, in the scene, of the meshes that are visible below a path: joint/shape.part."""
        script = """path => { const found = [];
            viewer.scene_tree.find(path).object.traverseVisible(
                thing => thing.isMesh && found.push(thing.parent.parent.name + "/" + thing.parent.name));
            return found; }"""
        return list(self.frame.evaluate(script, ["meshcat", *path.split("/")]))
