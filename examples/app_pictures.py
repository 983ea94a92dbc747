"""The pictures of docs/app.md: ``python -m examples.app_pictures`` takes them again, with Chromium and chromedriver."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from PIL import Image
from tests.app_driver import Page, browser, missing_browser
from tests.app_process import running_app

FIGURES = Path(__file__).resolve().parents[1] / "docs" / "figures"

# Width of a screen and of a telephone [pixels of the page], and pixels of a picture for one of these.
WIDE, NARROW, FINE = 1280, 390, 2


def take(page: Page, name: str, width: int, title: str = "", height: int | None = None) -> None:
    """Write a picture of the page, or of a part of this height [pixels] below a heading."""
    path = FIGURES / f"app_{name}.png"
    page.screenshot(path, width, FINE)
    top = FINE * (page.top_of(title) - 20) if title else 0
    with Image.open(path) as whole:
        last = min(top + FINE * height, whole.height) if height else whole.height
        part = whole.crop((0, top, whole.width, last)).convert("P", palette=Image.Palette.ADAPTIVE, colors=128)
    part.save(path, optimize=True)


def main() -> int:
    """Exit code: 0 done, 2 there is no browser."""
    if missing_browser():
        print(missing_browser(), file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with running_app(cwd=folder) as (_, address), browser(folder) as driver:
            page = Page(driver, address)
            page.press("Open an example")
            page.wait(lambda: "What each channel is" in page.text, "the example")
            take(page, "file", WIDE)
            page.press("Discover")
            page.result(1)
            page.wait(lambda: page.drawn(1), "the pictures of the report")
            take(page, "result", WIDE, "Result", 1500)
            take(page, "telephone", NARROW, "Result", 1300)
    return 0


if __name__ == "__main__":
    sys.exit(main())
