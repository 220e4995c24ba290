"""Options of commands that drive a chip: frequency, drive, and heat."""

from __future__ import annotations

import argparse
from collections.abc import Mapping

#: Help of every command with a drive.
DRIVE_HELP = ('"10 Vpp" or "3.5 Vrms" at the electrodes (default), "10 Vpp @ 50 ohm" a generator of that open-circuit '
              'voltage, "20 dBm" one of that power into 50 ohm, "0.1 W" constant input power')

#: Values of the options of :func:`with_warmth` for a command without them.
KEPT_COLD: Mapping[str, object] = {"cold": True, "follow": False, "convection": None, "holder": None}


def with_warmth(sub: argparse.ArgumentParser) -> None:
    """The options of a drive that warms the chip. In commands without them the chip stays cold, by a default of the
    parser, which the options replace."""
    sub.add_argument("--follow", action="store_true", default=False, help="keep the frequency on the peak of the "
                     "energy while the chip warms up (default: fixed)")
    sub.add_argument("--cold", action="store_true", default=False, help="a liquid kept at its stated temperature, "
                     "by a Peltier element or short bursts (default: as warm as the drive makes it)")
    sub.add_argument("--convection", metavar="H",
                     help='heat that leaves the outside, such as "20 W/(m^2 K)" (default 10 W/(m^2 K): still air)')
    sub.add_argument("--holder", metavar="BOUNDARY",
                     help="outer boundary at ambient temperature, such as substrate|outside (default: none)")
