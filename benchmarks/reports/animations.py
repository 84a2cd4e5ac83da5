"""What does the animation of each built-in scene cost, how large is it, and what does it look like?

    python -m benchmarks.reports.animations --folder build/animations
    python -m benchmarks.reports.animations --picture docs/images/animation.png

writes a page for each scene, prints the CPU time of making it (the second time, programs at hand) and its size, and, where
Chromium is installed, takes screenshots at 1280 and 390 px and counts console messages. The second draws the picture of
docs/howto/animation.md.
"""

from __future__ import annotations

import shutil
import subprocess
import time
from pathlib import Path

from bcfj_jax.io.scenefile import load
from bcfj_jax.io.view import animation, export, fragment, painter
from bcfj_jax.models.scenes import SCENES
from bcfj_jax.solve.simulation import simulate
from bcfj_jax.xla.compile_cache import open_cache
from benchmarks.common import options

WIDTHS = (1280, 390)
_BROWSER = [
    "--headless",
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--hide-scrollbars",
    "--enable-logging=stderr",
    "--virtual-time-budget=5000",
]


def made(name: str) -> animation.Animation:
    """The animation of a scene with its defaults."""
    given = load(name)
    run = simulate(given.scene, given.params, given.times, accuracy=given.accuracy)
    found = animation.animation(given.scene, given.params, run, f"Simulation of {name}")
    assert found is not None
    begin = time.process_time()
    animation.animation(given.scene, given.params, run)
    middle = time.process_time()
    size = len(fragment.fragment(found).encode())
    end = time.process_time()
    print(
        f"{name:15s} scenery {middle - begin:.3f} s, figure {end - middle:.3f} s CPU, {size / 1e3:.0f} kB", flush=True
    )
    return found


def screenshots(page: Path) -> None:
    """Screenshots beside a page, and the number of its console messages."""
    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if browser is None:
        print("no Chromium: no screenshots")
        return
    for width in WIDTHS:
        shot = page.with_name(f"{page.stem}_{width}.png")
        command = [browser, *_BROWSER, f"--window-size={width},1100", f"--screenshot={shot}", page.resolve().as_uri()]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        said = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
        print(f"  {shot.name}: {len(said)} console messages")


def main() -> None:
    """See the top of the file."""
    given = options(__doc__, folder=Path, picture=Path)
    open_cache()
    if given.picture:
        from PIL import Image

        found = made("joint")
        painter.paint(found, fragment.strongest(found), (900, 560)).quantize(96, dither=Image.Dither.NONE).save(
            given.picture
        )
    for name in SCENES if given.folder else ():
        given.folder.mkdir(parents=True, exist_ok=True)
        page = given.folder / f"{name}.html"
        export.write(made(name), page)
        screenshots(page)


if __name__ == "__main__":
    main()
