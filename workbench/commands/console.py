"""The console for errors, findings and progress."""

from __future__ import annotations

from typing import TYPE_CHECKING

from workbench.files.names import visible

if TYPE_CHECKING:
    from rich.console import Console, HighlighterType, JustifyMethod, OverflowMethod
    from rich.style import Style
    from rich.text import Text

#: Control characters for the layout of text.
KEPT = "\n\t"


def error_console() -> Console:
    """A console on standard error that prints texts literally. It has no markup and no emoji, and control characters
    are escapes."""
    from rich.console import Console

    class LiteralConsole(Console):
        def render_str(
            self, text: str, *, style: str | Style = "", justify: JustifyMethod | None = None,
            overflow: OverflowMethod | None = None, emoji: bool | None = None, markup: bool | None = None,
            highlight: bool | None = None, highlighter: HighlighterType | None = None,
        ) -> Text:
            return super().render_str(
                visible(text, keep=KEPT), style=style, justify=justify, overflow=overflow, emoji=emoji, markup=markup,
                highlight=highlight, highlighter=highlighter)

    return LiteralConsole(stderr=True, soft_wrap=True, highlight=False, markup=False, emoji=False)
