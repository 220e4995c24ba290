"""Answers of the session in the form of the page.

They are texts, lines and places.
"""

from __future__ import annotations

import base64
from collections.abc import Iterator
from typing import Any, Protocol

import numpy as np

from workbench.app import plot
from workbench.app.section_fields import SectionFields
from workbench.app.spectrum_view import SpectrumView

#: Prefixes of units and the factors to the unit with it, smallest unit first.
_PREFIXES = (("µ", 1e6), ("m", 1e3), ("", 1.0), ("k", 1e-3), ("M", 1e-6))
#: Largest heights (pixels of the page) of a wide picture and of one of half the width, the size of the letters at its
#: axis, and the height of their strip below the picture.
TALLEST, LETTERS, STRIP = (196.0, 118.0), 11.0, 17.0


class DrawnField(Protocol):
    """A picture of a field, see `workbench.render.live.LivePicture`."""

    @property
    def name(self) -> str: ...
    @property
    def title(self) -> str: ...
    @property
    def png(self) -> bytes: ...
    @property
    def window(self) -> tuple[float, float, float, float]: ...
    @property
    def low(self) -> float: ...
    @property
    def high(self) -> float: ...
    @property
    def unit(self) -> str: ...
    @property
    def colours(self) -> str: ...
    @property
    def outline(self) -> tuple[tuple[float, float, float, float], ...]: ...
    @property
    def marks(self) -> tuple[tuple[float, float, str], ...]: ...
    @property
    def tall(self) -> float: ...


def curve(view: SpectrumView, scale: plot.PlotScale) -> dict[str, Any]:
    """The spectrum as lines, with grid, tolerance band and readout."""
    spectrum = view.spectrum
    tolerance = "" if view.spread is None else plot.tolerance_band(scale, spectrum, view.spread)
    return {**plot.curves(scale, spectrum), "tolerance": tolerance, "ticks": plot.ticks(scale),
            "read": plot.readout(spectrum)}


def figure_cards(view: SpectrumView) -> list[dict[str, str]]:
    """The figures of merit with their uncertainties."""
    measured = {row.metric: row for row in view.comparison.rows} if view.comparison is not None else {}

    def card(name: str, metric: str, words: str, unit: str, digits: str, factor: float = 1.0,
             si_unit: str = "") -> dict[str, str]:
        deviation = view.deviations.get(name)
        notes = [] if deviation is None else [f"± {_with_unit(deviation, si_unit)} by the tolerances"]
        row = measured.get(metric)
        if row is not None:
            notes.append(f"recorded {row.measured * factor:.5g} {unit}".rstrip())
        return {"id": name, "name": words, "value": f"{view.figures[name] * factor:{digits}} {unit}",
                "note": ", ".join(notes)}

    found: list[dict[str, str]] = []
    if view.no_resonance:
        found.append({"id": "f0", "name": "resonance", "value": "none", "note": view.no_resonance})
    else:
        found += [card("f0", "f0", "resonance f0", "MHz", ".5f", 1e-6, "Hz"),
                  card("z_min", "Z_min", "smallest |Z|", "Ω", ".4g", si_unit="Ω"),
                  card("q", "Q", "quality factor Q", "", ".4g")]
    if view.peak is not None:
        found.append({"id": "peak", "name": "energy peak", "value": f"{1e-6 * view.peak.frequency:.4f} MHz",
                      "note": view.peak.words})
    if view.comparison is not None:
        found.append({"id": "mape", "name": "off the recording", "value": f"{view.comparison.mape_percent:.3g} %",
                      "note": "mean of |Z|"})
    checked = "not checked yet" if not np.isfinite(view.error) else f"{100.0 * view.error:.2g} % where checked last"
    found.append({"id": "model_error", "name": "model's error, estimated bound",
                  "value": f"≤ {100.0 * view.estimate:.2g} %", "note": checked})
    return found


def _with_unit(number: float, unit: str) -> str:
    """A deviation with its prefixed unit. One to three digits are before the point."""
    if not unit or not np.isfinite(number) or number == 0.0:
        return f"{number:.2g} {unit}".rstrip()
    prefix, factor = next(((name, size) for name, size in _PREFIXES if number < 999.5 / size), _PREFIXES[-1])
    return f"{float(f'{number * factor:.2g}'):g} {prefix}{unit}"


def described(section: SectionFields, *, stated: bool) -> str:
    """Description of the fields: frequency, drive and results. `stated` is whether the chip names the particle."""
    fields = section.fields
    words = f"{fields.frequency / 1e6:.4f} MHz, {fields.drive}, {1e3 * fields.power:.3g} mW"
    if section.traps is None:
        return words
    there = section.traps.excitation
    words += f" · p0 {there.pressure_amplitude / 1e3:.4g} kPa · E_ac {there.energy_density:.3g} J/m³"
    if section.traps.traps:
        trap = section.traps.traps[0]
        words += f" · deepest trap {fields.mesh.measure.symbol} {1e3 * trap.radius:.2f}, z {1e3 * trap.height:.3f} mm"
    return words if stated else f"{words} · for the default particle, since the chip names none"


def embedded(png: bytes) -> str:
    """A picture as a data URL."""
    return "data:image/png;base64," + base64.b64encode(png).decode()


def picture(drawn: DrawnField) -> dict[str, Any]:
    """A picture in the form of the page. Its box is as wide as the picture has dots."""
    left, right, bottom, top = drawn.window
    width = plot.WIDTH if drawn.tall == 1.0 else 0.5 * plot.WIDTH
    dots = width / (right - left)
    height = dots * drawn.tall * (top - bottom)

    def x(r: float) -> float:
        return round((r - left) * dots, 1)

    def y(z: float) -> float:
        return round((top - z) * dots * drawn.tall, 1)

    # Letters keep their size if the picture is shown smaller than its box.
    wide = drawn.tall == 1.0
    tallest = TALLEST[0 if wide else 1]
    shrunk = max(1.0, height / (tallest - STRIP))
    step = next((each for each in (0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0) if dots * each >= 3.5 * LETTERS * shrunk), 50.0)
    count = int(right / step)
    ticks = [{"at": x(k * step), "text": f"{abs(k * step):g}" + (" mm" if k == 0 else ""), "anchor": "middle"}
             for k in range(-count, count + 1)]
    return {"name": drawn.name, "title": drawn.title, "png": embedded(drawn.png), "wide": wide,
            "letters": round(LETTERS * shrunk, 1), "strip": round(STRIP * shrunk, 1), "tallest": f"{tallest:g}px",
            "width": width, "height": round(height, 1), "low": f"{drawn.low:.3g}", "high": f"{drawn.high:.3g}",
            "unit": drawn.unit, "colours": drawn.colours, "ticks": ticks,
            "note": "" if drawn.tall == 1.0 else f"heights × {drawn.tall:g}",
            "outline": "".join(f"M{x(a)} {y(b)}L{x(c)} {y(d)}" for a, b, c, d in drawn.outline),
            "marks": [{"x": x(r), "y": y(z), "text": text} for r, z, text in drawn.marks]}


def next_picture(drawing: Iterator[DrawnField]) -> dict[str, Any] | None:
    """The next picture in the form of the page, or None."""
    drawn = next(drawing, None)
    return None if drawn is None else picture(drawn)
