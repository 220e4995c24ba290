"""What a diagnosis says of stated effects that another code conceals in a random device, and how long it takes.

    .venv/bin/python tests/benchmarks/cases.py [CASE ...] [--seed 7] [--jobs 1] [--folder FOLDER] [--json FILE]

In one process (`--jobs 1`) the shares of processor time are printed: factorisations; the solves that each serves, with
the products and orthogonalisations between; projections on a basis; and predictions of the reduced models.

Each case is a campaign of three states of 321 points and one that is held out, as of `trials.py`; a seed is one device,
whatever is concealed in it (7: of 0.5 % noise). FOLDER keeps the campaigns of one seed; without it they are made each
time.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from functools import partial, wraps
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "benchmarks")]

from concealed.design import Design  # noqa: E402
from concealed.device import Values  # noqa: E402
from concealed.mechanisms import Draw, Effect, conceal  # noqa: E402
from concealed.trial import make_trial  # noqa: E402
from factorisation import seconds_of_one  # noqa: E402
from measurements import measurements, with_json  # noqa: E402

from workbench.campaign.campaign import read_campaign  # noqa: E402
from workbench.diagnosis.appraisal import diagnose  # noqa: E402
from workbench.fem.operators import FullOperators  # noqa: E402
from workbench.fem.solve import System  # noqa: E402
from workbench.fitting.objective import Objective  # noqa: E402

#: A glue of 8 um, of K 0.4 GPa and G 0.02 GPa.
GLUE, BULK, SHEAR = 8e-6, 0.4e9, 0.02e9


def _bench(name: str, size: float, rng: np.random.Generator, design: Design, truth: Values) -> Effect:
    """A bench element of that `size` (SI)."""
    key = f"bench.{name}"
    return Effect(f"bench {name}", "bench", "bench", {key: size}, values={key: size})


def _dome(height: float, rng: np.random.Generator, design: Design, truth: Values) -> Effect:
    """A transducer that is so much (m) thicker in the middle than at its rim."""
    return conceal("dome of the transducer", "transducer", "geometry", {"transducer.dome": height})


def _bond(rng: np.random.Generator, design: Design, truth: Values) -> Effect:
    return conceal("imperfect bond", "bond", "stiffness", {
        "bond.normal_stiffness": (BULK + 4.0 / 3.0 * SHEAR) / GLUE, "bond.tangential_stiffness": SHEAR / GLUE,
        "bond.loss_factor": 0.05, "bond.below": 0.0})


def _gel(begins: float, rng: np.random.Generator, design: Design, truth: Values) -> Effect:
    """Gel that is missing beyond a share of its radius."""
    radius = truth["couplant.radius"]
    return conceal("partial coverage", "couplant", "geometry",
                   {"coverage.inner": begins * radius, "coverage.outer": radius})


#: What is concealed in each case.
CASES: Mapping[str, Mapping[str, Draw]] = {
    "nothing": {},
    "resistance and inductance of leads, 0.15 ohm and 60 nH": {
        "resistance": partial(_bench, "series_resistance", 0.15),
        "inductance": partial(_bench, "series_inductance", 60e-9)},
    "transducer 6 um thicker at its rim": {"dome": partial(_dome, -6e-6)},
    "transducer 12 um thicker at its rim": {"dome": partial(_dome, -12e-6)},
    "transducer 6 um thicker at its rim, without its free disc": {"dome": partial(_dome, -6e-6)},
    "transducer 12 um thicker at its rim, without its free disc": {"dome": partial(_dome, -12e-6)},
    "weak bond, 8 um of K 0.4 GPa and G 0.02 GPa": {"bond": _bond},
    "gel missing beyond 84 % of its radius": {"gel": partial(_gel, 0.84)},
}

#: The methods that the shares of processor time are of; one that another calls counts as the other's.
TIMED = {"factorisations": (System, "factored"), "solves": (System, "neighbours"),
         "projections": (FullOperators, "project"), "predictions": (Objective, "predict")}

#: Cases whose campaigns lack the state of the free disc.
WITHOUT_DISC = "without its free disc"


def campaign_of(case: str, seed: int, folder: Path) -> tuple[Path, str]:
    """The campaign file of a case, made in `folder` if it is not there, and what is concealed, in words."""
    if not folder.exists():
        unfinished = folder.with_suffix(".making")
        shutil.rmtree(unfinished, ignore_errors=True)
        draws = CASES[case]
        truth = make_trial(seed, tuple(draws) or "none", unfinished / "trial", draws=draws, at_two_drives=0.0)
        if case.endswith(WITHOUT_DISC):
            _leave_out_disc(unfinished / "trial" / "campaign.toml")
        told = "; ".join(map(_told, truth.effects)) or "nothing"
        (unfinished / "truth.txt").write_text(
            f"{told}; {truth.detectability:.1f} sigmas with the disc, noise {truth.noise:.2%}, inhomogeneity "
            f"{truth.inhomogeneity:.2%}\n", encoding="utf-8")
        unfinished.rename(folder)
    return folder / "trial" / "campaign.toml", (folder / "truth.txt").read_text(encoding="utf-8").strip()


def _leave_out_disc(path: Path) -> None:
    """Take the tables of the state of the free disc out of a campaign file."""
    tables = path.read_text(encoding="utf-8").split("\n[")
    path.write_text("\n[".join(each for each in tables if not each.startswith("states.disc")), encoding="utf-8")


@contextmanager
def shares() -> Iterator[dict[str, float]]:
    """Processor time (s) of each kind of work of :data:`TIMED` within the block, without that of the others in it."""
    spent, open_ones = dict.fromkeys(TIMED, 0.0), list[list[float]]()

    def timed(name: str, method: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(method)
        def wrapped(*arguments: Any, **options: Any) -> Any:
            begun, inner = time.process_time(), [0.0]
            open_ones.append(inner)
            try:
                return method(*arguments, **options)
            finally:
                open_ones.pop()
                whole = time.process_time() - begun
                spent[name] += whole - inner[0]
                if open_ones:
                    open_ones[-1][0] += whole
        return wrapped

    with ExitStack() as stack:
        for name, (owner, method) in TIMED.items():
            stack.enter_context(patch.object(owner, method, timed(name, getattr(owner, method))))
        yield spent


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="*", default=list(CASES), help="beginnings of: " + "; ".join(CASES))
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--folder", type=Path)
    with_json(parser)
    options = parser.parse_args()
    chosen = [case for case in CASES if any(case.startswith(each) for each in options.cases)]
    if not chosen:
        parser.error(f"no case begins so; there are: {'; '.join(CASES)}")
    unit = seconds_of_one()
    print(f"one factorisation: {unit:.3f} s")
    with measurements(options.json) as kept, ExitStack() as stack:
        folder = options.folder or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        folder.mkdir(parents=True, exist_ok=True)
        for case in chosen:
            path, told = campaign_of(case, options.seed, folder / case.replace(" ", "_"))
            campaign = read_campaign(path)
            spent, begun = time.process_time(), time.perf_counter()
            with shares() as parts:
                found = diagnose(campaign, jobs=options.jobs)
            spent, begun = time.process_time() - spent, time.perf_counter() - begun
            print(f"{case}: {begun:.0f} s of wall time, {spent:.0f} s of processor time in this process, "
                  f"{spent / unit:.0f} factorisations\n    {found.verdict}: {found.headline}")
            for each in (one for established in found.established for one in established.estimates):
                print(f"    {each.name} {each.value:.4g}, {each.low:.4g} to {each.high:.4g}")
            if options.jobs == 1:
                print("    " + ", ".join(f"{name} {each / spent:.0%}" for name, each in parts.items()))
            print(f"    concealed: {told}", flush=True)
            kept.add(case, begun, "s")


def _told(effect: Effect) -> str:
    return f"{effect.name}, " + ", ".join(f"{name} {size:.4g}" for name, size in effect.parameters.items())


if __name__ == "__main__":
    main()
