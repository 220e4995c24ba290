"""Straight chips: plates along a channel, in plane strain.

This module reads the keys of straight chips and checks their limits.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

from geometry.dimension import SAME_LENGTH, dimension_text, millimetres
from geometry.limits import NOT_STRAIGHT
from geometry.measure import PER_METRE, Axisymmetric, Measure, Parity, Straight
from geometry.names import TRANSDUCER
from geometry.parts import BETWEEN, SIGNS, TRANSFORMER, TWO_AMPLIFIERS, WIRINGS, Electrodes, Layer, Ports
from workbench.files.errors import InputError, choose
from workbench.files.tables import FileTable

#: Values of the key ``geometry``.
GEOMETRIES = ("axisymmetric", "straight")

#: Largest number of channels side by side.
MOST_CHANNELS = 50

#: Description of ``halves`` in messages.
_HALVES = 'the signs of the left and of the right half, each "+", "-" or "0": ["+", "-"], ["+", "0"]'

#: Suffixes of the keys of round chips, and those of straight chips.
_OF_ROUND = {"radius": "half_width", "diameter": "width"}


def read_measure(head: FileTable) -> Measure:
    """The measure of the table ``[chip]``: keys ``geometry``, ``length``, ``symmetry``.

    Raises:
        InputError: an unknown value, or a key of straight chips in a round one.
    """
    geometry = choose(head.text("geometry", "axisymmetric"), GEOMETRIES, source=head.source, field=head.at("geometry"))
    if geometry == "axisymmetric":
        for key in ("length", "symmetry"):
            if key in head:
                raise head.error(key, f'no {key} in a round chip; a straight one has geometry = "straight"')
        return Axisymmetric()
    length = head.optional_quantity("length", "length")
    if length is not None and not length > 0.0:
        raise head.error("length", "a length above zero: that of the chip into the paper")
    symmetry = choose(head.text("symmetry", "even"), [each.value for each in Parity], source=head.source,
                      field=head.at("symmetry"))
    return Straight(PER_METRE if length is None else length, Parity(symmetry),
                    assumed=tuple(key for key in ("length", "symmetry") if key not in head))


def read_halves(table: FileTable) -> tuple[tuple[str, str] | None, str | None]:
    """The signs of the electrode halves, and their wiring. Both are None if not stated.

    Raises:
        InputError: not two of the known signs, or an unknown wiring.
    """
    halves: tuple[str, str] | None = None
    if "halves" in table:
        given = table.texts("halves", (), expected=_HALVES)
        if len(given) != 2 or not set(given) <= set(SIGNS):
            raise table.error("halves", _HALVES)
        halves = given[0], given[1]
    if "wiring" not in table:
        return halves, None
    return halves, choose(table.text("wiring", ""), WIRINGS, source=table.source, field=table.at("wiring"))


def refuse_round_keys(table: FileTable) -> None:
    """Raise for keys of round chips in a straight one. Unsupported keys of straight chips raise too."""
    for key in table:
        if key.casefold() in NOT_STRAIGHT:
            raise InputError(table.source, table.at(key), table.content[key], NOT_STRAIGHT[key.casefold()])
        for word, instead in _OF_ROUND.items():
            if key.casefold().endswith(word):
                raise InputError(table.source, table.at(key), table.content[key], "no radius or diameter in a straight "
                                 f"chip: {key[:-len(word)]}{instead}, from the middle of the chip"
                                 f"{' to either side' if instead == 'width' else ''}")


def check_straight(
    measure: Measure, layers: Sequence[Layer], electrodes: Electrodes, ports: Ports | None, file: str
) -> None:
    """Check the limits of a straight chip.

    Raises:
        InputError: ports; channels that touch or differ from layer to layer; planes of symmetry that do not bound the
            section, or an offset beside one; a channel outside the middle of a profiled layer; a layer beside the one
            below; a live electrode across a plane of odd symmetry; invalid signs or wiring of its halves.
    """
    if isinstance(measure, Axisymmetric):
        for key, value in (("halves", electrodes.halves), ("wiring", electrodes.wiring)):
            if value is not None:
                raise InputError(file, f"electrodes.{key}", value, f"no {key} in a round chip, whose electrodes are "
                                 "discs and rings")
        return
    if measure.right is not Parity.NONE and measure.left is Parity.NONE:
        raise InputError(file, "chip.symmetry", "a plane at the right end alone",
                         "a plane of symmetry at x = 0, on the left")
    if ports is not None:
        raise InputError(file, "cavity.ports", "ports", "no ports: a channel is straight from end to end")
    for i, layer in enumerate(layers):
        if layer.cavity_radius is not None:
            _check_channels(layer, layers, i, file)
        if layer.profile is not None and abs(layer.cavity_offset - layer.offset) > SAME_LENGTH:
            raise InputError(file, f"layers[{i}].cavity_offset", millimetres(layer.cavity_offset),
                             f"{millimetres(layer.offset)}, the middle of the layer, whose profile is equal to both "
                             "sides")
        for key, offset in (("offset", layer.offset), ("cavity_offset", layer.cavity_offset)):
            if offset and measure.planes:
                raise InputError(file, f"layers[{i}].{key}", millimetres(offset), "no offset in a chip with a "
                                 'plane of symmetry; symmetry = "none" under [chip] meshes both sides')
    for i, (below, layer) in enumerate(itertools.pairwise(layers), 1):
        if min(layer.sides[1], below.sides[1]) < max(layer.sides[0], below.sides[0]) + SAME_LENGTH:
            left, right = map(millimetres, below.sides)
            raise InputError(file, f"layers[{i}].offset", millimetres(layer.offset),
                             f"a layer that lies on {below.region!r}, from {left} to {right}")
    _check_halves(measure, layers, electrodes, file)


def _check_halves(measure: Straight, layers: Sequence[Layer], electrodes: Electrodes, file: str) -> None:
    """Check that electrode halves match split, symmetry and wiring."""
    halves, gap = electrodes.halves, electrodes.live_disc.inner_radius
    if (measure.left is Parity.ODD or halves is not None) and (gap is None or gap.value <= SAME_LENGTH):
        raise InputError(file, "electrodes.live_inner_half_width", None if gap is None else dimension_text(gap),
                         "above zero where symmetry is odd: half of the gap between the electrodes at +V and -V"
                         if halves is None else "above zero: half of the gap between the two halves")
    if halves is not None:
        voltages = SIGNS[halves[0]], SIGNS[halves[1]]
        if voltages == (0.0, 0.0):
            raise InputError(file, "electrodes.halves", list(halves), 'a half at "+" or "-": nothing drives the chip')
        mirrored = {Parity.EVEN: 1.0, Parity.ODD: -1.0}.get(measure.left)
        if mirrored is not None and voltages[0] != mirrored * voltages[1]:
            other = 'symmetry = "odd" or ' if measure.left is Parity.EVEN and voltages[0] == -voltages[1] else ""
            raise InputError(file, "electrodes.halves", list(halves), f"two signs with {measure.left.value} symmetry, "
                             f'or {other}symmetry = "none" under [chip], which meshes both halves')
        if sum(layer.role == TRANSDUCER for layer in layers) > 1:
            raise InputError(file, "electrodes.halves", list(halves), "none in a stack of transducers, whose "
                             "electrodes are wired in parallel")
    if electrodes.wiring is None:
        return
    if not are_opposite(measure, electrodes):
        raise InputError(file, "electrodes.wiring", electrodes.wiring, 'none, or halves = ["+", "-"]: a wiring is that '
                         "of two halves at opposite voltages")
    off = next((layer for layer in layers if layer.offset or layer.cavity_offset), None)
    if electrodes.wiring != TRANSFORMER and off is not None:
        raise InputError(file, "electrodes.wiring", electrodes.wiring, f'"{TRANSFORMER}", which keeps the halves at '
                         f"opposite voltages: {off.region!r} is off the middle, so that the halves draw different "
                         "currents and no other wiring does")


def are_opposite(measure: Measure, electrodes: Electrodes) -> bool:
    """Whether the halves of the live electrode have opposite voltages."""
    if electrodes.halves is None:
        return isinstance(measure, Straight) and measure.left is Parity.ODD
    return set(electrodes.halves) == {"+", "-"}


def check_stated_length(measure: Measure, file: str, subject: str) -> None:
    """Check that a straight chip states its length. The `subject` depends on it.

    Raises:
        InputError: it does not.
    """
    if isinstance(measure, Straight) and "length" in measure.assumed:
        raise InputError(file, "chip.length", None, f'the length of the chip along its channel, such as length = "35 '
                         f'mm": {subject} depends on it')


def straight_findings(measure: Measure, electrodes: Electrodes) -> tuple[str, ...]:
    """Findings on missing keys and the wiring of a straight chip."""
    if isinstance(measure, Axisymmetric):
        return ()
    found = []
    if "symmetry" in measure.assumed:
        found.append('the chip states no symmetry: the field is even, so it has no half-wave modes across the channel; '
                     'symmetry = "odd" under [chip] includes them (a split electrode at +V and -V), and so does "none" '
                     'with halves = ["+", "-"]; "even" confirms the assumption')
    if "length" in measure.assumed:
        found.append("the chip states no length: Z, currents, powers and heat are for 1 m of it; state the length "
                     'under [chip], such as length = "35 mm". E_ac, temperatures and times at a stated voltage do not '
                     "depend on it")
    if electrodes.live_disc.inner_radius is not None and not (
            are_opposite(measure, electrodes) or (electrodes.halves and "0" in electrodes.halves)):
        found.append("both halves of the live electrode have the same voltage, in spite of the gap between them: the "
                     'field is even, without half-wave modes across the channel; symmetry = "odd", or halves = ["+", '
                     '"-"] beside symmetry = "none", drives them')
    if electrodes.wiring == BETWEEN:
        found.append("one amplifier drives the chip between the halves of its electrode: the voltage is that between "
                     "them, with half of it on each against ground, and Z is the impedance between them")
    if electrodes.wiring == TWO_AMPLIFIERS:
        found.append("two amplifiers drive the halves of the electrode, each behind its own resistance: Z is the "
                     "voltage of one over the sum of both currents, and each amplifier sees 2 Z")
    return tuple(found)


def _check_channels(layer: Layer, layers: Sequence[Layer], place: int, file: str) -> None:
    """Check that a layer's channels match the first and do not touch."""
    pitch, first = layer.pitch, next(each for each in layers if each.cavity_radius is not None)
    if (layer.channels > 1) != (pitch > 0.0) or pitch < 0.0:
        raise InputError(file, f"layers[{place}].pitch", millimetres(pitch) if pitch else None,
                         "the distance between the middles of neighbouring channels" if layer.channels > 1 else
                         "none for one channel; channels = 2 or more has one")
    if layer.channels > 1 and pitch < 2.0 * layer.inner_radius + SAME_LENGTH:
        raise InputError(file, f"layers[{place}].pitch", millimetres(pitch), "channels that do not touch: more than "
                         f"their width, {millimetres(2.0 * layer.inner_radius)}")
    if (layer.channels, layer.pitch) != (first.channels, first.pitch):
        raise InputError(file, f"layers[{place}].channels", f"{layer.channels}, {millimetres(pitch)} apart",
                         f"{first.channels}, {millimetres(first.pitch)} apart, as in {first.region!r}")
    if layer.channels > 1 and any(each.profile is not None for each in layers):
        raise InputError(file, f"layers[{place}].channels", layer.channels, "one channel in a chip in which a layer "
                         "has a profile; for several channels, state the draft of their walls")


def head_keys(measure: Measure) -> Mapping[str, str]:
    """The keys of ``[chip]`` for a straight chip, without length. A round chip has none.

    Raises:
        InputError: a section between two planes of symmetry, which no chip file describes.
    """
    if isinstance(measure, Axisymmetric):
        return {}
    if measure.right is not Parity.NONE:
        raise InputError("chip file", "symmetry", f"{measure.left.value}, {measure.right.value}",
                         "one plane of symmetry or none: a chip file has no row of equal chips")
    stated = {} if "symmetry" in measure.assumed else {"symmetry": measure.left.value}
    return {"geometry": "straight", **stated}
