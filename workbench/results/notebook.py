"""Views of a result, for a notebook and for a prompt."""

from __future__ import annotations

import base64
import html
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from workbench.results.brief import Brief, lines_of

if TYPE_CHECKING:
    from workbench.render.plots import SpectrumLike


@dataclass(frozen=True, eq=False)
class Summary:
    """A result in short: title, rows of a table, spectra by label. Spectra in ``measured`` are drawn as dots."""

    title: str
    rows: tuple[tuple[str, ...], ...]
    spectra: Mapping[str, SpectrumLike] = field(default_factory=dict)
    measured: tuple[str, ...] = ()


class Shown(Brief):
    """Base of a result that notebook and prompt show by :meth:`summary`. Its dataclass has ``repr=False``."""

    def summary(self) -> Summary:
        """The result in short."""
        raise NotImplementedError

    def __repr__(self) -> str:
        summary = self.summary()
        return lines_of([summary.title, *(_line(row) for row in summary.rows)])

    def _repr_html_(self) -> str:
        return page(self.summary())


def _line(row: tuple[str, ...]) -> str:
    first, *rest = row
    return "  " + (f"{first}: " if first else "") + ", ".join(cell for cell in rest if cell)


def page(summary: Summary) -> str:
    """HTML of a summary with its figure."""
    rows = "".join("<tr>" + "".join(f"<td style='text-align:left'>{html.escape(cell)}</td>" for cell in row) + "</tr>"
                   for row in summary.rows)
    parts = [f"<b>{html.escape(summary.title)}</b><table>{rows}</table>"]
    if summary.spectra:
        from workbench.render.plots import draw_spectra

        with tempfile.TemporaryDirectory() as folder:
            picture = draw_spectra(summary.spectra, Path(folder) / "spectra.png", measured=summary.measured)
            data = base64.b64encode(picture.read_bytes()).decode("ascii")
        parts.append(f"<img style='max-width:40em' src='data:image/png;base64,{data}' alt='impedance spectra'>")
    return "".join(parts)
