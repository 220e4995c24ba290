"""Meanings of the headings in the reports, one sentence each.

A heading shows its meaning, the legend below its table lists it, and the glossary of the documentation has it too.
"""

from __future__ import annotations

from collections.abc import Iterable

from workbench.results.merit import MEANINGS

DEFINITIONS = {
    **MEANINGS,
    "fitted f": "series resonance of a branch of the circuit that is fitted to all resonances of the band together, "
                "with its standard error. The smallest |Z| lies elsewhere where neighbours move it.",
    "fitted Q": "quality factor of that branch, w L1 / R1.",
    "fitted k_eff": "effective coupling factor of that branch, k^2 = C1 / (Cb + C1). Cb is the capacitance, at its "
                    "frequency, of the circuit without the listed branches: the static one, and that of modes beyond "
                    "the band. The standard error holds how far Cb varies over the band.",
    "M": "figure of merit of that branch, Q k_eff^2 / (1 - k_eff^2): below 10 its dip of |Z| shows neither its "
         "frequency nor its Q, below 2 its reactance never crosses zero.",
    "C0": "clamped capacitance of the electrodes, without any motion. It belongs to the transducer and is the same in "
          "every state. A recording about one resonance does not show it, so recordings have none.",
    "C at 1 kHz": "capacitance far below every mode, as an LCR meter shows it: C0 and the part of all modes.",
    "p0": "largest pressure amplitude in the cavity.",
    "E_ac": "energy density of a plane standing wave of the amplitude p0, p0^2 / (4 rho c^2).",
    "mean E_ac": "the field's own acoustic energy density, averaged over the cavity's volume and over time.",
    "contrast factor": "f1/3 + Re f2/2 of Settnes and Bruus (2012): positive for particles that go to pressure nodes, "
                       "negative for those that go to antinodes; the force grows with it.",
    "largest force": "the largest radiation force on the particle anywhere in the cavity.",
    "net weight": "weight less buoyancy of the particle; negative for one that rises.",
    "barrier": "energy a particle needs to leave its trap for another one or for a wall that it does not lie on, over "
               "the lowest pass, its weight included; 0 where the weight pulls it out of the trap.",
    "axial barrier": "the barrier on the way along z alone; other ways may be lower.",
    "radial barrier": "the barrier on the way along r alone; other ways may be lower.",
    "vertical barrier": "the barrier on the way along z alone; other ways may be lower.",
    "lateral barrier": "the barrier on the way across the channel alone; other ways may be lower.",
    "lift / weight": "largest force against the net weight on the vertical line through the trap, over the net weight: "
                     "below 1 the particle falls (or rises) out of the trap. Empty where a wall carries it.",
    "share": "part of the cavity's volume from which particles come to this trap.",
    "stiffness": "force per displacement about the trap, along r (x in a channel) and along z; of a trap at a wall the "
                 "curvature of the potential there, which may be negative.",
    "focusing time": "time from 90 % to 10 % of a quarter wavelength from the trap, along z (in a channel, along the "
                     "stiffer direction), against drag and weight; empty where a particle that starts there does not "
                     "get to the trap. Across to a line, the way to the side wall counts if it is shorter.",
    "per Vpp^2": "mean E_ac over the square of the voltage at the electrodes, peak to peak, J/(m^3 V^2).",
    "per W": "mean E_ac over the electrical power into the whole length of the chip, J/(m^3 W).",
    "|p| across, mid-height": "largest pressure amplitude on the line across the channel at mid-height.",
    "uneven over the height": "range of the pressure amplitude over the height, where it is largest across, over its "
                              "mean there: 0 for half a wave across between hard walls.",
    "critical diameter": "diameter of a particle that radiation and streaming along plane walls move alike across the "
                         "channel; smaller ones follow the flow.",
    "line across": "place across of a line along the channel that particles focus to, whatever their height.",
    "depth": "energy, averaged over the height, that parts the line from a deeper one or, for the deepest, from the "
             "highest place.",
    "share of the width": "part of the channel's width from which particles come to this line.",
    "MAPE of |Z|": "mean absolute percentage error: the mean over the points of ||Z_sim| - |Z_meas|| / |Z_meas|.",
    "rms of ln(Z_sim / Z_meas)": "root mean square of the complex logarithm: relative error of magnitude and error of "
                                 "phase in radian together.",
    "share of the residual as stated": "part of the residual of the model as stated, beyond noise, that the effect "
                                       "explains: of chi-square, with the distances of known parameters from their "
                                       "stated values.",
    "share of the residual": "part of the square of ln(Z_model / Z_measured), in units of the stated noise, of all "
                             "fitted states.",
    "residual of Z": "root mean square of ln(Z_model / Z_measured), the real and the imaginary part together.",
    "times the noise": "the residual of Z over that of the stated noise alone.",
    "noise floor": "the residual of Z by the stated noise of both parts alone.",
    "odds against nothing further": "posterior odds of this hypothesis beside the finding, against the finding alone.",
    "above the floor": "height above the floor of the cavity; z counts from the bottom of the chip.",
}


def definition(heading: str) -> str | None:
    """The meaning of a heading such as "f0 (MHz)"; None without one."""
    return DEFINITIONS.get(_name(heading))


def defined(headings: Iterable[str]) -> tuple[tuple[str, str], ...]:
    """The defined headings without their units, each once with its meaning."""
    found = {_name(heading): definition(heading) for heading in headings}
    return tuple((name, words) for name, words in found.items() if words is not None)


def _name(heading: str) -> str:
    """A heading without the unit in brackets behind it."""
    return heading if heading in DEFINITIONS else heading.rsplit(" (", 1)[0]
