"""Limits of the model, in the words of messages and of the documentation."""

from __future__ import annotations

from collections.abc import Mapping

from geometry.dimension import SHAPES

AXISYMMETRIC = "axisymmetric only: every layer is a disc or a ring about one axis"

#: Advice for a body that is not round.
NOT_ROUND = (f"{AXISYMMETRIC}; in place of a rectangular plate state a disc of its thickness and area, radius = "
             "sqrt(width length / pi), which has its thickness resonances and not its lateral ones; of plates with a "
             "channel along them state the cross-section, geometry = \"straight\" under [chip]")

CENTRED = (f"{AXISYMMETRIC}; in place of a part beside the axis state it on the axis, or as a ring of its area "
           "at its distance")

#: Advice for transducers other than one full disc.
ONE_DISC = ("one transducer that is a full disc; rings, tubes and several transducers are not modelled yet: in place "
            "of a ring state a disc of its thickness and area, radius = sqrt(R^2 - r^2), which has its thickness "
            "resonance and not its radial ones; of several transducers state the one that is driven")

ONE_CAVITY = (f"{AXISYMMETRIC}, with one closed cavity; of two cavities model the one with the particles, and state "
              "the layer around the other one as solid")

CLOSED = (f"{AXISYMMETRIC}, with one closed cavity; in place of a free surface (an open well) state a superstrate so "
          "thin that it hardly weighs, such as 10 um of a polymer, and the depth of the fluid as height of the wall")

STRAIGHT = "what is symmetric about the middle of the chip, x = 0, with one closed channel there"

#: Advice for what a straight chip has off its middle.
IN_THE_MIDDLE = (f"{STRAIGHT}; a plate, a layer or a channel off to one side is not modelled yet: state it in the "
                 "middle, which leaves out what its place alone drives (half a wave across the channel under a full "
                 "electrode); symmetry = \"odd\" with a gap in the live electrode drives that too")

ONE_CHANNEL = (f"{STRAIGHT}; of several channels model the one with the particles, and state the walls around the "
               "others as solid")

CLOSED_CHANNEL = (f"{STRAIGHT}; in place of an open channel state a superstrate so thin that it hardly weighs, such as "
                  "10 um of a polymer, and the depth of the fluid as height of the wall")

UPRIGHT = ("layers with plane faces and upright sides: etch profiles, sloping and rounded walls of a straight chip are "
           "not modelled yet; state the width at half the height of the channel")

#: Keys that people write for a cavity that is not filled to its top.
FILL_KEYS = ("fill", "fill_height", "filling", "level", "liquid_height", "height")

#: Keys that people write for things that are not round, and the advice for each.
NOT_KEYS: Mapping[str, str] = {
    **dict.fromkeys(("width", "length", "side", "depth", "breadth", "lx", "ly", "x_length", "y_length", "size"),
                    NOT_ROUND),
    **dict.fromkeys(("offset", "centre", "center", "x", "y", "position", "eccentricity", "x_offset", "y_offset"),
                    CENTRED),
}

#: Keys that people write in a straight chip for what it cannot have yet, and the advice for each.
NOT_STRAIGHT: Mapping[str, str] = {
    **dict.fromkeys(("offset", "centre", "center", "x", "position", "x_offset", "left", "right", "side"),
                    IN_THE_MIDDLE),
    **dict.fromkeys(("channels", "cavities", "channel_count", "count", "pitch", "spacing", "cavity_widths"),
                    ONE_CHANNEL),
    **dict.fromkeys(("undercut", "taper", "slope", "etch_angle", "wall_angle", "sidewall_angle", "fillet",
                     "corner_radius", "profile", *SHAPES), UPRIGHT),
}
