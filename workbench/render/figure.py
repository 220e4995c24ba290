"""A figure whose texts are no formulas. It imports matplotlib, which takes a second: import it inside functions."""

from __future__ import annotations

from matplotlib.axis import Ticker
from matplotlib.backend_bases import RendererBase
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import LogFormatter, ScalarFormatter

from workbench.files.names import visible


class TextFigure(Figure):
    """A figure that prints the names of chips, states and recordings as they stand, not as formulas between ``$``."""

    def draw(self, renderer: RendererBase) -> None:
        self._read_literally()
        super().draw(renderer)

    def tight_layout(
        self, *, pad: float = 1.08, h_pad: float | None = None, w_pad: float | None = None,
        rect: tuple[float, float, float, float] | None = None,
    ) -> None:
        self._read_literally()
        super().tight_layout(pad=pad, h_pad=h_pad, w_pad=w_pad, rect=rect)

    def _read_literally(self) -> None:
        for text in self.findobj(Text):
            assert isinstance(text, Text)
            text.set_parse_math(False)
            # Half characters, of the name of a file in another encoding, cannot be drawn.
            text.set_text(visible(text.get_text(), keep="\n"))
        # A logarithmic axis writes its powers of ten as formulas; no name is among the numbers of an axis.
        for axes in self.axes:
            for axis in (axes.xaxis, axes.yaxis):
                numbers = [*axis.get_majorticklabels(), axis.offsetText] if _writes_numbers(axis.major) else []
                numbers += axis.get_minorticklabels() if _writes_numbers(axis.minor) else []
                for label in numbers:
                    label.set_parse_math(True)


def _writes_numbers(ticker: Ticker) -> bool:
    return isinstance(ticker.formatter, ScalarFormatter | LogFormatter)
