"""The operating point that a chip file states: the frequency that the chip is driven at."""

from __future__ import annotations

from workbench.files.errors import InputError, choose, nearest_names
from workbench.files.quantities import parse_quantity
from workbench.files.tables import FileTable

#: The largest peak of the energy in the cavity, and the frequency of the smallest |Z|.
AT_ENERGY, AT_F0 = "energy", "f0"

#: Words for an operating point; a frequency is another.
OPERATING_POINTS = (AT_ENERGY, AT_F0)

#: Description of all of them.
EXPECTED = 'a frequency with its unit, such as "1.5 MHz", "energy" or "f0"'


def check_operating_point(stated: float | str | None, band: tuple[float, float], file: str) -> None:
    """See that a stated frequency (Hz) lies in the `band` of the chip, or that the word for it is known.

    Raises:
        InputError: it does not, or is not.
    """
    field = "chip.operating_point"
    if isinstance(stated, str):
        choose(stated, OPERATING_POINTS, source=file, field=field)
    elif stated is not None and not band[0] <= stated <= band[1]:
        raise InputError(file, field, f"{stated:g} Hz", f"a frequency within the band, {band[0]:g} to {band[1]:g} Hz")


def parse_operating_point(text: str, *, source: str = "command line", field: str = "--at") -> float | str:
    """The frequency (Hz), or the word of :data:`OPERATING_POINTS`, that a text states.

    Raises:
        InputError: neither.
    """
    if text in OPERATING_POINTS:
        return text
    if not text.strip()[:1].isdigit():
        raise InputError(source, field, text, EXPECTED,
                         nearest_names(text.lower(), OPERATING_POINTS))
    return parse_quantity(text, "frequency", source=source, field=field)


def read_operating_point(head: FileTable) -> float | str | None:
    """The key ``operating_point`` of a chip: a frequency in Hz, a word of :data:`OPERATING_POINTS`, None if absent.

    Raises:
        InputError: neither a frequency with its unit nor such a word.
    """
    if "operating_point" not in head:
        return None
    text = head.content["operating_point"]
    if not isinstance(text, str):
        raise head.error("operating_point", EXPECTED)
    return parse_operating_point(text, source=head.source, field=head.at("operating_point"))
