"""Makes the pictures of README.md, the site and examples/README.md again, from what the examples leave.

    python docs/render.py                  # all of them (some minutes)
    python docs/render.py panda own_law    # these examples' alone

A thumbnail is the arm on its way, as Chromium draws the example's animation, or a figure of an example
that has none. The examples panda and paper make the README's pictures as well.
"""

from __future__ import annotations

import argparse
import io
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from playwright.sync_api import sync_playwright

import eladapt as ea
from eladapt.files import atomic_write

DOCS = Path(__file__).resolve().parent
EXAMPLES = DOCS.parent / "examples"
THUMBNAILS = DOCS / "thumbnails"
SMALL, MOST_BYTES = (320, 240), 60_000
FRAME = 0.05  # [s] of the moving picture
FLAGS = ["--no-sandbox", "--disable-quic", "--disable-background-networking", "--disable-component-update",
         "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]  # fmt: skip
# When the motion looks best [s], and which file shows it where that has another name.
MOMENT = {"panda": 0.45, "panda_payload": 5.5, "two_link": 0.5, "ur5_waypoints": 2.25,
          "kinova_continuous": 0.4, "talos_armature": 0.4, "own_urdf": 0.1, "own_law": 0.5}  # fmt: skip
PLOTS = {
    "paper": "paper_case1_motion.png", "hardware_loop": "hardware_loop.png",
    "identify_panda": "identify_panda.png", "identify_log": "identify_log_motion.png", "ur": "ur.png",
}  # no animation  # fmt: skip
UNSEEN = ("franka",)  # it needs a robot
SHOWS = {"own_urdf": "own_two_link"}
ARGUMENTS = {"own_urdf": [str(DOCS.parent / "robots" / "two_link.urdf")]}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    names = sorted(path.stem for path in EXAMPLES.glob("*.py") if path.stem not in UNSEEN)
    parser.add_argument("examples", nargs="*", choices=[*names, []], metavar="EXAMPLE", help=", ".join(names))
    parser.add_argument("--out", metavar="FOLDER", help="keep the files; what is there is not run again")
    options = parser.parse_args()
    wanted = options.examples or names
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.out or temporary
        out = Path(folder)
        for name in wanted:
            if any((out / f"{SHOWS.get(name, name)}.{kind}").exists() for kind in ("html", "md", "npz")):
                continue
            print(f"{name} ...", flush=True)
            command = [sys.executable, str(EXAMPLES / f"{name}.py"), *ARGUMENTS.get(name, [])]
            environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
            command += ["--out", folder]
            subprocess.run(command, check=True, env=environment, stdout=subprocess.DEVNULL)
        with chromium() as browser:
            for name in wanted:
                if name in PLOTS:
                    picture = Image.open(out / PLOTS[name]).convert("RGB")
                else:
                    animation = out / f"{SHOWS.get(name, name)}.html"
                    picture = scene(browser, animation, MOMENT[name], (640, 480), legend=False)
                save(thumbnail(picture), THUMBNAILS / f"{name}.png")
            if "panda" in wanted:
                readme(browser, out)
        if "paper" in wanted:
            with atomic_write(DOCS / "paper_case1.png") as whole:
                shutil.copyfile(out / "paper_case1_motion.png", whole)


def readme(browser: Any, out: Path) -> None:
    """The pictures of README and site: the run's curves, a moment of it, its motion, its report."""
    with atomic_write(DOCS / "panda.png") as temporary:
        shutil.copyfile(out / "panda.png", temporary)
    save(scene(browser, out / "panda.html", MOMENT["panda"], (1000, 620)), DOCS / "panda_view.png")
    shots = moving(browser, out / "panda.html", np.arange(0, 1.8, FRAME), (480, 320))
    with atomic_write(DOCS / "pictures" / "panda.webp") as temporary:
        lasting = [round(1000 * FRAME)] * (len(shots) - 1) + [1500]  # [ms] it rests at its set-point
        shots[0].save(
            temporary, save_all=True, append_images=shots[1:], duration=lasting, loop=0, quality=60, method=6
        )
    page = ea.report(ea.Record.load(out / "panda.npz"), out / "report.html", animation=False)
    save(look(browser, page, (1280, 860)), DOCS / "report.png")


@contextmanager
def chromium() -> Iterator[Any]:
    """A headless browser that draws without a graphics card."""
    found = shutil.which("chromium") or sys.exit("error: no chromium; apt-get install chromium")
    with sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=found, args=FLAGS, timeout=180_000)
        yield opened
        opened.close()


def scene(browser: Any, page: Path, moment: float, size: tuple[int, int], legend: bool = True) -> Image.Image:
    """The animation as it is at a moment [s]."""
    hidden = ".dg" if legend else ".dg, #legend"
    prepare = f"""(() => {{ viewer.animator.pause(); viewer.animator.seek({moment});
        document.querySelectorAll("{hidden}").forEach(part => part.style.display = "none"); }})()"""
    return look(browser, page, size, prepare)


def look(browser: Any, page: Path, size: tuple[int, int], prepare: str = "") -> Image.Image:
    """A page once it has come to rest."""
    opened = browser.new_page(viewport={"width": size[0], "height": size[1]})
    opened.set_default_timeout(180_000)
    opened.goto(page.resolve().as_uri())
    time.sleep(2)
    if prepare:
        opened.evaluate(prepare)
    last = np.zeros(0)
    for _ in range(100):
        time.sleep(0.3)
        picture = Image.open(io.BytesIO(opened.screenshot())).convert("RGB")
        if np.array_equal(np.asarray(picture), last):
            opened.close()
            return picture
        last = np.asarray(picture)
    sys.exit(f"error: {page.name} does not come to rest")


def moving(browser: Any, page: Path, moments: np.ndarray, size: tuple[int, int]) -> list[Image.Image]:
    """The animation at each of these moments [s]."""
    opened = browser.new_page(viewport={"width": size[0], "height": size[1]})
    opened.set_default_timeout(180_000)
    opened.goto(page.resolve().as_uri())
    time.sleep(4)
    opened.evaluate("""(() => { viewer.animator.pause();
        document.querySelectorAll(".dg, #legend").forEach(part => part.style.display = "none"); })()""")
    shots = []
    for moment in moments:
        opened.evaluate(f"viewer.animator.seek({moment})")
        time.sleep(0.4)
        shots.append(Image.open(io.BytesIO(opened.screenshot())).convert("RGB"))
    opened.close()
    return shots


def thumbnail(picture: Image.Image) -> Image.Image:
    """Small, on white where it is not as wide as it is high."""
    reduced = picture.copy()
    reduced.thumbnail(SMALL, Image.Resampling.LANCZOS)
    sheet = Image.new("RGB", SMALL, "white")
    sheet.paste(reduced, ((SMALL[0] - reduced.width) // 2, (SMALL[1] - reduced.height) // 2))
    return sheet


def save(picture: Image.Image, path: Path) -> None:
    with atomic_write(path) as temporary:
        picture.save(temporary, optimize=True)
    size = path.stat().st_size
    if path.parent == THUMBNAILS and size > MOST_BYTES:
        sys.exit(f"error: {path.name} takes {size} bytes, more than {MOST_BYTES}")
    print(f"wrote {path.relative_to(DOCS.parent)}, {size // 1000} kB")


if __name__ == "__main__":
    main()
