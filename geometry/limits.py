"""Limits of the model, in the words of messages and of the documentation."""

from __future__ import annotations

from collections.abc import Mapping

AXISYMMETRIC = "axisymmetric only: every layer is a disc or a ring about one axis"

#: Advice for a body that is not round.
NOT_ROUND = (f"{AXISYMMETRIC}; in place of a rectangular plate state a disc of its thickness and area, radius = "
             "sqrt(width length / pi), which has its thickness resonances and not its lateral ones; of plates with a "
             "channel along them state the cross-section, geometry = \"straight\" under [chip]")

CENTRED = (f"{AXISYMMETRIC}; in place of a part beside the axis state it on the axis, or as a ring of its area "
           "at its distance")

#: Transducers of a chip with profiles.
FULL_DISC = ("with an outline a transducer is a full disc; of a ring state radius and inner_radius, without a profile")

ONE_CAVITY = (f"{AXISYMMETRIC}, with one cavity; of two cavities model the one with the particles, and state "
              "the layer around the other one as solid")

CLOSED = ('of an open well state open = true, or the depth of its liquid as fill = "2 mm", under [cavity]')

#: Keys that people write in a state for a cavity that is not filled to its top.
FILL_KEYS = ("fill", "fill_height", "filling", "level", "liquid_height", "height")

#: Keys that people write for things that are not round, and the advice for each.
NOT_KEYS: Mapping[str, str] = {
    **dict.fromkeys(("width", "length", "side", "depth", "breadth", "lx", "ly", "x_length", "y_length", "size"),
                    NOT_ROUND),
    **dict.fromkeys(("offset", "centre", "center", "x", "y", "position", "eccentricity", "x_offset", "y_offset"),
                    CENTRED),
}
