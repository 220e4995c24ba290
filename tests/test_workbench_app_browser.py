"""The live view in a real browser: sliders, the click in the spectrum, saving, reloading, and nothing from outside."""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import live_chip
import pytest

from geometry.chip import read_chip
from workbench.results.spectrum import write_spectrum
from workbench.simulation.run import simulate

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
QUIET = ("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
         "--disable-background-networking", "--disable-component-update", "--disable-sync")
ROOT = Path(__file__).resolve().parent.parent

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed (apt-get install chromium)"),
    pytest.mark.skipif(importlib.util.find_spec("playwright") is None, reason="playwright is not installed"),
]

#: Milliseconds that anything may take here before a test fails: many times what it takes.
PATIENCE = 60_000
THICKNESS = 0


@dataclass
class Live:
    """``workbench app`` on its page, with all that the page asked for."""

    page: Any
    address: str
    folder: Path
    chip: Path
    asked: list[str] = field(default_factory=list)
    complaints: list[str] = field(default_factory=list)

    def value(self, selector: str) -> str:
        return str(self.page.locator(selector).inner_text()).strip()

    def curve(self) -> str:
        return str(self.page.get_attribute("#magnitude", "d"))

    def picture(self, name: str) -> str:
        return str(self.page.get_attribute(f"#picture_{name} image", "href"))

    def until(self, condition: str, argument: object = None) -> None:
        self.page.wait_for_function(condition, arg=argument, timeout=PATIENCE)

    def nudge(self, index: int, key: str, times: int = 1) -> None:
        """Press a key on the thumb of a slider, and wait for the new spectrum."""
        # What was moved before is on its way no longer.
        before = self.rested()
        thumb = self.page.locator(".side .row").nth(index).locator("[role=slider]")
        for _ in range(times):
            thumb.press(key)
        self.until("before => document.querySelector('#magnitude').getAttribute('d') !== before", before)
        self.rested()

    def rested(self) -> str:
        """The spectrum once nothing moves any more: twice the same, some answers apart."""
        last, now = "", self.curve()
        while last != now:
            time.sleep(0.4)
            last, now = now, self.curve()
        return now


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Live]:
    from playwright.sync_api import sync_playwright

    folder = tmp_path_factory.mktemp("live")
    chip = folder / "little.toml"
    chip.write_text(live_chip.TEXT)
    recorded = simulate(read_chip(chip).with_dimensions({"substrate.thickness": 0.805e-3}), points=101,
                        accuracy=0.01)
    write_spectrum(recorded.spectrum, folder / "recorded.csv")
    command = [sys.executable, "-m", "workbench", "app", str(chip), "--recording", str(folder / "recorded.csv"),
               "--vary", *live_chip.WANTED, "--accuracy", "1 %", "--no-browser", "-o", str(folder / "out")]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONUNBUFFERED": "1"}
    with (folder / "errors.txt").open("w") as errors, subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=errors, text=True, cwd=folder, env=environment) as served, (
            sync_playwright()) as playwright:
        assert served.stdout is not None
        address = served.stdout.readline().strip()
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=list(QUIET))
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        found = Live(page, address, folder / "out", chip)
        page.on("request", lambda request: found.asked.append(request.url))
        page.on("console", lambda message: found.complaints.append(message.text) if message.type == "error" else None)
        page.on("websocket", lambda socket: found.asked.append(socket.url))
        page.goto(address)
        page.wait_for_selector("#picture_potential image", timeout=PATIENCE)
        found.until("() => document.querySelector('#works').innerText.includes('model ready')")
        yield found
        browser.close()
        served.send_signal(signal.SIGINT)
        assert served.wait(30) == 0
    assert "Traceback" not in (folder / "errors.txt").read_text()


def test_three_sliders_move_spectrum_figures_and_fields(live: Live) -> None:
    for index in range(3):
        resonance, displacement = live.value("#f0"), live.picture("displacement")
        live.nudge(index, "ArrowRight", 5)
        live.until("([id, before]) => document.querySelector(id).getAttribute('href') !== before",
                   ["#picture_displacement image", displacement])
        if index != 1:
            assert live.value("#f0") != resonance
    assert float(live.page.input_value("#number_0")) == pytest.approx(0.801, rel=1e-6)


def test_a_click_in_the_spectrum_shows_the_fields_there(live: Live) -> None:
    before = live.picture("pressure")
    box = live.page.locator("#spectrum").bounding_box()
    # In the middle of the panel, whose sides are 60 and 908 of 920 units, is the middle of the band.
    live.page.mouse.click(box["x"] + box["width"] * 484.0 / 920.0, box["y"] + 0.3 * box["height"])
    live.until("before => document.querySelector('#picture_pressure image').getAttribute('href') !== before", before)
    live.until("() => document.querySelector('#fields_at').innerText.startsWith('1.000')")
    shown = re.match(r"([\d.]+) MHz", live.value("#fields_at"))
    assert shown is not None
    # A pixel is 0.2 kHz wide.
    assert float(shown[1]) == pytest.approx(1.0, abs=3e-4)
    live.page.click("#follow")
    # Both are rounded to 100 Hz.
    live.until("f0 => Math.abs(parseFloat(document.querySelector('#fields_at').innerText) - parseFloat(f0)) < 6e-5",
               live.value("#peak"))


def test_what_the_mouse_points_at_is_told(live: Live) -> None:
    box = live.page.locator("#spectrum").bounding_box()
    live.page.mouse.move(box["x"] + box["width"] * 484.0 / 920.0, box["y"] + 0.3 * box["height"])
    live.until("() => document.querySelector('#pointed').innerText.startsWith('1.0000 MHz: ')")


def test_undo_and_redo(live: Live) -> None:
    live.page.click("#reset")
    live.until("() => document.querySelector('#number_0').value === '0.8'")
    live.nudge(THICKNESS, "ArrowRight", 3)
    moved = live.page.input_value("#number_0")
    assert moved != "0.8"
    # It rests after half a second.
    time.sleep(1.0)
    live.page.click("#undo")
    live.until("() => document.querySelector('#number_0').value === '0.8'")
    live.page.click("#redo")
    live.until("moved => document.querySelector('#number_0').value === moved", moved)


def test_what_is_saved_is_what_a_reload_shows(live: Live) -> None:
    live.nudge(THICKNESS, "ArrowLeft", 7)
    number, resonance = float(live.page.input_value("#number_0")), live.value("#f0")
    live.page.fill("#file", "kept.toml")
    live.page.click("#save")
    live.until("() => document.querySelector('#message')?.innerText.includes('saved as')")
    saved = read_chip(live.folder / "kept.toml")
    assert saved.dimensions()["substrate.thickness"].value == pytest.approx(1e-3 * number, rel=1e-6)
    live.page.reload()
    live.page.wait_for_selector("#picture_potential image", timeout=PATIENCE)
    live.until("f0 => document.querySelector('#f0').innerText === f0", resonance)
    assert float(live.page.input_value("#number_0")) == number


def test_freed_numbers_are_fitted_to_the_recording(live: Live) -> None:
    live.page.click("#reset")
    live.until("() => document.querySelector('#number_0').value === '0.8'")
    assert live.page.locator("#recorded").count() == 1
    live.page.check("#free_0")
    live.page.click("#fit")
    live.until("() => document.querySelector('#works').innerText.includes('% now')")
    # Recorded on a mesh made for the length, fitted with one stretched to it, both within 1 % of Z: 3e-4 of the length.
    assert float(live.page.input_value("#number_0")) == pytest.approx(0.805, rel=3e-4)
    live.page.uncheck("#free_0")


def test_full_solves_are_laid_over(live: Live) -> None:
    live.page.click("#full")
    live.until("() => document.querySelector('#works').innerText.includes('% at most, ')")
    assert live.page.locator("#spectrum circle").count() == 2 * 41


def test_a_tolerance_draws_a_band(live: Live) -> None:
    for index in range(3):
        live.page.fill(f"#tolerance_{index}", "0")
        live.page.locator(f"#tolerance_{index}").press("Enter")
    live.until("() => document.querySelector('#f0 + .note').innerText === '' || "
               "!document.querySelector('#f0 + .note').innerText.includes('tolerances')")
    live.page.fill("#tolerance_0", "0.05")
    live.page.locator("#tolerance_0").press("Enter")
    live.until("() => document.querySelector('#f0 + .note').innerText.includes('by the tolerances')")
    assert live.page.locator("#tolerance").count() == 1


def test_outside_the_ranges_the_model_grows(live: Live) -> None:
    live.page.fill("#number_0", "0.83")
    live.page.locator("#number_0").press("Enter")
    live.until("() => document.querySelector('#works').innerText.includes('wider')")
    before = live.curve()
    live.until("before => document.querySelector('#magnitude').getAttribute('d') !== before", before)
    live.page.click("#undo")
    # What the next test finds in the field is what it was before.
    live.until("() => document.querySelector('#number_0').value !== '0.83'")


def test_a_decimal_comma_is_answered_with_a_point(live: Live) -> None:
    before = live.page.input_value("#number_0")
    live.page.fill("#number_0", "0,805")
    live.page.locator("#number_0").press("Enter")
    live.until("() => document.querySelector('#message')?.innerText.includes('not a comma: 0.805?')")
    live.until("before => document.querySelector('#number_0').value === before", before)


def test_what_is_assumed_is_marked(live: Live) -> None:
    # The file states the substrate's tolerance and none of the cavity's radius; an emptied field goes back to that.
    live.page.fill("#tolerance_0", "")
    live.page.locator("#tolerance_0").press("Enter")
    live.until("() => document.querySelector('#tolerance_0').value === '0.02'")
    assert "assumed" not in str(live.page.get_attribute("#tolerance_0", "class"))
    live.page.fill("#tolerance_1", "")
    live.page.locator("#tolerance_1").press("Enter")
    live.until("() => document.querySelector('#tolerance_1').classList.contains('assumed')")
    assert live.page.input_value("#tolerance_1") == "0.05"
    assert "a printed length is known to 50 um" in str(live.page.get_attribute("#tolerance_1", "title"))


@pytest.mark.parametrize("width", [1280, 1000, 700])
def test_no_page_is_cut_and_letters_can_be_read(live: Live, width: int) -> None:
    live.page.set_viewport_size({"width": width, "height": 800})
    try:
        assert live.page.evaluate("() => document.documentElement.scrollWidth") <= width
        ends = "() => Math.max(...Array.from(document.querySelectorAll('.live button, .live svg, .live .card'))" \
               ".map(each => each.getBoundingClientRect().right))"
        assert live.page.evaluate(ends) <= width
        heights = live.page.evaluate("() => Array.from(document.querySelectorAll('.fields text.tick'))"
                                     ".map(each => each.getBoundingClientRect().height)")
        # The box of letters is a fifth higher than their size: 9 px at least.
        assert min(heights) > 10.5
    finally:
        live.page.set_viewport_size({"width": 1280, "height": 800})


def test_nothing_comes_from_outside(live: Live) -> None:
    # After all that the tests above did.
    asked = [url for url in live.asked if not url.startswith("data:")]
    assert any("/ws" in url for url in asked)
    assert any(url.endswith(".woff2?v=7.4.47") or ".woff2" in url for url in asked)
    assert {re.sub(r":\d+/.*", "", url) for url in asked} == {"http://127.0.0.1", "ws://127.0.0.1"}
    assert live.complaints == []
