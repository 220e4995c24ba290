"""The operating point of a chip file: the drive frequency."""

from __future__ import annotations

from workbench.files.errors import InputError, choose, nearest_names
from workbench.files.quantities import frequency_text, in_another_unit, parse_quantity
from workbench.files.tables import FileTable

#: Words for the frequency of the largest acoustic energy in the cavity, and of the smallest |Z|.
AT_ENERGY, AT_F0 = "energy", "f0"

#: All words for an operating point; otherwise it is a frequency.
OPERATING_POINTS = (AT_ENERGY, AT_F0)

#: Description of all of them.
EXPECTED = 'a frequency with its unit, such as "1.5 MHz", "energy" or "f0"'


def check_operating_point(stated: float | str | None, band: tuple[float, float], file: str) -> None:
    """Check that a stated frequency (Hz) or word is valid.

    Raises:
        InputError: otherwise.
    """
    field = "chip.operating_point"
    if isinstance(stated, str):
        choose(stated, OPERATING_POINTS, source=file, field=field)
    elif stated is not None and not band[0] <= stated <= band[1]:
        raise InputError(file, field, frequency_text(stated), f"a frequency within the band, {frequency_text(*band)}",
                         in_another_unit(band, stated))


def parse_operating_point(text: str, *, source: str = "command line", field: str = "--at") -> float | str:
    """The frequency (Hz), or the word of :data:`OPERATING_POINTS`, in a text.

    Raises:
        InputError: the text is neither.
    """
    if text in OPERATING_POINTS:
        return text
    if not text.strip()[:1].isdigit():
        raise InputError(source, field, text, EXPECTED,
                         nearest_names(text.lower(), OPERATING_POINTS))
    return parse_quantity(text, "frequency", source=source, field=field)


def read_operating_point(head: FileTable) -> float | str | None:
    """The chip file's ``operating_point``: a frequency (Hz), word, or None.

    Raises:
        InputError: neither a frequency with its unit nor a word of :data:`OPERATING_POINTS`.
    """
    if "operating_point" not in head:
        return None
    text = head.content["operating_point"]
    if not isinstance(text, str):
        raise head.error("operating_point", EXPECTED)
    return parse_operating_point(text, source=head.source, field=head.at("operating_point"))
