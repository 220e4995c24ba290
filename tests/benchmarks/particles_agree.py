"""Whether `simulate` and `particles` say the same of a chip, a bead and a drive: place, share and times.

    .venv/bin/python tests/benchmarks/particles_agree.py [--accuracy 5e-3] [--count 400] [--only TEXT] [--kept FILE]

Twelve pairs of chip, bead and drive: round, straight, an open well; above and below the critical size. For each the
statement of `simulate` (200 beads, large steps) stands beside that of `workbench particles` (other start points,
default steps, 30 min). A pair agrees if both name the same places for shares above 10 %, if these shares are within
20 %, or 5 % of all, and times within 20 %. Results are kept in a file as they come; a pair that is there is not run
again.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
import tomllib
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(Path(__file__).resolve().parent)]

from geometry.chip import Chip, parse_chip, read_chip  # noqa: E402
from workbench.model.drive import parse_drive  # noqa: E402
from workbench.simulation.beads import trajectories, with_particle  # noqa: E402
from workbench.simulation.gathering import Gathering, gathering, statement  # noqa: E402
from workbench.simulation.liquid_motion import liquid_motion  # noqa: E402
from workbench.simulation.run import snapshot  # noqa: E402

CHIPS = ROOT / "geometry" / "chips"
#: The small chip without its lid: an open well.
WELL = "well"
#: Chip, frequency (Hz), drive, and diameter of the bead (m).
PAIRS = (
    ("acevedo_2026_chip.toml", 1.03048e6, "1.447 Vpp", 10e-6),
    ("acevedo_2026_chip.toml", 1.03048e6, "2 Vpp", 10e-6),
    ("acevedo_2026_chip.toml", 1.03048e6, "1.447 Vpp", 20e-6),
    ("acevedo_2026_chip.toml", 1.03048e6, "1.447 Vpp", 1e-6),
    ("../../examples/small_study/chip.toml", 1.0465e6, "5 Vpp", 10e-6),
    ("../../examples/small_study/chip.toml", 1.0465e6, "5 Vpp", 0.5e-6),
    (WELL, 1.0e6, "5 Vpp", 10e-6),
    (WELL, 1.0e6, "5 Vpp", 0.5e-6),
    ("silicon_glass_channel.toml", 1.94e6, "1 Vpp", 5e-6),
    ("silicon_glass_channel.toml", 1.94e6, "1 Vpp", 1e-6),
    ("glass_channel.toml", 1.892e6, "1 Vpp", 3e-6),
    ("polymer_channel.toml", 1.228e6, "2 Vpp", 5e-6),
)
#: Relative difference of shares and of times up to which they agree, difference of shares that draws have, and shares
#: that count.
WITHIN, DRAWS, COUNTS = 0.2, 0.05, 0.1


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--accuracy", type=float, default=5e-3)
    parser.add_argument("--count", type=int, default=400)
    parser.add_argument("--only", default="", help="pairs whose name holds this")
    parser.add_argument("--kept", type=Path, default=ROOT / "out" / "particles_agree.json")
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    arguments.kept.parent.mkdir(parents=True, exist_ok=True)
    kept: dict[str, Any] = json.loads(arguments.kept.read_text()) if arguments.kept.exists() else {}
    for pair in PAIRS:
        name = f"{Path(pair[0]).parent.name}/{Path(pair[0]).name} {pair[2]} {1e6 * pair[3]:g} um"
        if arguments.only not in name:
            continue
        if name not in kept:
            kept[name] = compared(*pair, accuracy=arguments.accuracy, count=arguments.count)
            arguments.kept.write_text(json.dumps(kept, indent=1))
        row = kept[name]
        print(f"{'agree ' if not row['apart'] else 'DIFFER'} {name}: simulate {row['seconds'][0]:.2f} s, "
              f"particles {row['seconds'][1]:.2f} s of processor\n       {row['simulate']}\n       {row['particles']}",
              flush=True)
        for words in row["apart"]:
            print(f"       {words}")
    chosen = [row for name, row in kept.items() if arguments.only in name]
    print(f"{sum(not row['apart'] for row in chosen)} of {len(chosen)} pairs agree")


def compared(
    file: str, frequency: float, drive: str, diameter: float, *, accuracy: float, count: int
) -> dict[str, Any]:
    """Both statements on one pair, and where they differ."""
    chip = with_particle(well() if file == WELL else read_chip(CHIPS / file), None, particle="polystyrene",
                         radius=0.5 * diameter)
    shot = snapshot(chip, None, frequency, drive=parse_drive(drive), accuracy=accuracy)
    begun = time.process_time()
    simulated = gathering(shot)
    between = time.process_time()
    moving = liquid_motion(shot)
    assert simulated is not None
    assert shot.traps is not None
    try:
        found = trajectories(shot, 1800.0, particles=count, seed=7, flow=moving.velocity)
        followed = statement(shot.state, found.report, moving, found)
    except ArithmeticError as error:
        # Beads that circulate take many steps in half an hour: the statement needs no trajectory.
        followed = replace(statement(shot.state, shot.traps, moving, None), first=None)
        print(f"       not followed to the end: {error}")
    return {"seconds": [between - begun, time.process_time() - between], "simulate": words_of(simulated),
            "particles": words_of(followed), "apart": apart(simulated, followed)}


def well() -> Chip:
    """The small chip of the examples with an open cavity."""
    content = tomllib.loads((CHIPS / "../../examples/small_study/chip.toml").read_text())
    content["layers"] = [layer for layer in content["layers"] if layer["role"] != "superstrate"]
    return parse_chip({**content, "cavity": {"open": True}}, source="well.toml")


def words_of(found: Gathering) -> str:
    if not found.places:
        return " ".join(found.sentences)
    return "; ".join(map(str, filter(None, (found.first, *found.places))))


def apart(one: Gathering, other: Gathering) -> list[str]:
    """Sentences on differences of two statements."""
    circulate = ["circulate with the streaming" in str(each) for each in (one, other)]
    if all(circulate):
        return [] if one.critical_diameters == other.critical_diameters else ["critical diameters differ"]
    if any(circulate) or one.gathers != other.gathers:
        return [f"gathers: {one.gathers} and {other.gathers}, circulate: {circulate}"]
    found = []
    places = {place.words.split(" mm above")[0]: place for place in other.places}
    assert one.first is not None
    assert other.first is not None
    rows = [(one.first, other.first), *((place, places.get(place.words.split(" mm above")[0])) for place in one.places)]
    for mine, theirs in rows:
        if mine.share < COUNTS:
            continue
        if theirs is None:
            found.append(f"{mine.words}: {mine.share:.2f}, and nowhere in the other")
            continue
        if abs(mine.share - theirs.share) > max(WITHIN * theirs.share, DRAWS):
            found.append(f"share {mine.words}: {mine.share:.2f} and {theirs.share:.2f}")
        if mine.half and theirs.half and abs(mine.half / theirs.half - 1.0) > WITHIN:
            found.append(f"half of those {mine.words}: {mine.half:.3g} and {theirs.half:.3g} s")
    return found


if __name__ == "__main__":
    main()
