"""Annotated pictures of reports for the page on reading them: `python docs/report_pictures.py REPORT.html NAME`.

NAME is one of :data:`MARKED`; the picture is written to ``docs/images/report_NAME.png``. It needs Chromium and
playwright, as the tests of the live view do.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

IMAGES = Path(__file__).parent / "images"

#: Width of the page in dots, and its height that is kept, by report.
WIDTH = 1100
HEIGHT = {"simulate": 2500, "compare": 1650, "tolerance": 1700, "study": 1500}

#: What is marked with a number, by report: the n-th element of a CSS selector.
MARKED: dict[str, list[tuple[str, int]]] = {
    "simulate": [("p.answer", 0), ("table", 0), ("dl.legend", 0), ("figure", 0), ("table", 1), ("table", 2),
                 ("figure", 1)],
    "compare": [("table", 0), ("table", 1), ("p", 1), ("figure", 0), ("figure", 1)],
    "tolerance": [("table", 0), ("table", 1), ("figure", 0), ("figure", 1)],
    "study": [("table", 0), ("table", 1), ("table", 2), ("figure", 0)],
}

_BADGE = ("position:absolute; width:30px; height:30px; border-radius:15px; background:#d55e00; color:white; "
          "font:bold 18px/30px sans-serif; text-align:center; z-index:9")


def annotated(report: Path, name: str) -> Path:
    """The top of a report with numbers beside what the page explains."""
    from playwright.sync_api import sync_playwright

    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": WIDTH, "height": 900})
        page.goto(report.resolve().as_uri())
        for number, (selector, index) in enumerate(MARKED[name], 1):
            box = page.locator(selector).nth(index).bounding_box()
            if box is None:
                raise SystemExit(f"{report}: no element {index} of {selector!r}")
            page.evaluate(
                "([text, x, y, style]) => {const b = document.createElement('div'); b.textContent = text; "
                "b.style = style + `; left:${x}px; top:${y}px`; document.body.append(b);}",
                [str(number), max(2.0, box["x"] - 40.0), box["y"] + 2.0, _BADGE])
        path = IMAGES / f"report_{name}.png"
        page.screenshot(path=path, full_page=True,
                        clip={"x": 0, "y": 0, "width": WIDTH, "height": HEIGHT[name]})
        browser.close()
    return path


if __name__ == "__main__":
    sys.stdout.write(f"{annotated(Path(sys.argv[1]), sys.argv[2])}\n")
