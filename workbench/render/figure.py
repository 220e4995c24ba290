"""A figure that does not read texts as formulas."""

from __future__ import annotations

from typing import TYPE_CHECKING

from workbench.files.names import visible

if TYPE_CHECKING:
    from matplotlib.axis import Ticker
    from matplotlib.backend_bases import RendererBase
    from matplotlib.figure import Figure


def text_figure(width: float, height: float) -> Figure:
    """A figure (inches) that prints every name literally. A name between two ``$`` is not a formula."""
    from matplotlib.figure import Figure

    class LiteralFigure(Figure):
        def draw(self, renderer: RendererBase) -> None:
            _read_literally(self)
            super().draw(renderer)

        def tight_layout(
            self, *, pad: float = 1.08, h_pad: float | None = None, w_pad: float | None = None,
            rect: tuple[float, float, float, float] | None = None,
        ) -> None:
            _read_literally(self)
            super().tight_layout(pad=pad, h_pad=h_pad, w_pad=w_pad, rect=rect)

    return LiteralFigure(figsize=(width, height))


def _read_literally(figure: Figure) -> None:
    from matplotlib.text import Text

    for text in figure.findobj(Text):
        assert isinstance(text, Text)
        text.set_parse_math(False)
        # Lone surrogates, of the name of a file in another encoding, cannot be drawn.
        text.set_text(visible(text.get_text(), keep="\n"))
    # A logarithmic axis writes its powers of ten as formulas; the numbers of an axis contain no names.
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            numbers = [*axis.get_majorticklabels(), axis.offsetText] if _writes_numbers(axis.major) else []
            numbers += axis.get_minorticklabels() if _writes_numbers(axis.minor) else []
            for label in numbers:
                label.set_parse_math(True)


def _writes_numbers(ticker: Ticker) -> bool:
    from matplotlib.ticker import LogFormatter, ScalarFormatter

    return isinstance(ticker.formatter, ScalarFormatter | LogFormatter)
