"""How fast the live view follows a slider, measured on its page in Chromium, on the filled reference chip.

    .venv/bin/python tests/benchmarks/app.py [--chip FILE] [--vary NAME ...] [--moves 18] [--rest 5] [--json FILE]

Starts ``workbench app``, waits for its models, and presses a key on one slider after the other: resting between, so
that the fields are there and nothing works beside; and then :data:`SOON` after each new spectrum, when fields are being
drawn or models made ready. Prints the milliseconds from the key to the first frame with the new spectrum, to the first
new picture of a field, and the load of the machine, on which all of this depends.
"""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(Path(__file__).resolve().parent)]

from measurements import Measurements, measurements, with_json  # noqa: E402

ARGUMENTS = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
             "--disable-background-networking", "--disable-component-update", "--disable-sync"]
#: Seconds between a spectrum and the next key of a slider that is in use.
SOON = 0.3
#: Presses a key on a slider and answers with the milliseconds to the spectrum, and to a picture if that is waited for.
MOVE = """async ([index, drawn]) => {
  const thumb = document.querySelectorAll('.side [role=slider]')[index];
  thumb.focus();
  return await new Promise(resolve => {
    const begun = performance.now();
    let spectrum = null, picture = null;
    const watch = new MutationObserver(changes => {
      for (const {target} of changes) {
        if (target.id === 'magnitude' && spectrum === null)
          requestAnimationFrame(() => { spectrum ??= performance.now() - begun; });
        if (target.tagName === 'image') picture ??= performance.now() - begun;
      }
    });
    const done = () => {
      if (spectrum === null || (drawn && picture === null)) { requestAnimationFrame(done); return; }
      watch.disconnect();
      resolve([spectrum, picture]);
    };
    done();
    watch.observe(document.body, {subtree: true, attributes: true, attributeFilter: ['d', 'href']});
    thumb.dispatchEvent(new KeyboardEvent('keydown', {key: 'ArrowRight', bubbles: true}));
  });
}"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--chip", type=Path, default=ROOT / "geometry" / "chips" / "reference_chip.toml")
    parser.add_argument("--vary", nargs="+", default=[], metavar="NAME", help="the numbers that have a slider")
    parser.add_argument("--moves", type=int, default=18)
    parser.add_argument("--rest", type=float, default=5.0, help="seconds between moves")
    with_json(parser)
    arguments = parser.parse_args()
    with measurements(arguments.json) as kept:
        measure(arguments, kept)


def measure(arguments: argparse.Namespace, kept: Measurements) -> None:
    from playwright.sync_api import sync_playwright

    found: list[tuple[float, float]] = []
    in_use: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-u", "-m", "workbench", "app", str(arguments.chip), "--no-browser", "-o", folder]
        command += ["--vary", *arguments.vary] if arguments.vary else []
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT) as served:
            assert served.stdout is not None
            address = served.stdout.readline().strip()
            begun = time.perf_counter()
            with sync_playwright() as playwright:
                browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=ARGUMENTS)
                page = browser.new_page(viewport={"width": 1280, "height": 800})
                page.goto(address)
                page.wait_for_selector("#magnitude[d^=M]", timeout=120_000)
                print(f"first spectrum after {time.perf_counter() - begun:.1f} s")
                page.wait_for_function("() => !document.querySelector('#works .v-progress-circular')", timeout=600_000)
                print(f"last model after {time.perf_counter() - begun:.1f} s")
                count = page.locator(".side [role=slider]").count()
                for move in range(arguments.moves):
                    time.sleep(arguments.rest)
                    found.append(tuple(page.evaluate(MOVE, [move % count, True])))
                for move in range(arguments.moves):
                    in_use.append(page.evaluate(MOVE, [move // 3 % count, False])[0])
                    time.sleep(SOON)
                browser.close()
            served.send_signal(signal.SIGINT)
    load = os.getloadavg()[0]
    kept.add("load of the machine", load, "processes")
    print(f"load of the machine: {load:.1f} processes on {os.cpu_count()} processors")
    kept.add("slider in use to spectrum, median", statistics.median(in_use), "ms")
    kept.add("slider in use to spectrum, largest", max(in_use), "ms")
    print(f"spectrum, slider in use: median {statistics.median(in_use):.0f} ms, largest {max(in_use):.0f} ms")
    for name, times in zip(("spectrum", "fields"), zip(*found, strict=True), strict=True):
        kept.add(f"slider to {name}, median", statistics.median(times), "ms")
        kept.add(f"slider to {name}, largest", max(times), "ms")
        print(f"{name}: median {statistics.median(times):.0f} ms, largest {max(times):.0f} ms")


if __name__ == "__main__":
    main()
