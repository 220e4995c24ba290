"""The refusal of straight chips by what is made for round ones so far."""

from __future__ import annotations

from geometry.chip import Chip
from geometry.measure import Axisymmetric
from workbench.files.errors import InputError


def check_axisymmetric(chip: Chip, what: str) -> None:
    """Check that a chip is round, for what straight chips cannot have yet; `what` names it in the message.

    Raises:
        InputError: the chip is straight.
    """
    if not isinstance(chip.measure, Axisymmetric):
        raise InputError(chip.file, "chip.geometry", "straight", f'"axisymmetric" for {what}, which is not there for '
                         "straight chips yet; their impedance, fields, studies, designs, fits and diagnoses are")
