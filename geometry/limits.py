"""Limits of the model, as texts for messages and documentation."""

from __future__ import annotations

from collections.abc import Mapping

AXISYMMETRIC = "axisymmetric only: every layer is a disc or a ring about one axis"

#: Remedy for a part that is not round.
NOT_ROUND = (f"{AXISYMMETRIC}; for a rectangular plate, state a disc of its thickness and area, radius = "
             "sqrt(width length / pi): it has the thickness resonances of the plate and not the lateral ones; for a "
             "plate with a channel along it, state the cross-section, geometry = \"straight\" under [chip]")

CENTRED = (f"{AXISYMMETRIC}; state a part beside the axis on the axis, or as a ring of its area at its "
           "distance")

#: Remedy for a transducer with a hole in a chip with profiles.
FULL_DISC = ("with an outline, a transducer is a full disc; for a ring, state radius and inner_radius without a "
             "profile")

#: Remedy for a second cavity, below the first or above it.
FURTHER_CAVITY = ("if there are two cavities, the one with the particles is the cavity; the layers around the "
                  'other one have inner_{across} and filling = "water"')

CLOSED = ('for an open well or channel, state open = true, or the depth of its liquid as fill = "2 mm", under [cavity]')

#: Remedy for parts of a straight chip that are off its middle.
OFF_THE_MIDDLE = ('offset = "0.5 mm" of a layer, cavity_offset of a channel, in a chip with symmetry = "none": the '
                  "distance of its middle to the right of the middle of the chip")

#: Remedy for several channels in a straight chip.
ONE_CHANNEL = ('channels = 3 and pitch = "1 mm" of the layer around them for equal channels side by side; for '
               "other channels, model the one with the particles, and state the walls around the others as solid")

#: Remedy for channel walls that are not upright.
ETCHED = ('draft = "35.26 deg" of the layer around the channel, the angle by which it grows wider upwards; for rounded '
          "walls a profile, points with fillets and arcs")

#: Keys for the liquid depth of a partly filled cavity, which a state does not have.
FILL_KEYS = ("fill", "fill_height", "filling", "level", "liquid_height", "height")

#: Keys for parts that are not round, and the remedy for each.
NOT_KEYS: Mapping[str, str] = {
    **dict.fromkeys(("width", "length", "side", "depth", "breadth", "lx", "ly", "x_length", "y_length", "size"),
                    NOT_ROUND),
    **dict.fromkeys(("offset", "centre", "center", "x", "y", "position", "eccentricity", "x_offset", "y_offset"),
                    CENTRED),
}

#: Keys that a straight chip does not have, and the remedy for each.
NOT_STRAIGHT: Mapping[str, str] = {
    **dict.fromkeys(("centre", "center", "x", "position", "x_offset", "left", "right", "side"), OFF_THE_MIDDLE),
    **dict.fromkeys(("cavities", "channel_count", "count", "spacing", "cavity_widths"), ONE_CHANNEL),
    **dict.fromkeys(("undercut", "taper", "slope", "etch_angle", "wall_angle", "sidewall_angle", "fillet",
                     "corner_radius"), ETCHED),
}
