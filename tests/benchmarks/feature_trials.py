"""Trials of the diagnosis on bare discs that carry a small rigid mass beside their axis, so that they are not round.

    .venv/bin/python tests/benchmarks/feature_trials.py make FOLDER [--seed 1] [--trials 12] [--jobs 1]
    .venv/bin/python tests/benchmarks/trials.py run FOLDER --into INTO
    .venv/bin/python tests/benchmarks/feature_trials.py score INTO/COMMIT --truth FOLDER/truth.json

Five of every six discs carry a mass, one carries nothing. Odd trials have the band of the first radial modes, even ones
that of the thickness resonance. The discs, their materials, priors, bench and inhomogeneity are those of the corpus,
with a prior of 2 % for c12. `make` writes trial after trial and goes on where it was stopped.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "benchmarks")]

from concealed.feature_trial import make_feature_trial, mechanisms  # noqa: E402
from concealed.scoring import CLAIMS, DETECTABLE, UNEXPLAINED, cell  # noqa: E402
from trials import make  # noqa: E402

#: A distance from the axis is right within this share.
NEAR = 0.1


@dataclass(frozen=True)
class Judged:
    """The answer to one trial beside its truth. ``parameters`` are those of the mass (SI), none without one;
    ``not_round`` has its distance and its mass if the answer has them."""

    number: str
    detectability: float
    parameters: Mapping[str, float]
    verdict: str
    named: tuple[str, ...]
    not_round: Mapping[str, Any] | None

    @property
    def is_near(self) -> bool:
        """Whether the mass is placed at its distance from the axis."""
        return self.not_round is not None and bool(self.parameters) and (
            abs(self.not_round["distance"] / self.parameters["distance"] - 1.0) <= NEAR)

    @property
    def is_other(self) -> bool:
        """Whether a loss or a density is named, and no mass beside the axis."""
        return self.not_round is None and any("loss" in name or "density" in name for name in self.named)

    def __str__(self) -> str:
        said = self.not_round and "{:.2f} mm {:.2f} mg".format(1e3 * self.not_round["distance"],
                                                               1e6 * self.not_round["mass"])
        there = self.parameters and "{:.2f} mm {:.2f} mg".format(1e3 * self.parameters["distance"],
                                                                 1e6 * self.parameters["mass"])
        return (f"{self.number} {self.detectability:7.1f} concealed {there or 'nothing':17} not round {said or '-':17} "
                f"{self.verdict:18} {' and '.join(self.named)}")


def judged(number: str, truth: Mapping[str, Any], found: Mapping[str, Any]) -> Judged:
    """Compare an answer with the truth."""
    parameters = truth["effects"][0]["parameters"] if truth["effects"] else {}
    return Judged(number, truth["detectability"], parameters, found["verdict"],
                  tuple(e["name"] for e in found["effects"]),
                  next((each for each in found.get("not_round") or () if each["named"] and "mass" in each), None))


def _seen(one: Judged) -> bool:
    return one.detectability > DETECTABLE


#: The rates: a label, of which answers, and which of these count.
RATES: Sequence[tuple[str, Callable[[Judged], bool], Callable[[Judged], bool]]] = (
    ("a mass, detectable: not round", _seen, lambda j: j.not_round is not None),
    ("a mass, detectable: not round, at its distance within 10 %", _seen, lambda j: j.is_near),
    ("a mass, detectable: not round, or unexplained", _seen,
     lambda j: j.not_round is not None or j.verdict == UNEXPLAINED),
    ("a mass, detectable: a loss or a density named instead", _seen, lambda j: j.is_other),
    ("a mass, detectable: any effect named instead", _seen, lambda j: j.not_round is None and j.verdict in CLAIMS),
    ("a mass, not detectable: not round", lambda j: bool(j.parameters) and not _seen(j),
     lambda j: j.not_round is not None),
    ("nothing concealed: not round", lambda j: not j.parameters, lambda j: j.not_round is not None),
    ("nothing concealed: false alarm of any kind", lambda j: not j.parameters,
     lambda j: j.not_round is not None or j.verdict in CLAIMS),
    ("nothing concealed: unexplained", lambda j: not j.parameters, lambda j: j.verdict == UNEXPLAINED),
)


def score(folder: Path, truth: Path) -> None:
    """Print answer after answer and the rates, with counts and 95 % intervals.

    Raises:
        SystemExit: no outcomes.
    """
    known = json.loads(truth.read_text())
    answers = [judged(path.stem, known[path.stem], json.loads(path.read_text()))
               for path in sorted(folder.glob("*.json"))]
    if not answers:
        raise SystemExit(f"{folder}: no outcomes NNNN.json; expected the folder of a commit that `run` has written")
    print(*answers, "", sep="\n")
    for label, of, counts in RATES:
        among = [counts(each) for each in answers if of(each)]
        print(f"{label:60}{cell(sum(among), len(among)):>30}")
    for label, key in (("verdict", lambda j: j.verdict), ("named first", lambda j: next(iter(j.named), "nothing"))):
        print(f"a mass, detectable: {label}: " + "; ".join(
            f"{name} ({count})" for name, count in Counter(key(j) for j in answers if _seen(j)).most_common()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("job", choices=("make", "score"))
    parser.add_argument("path", type=Path, help="folder of trials; for `score` of outcomes")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--trials", type=int, default=12, help="how many to make")
    parser.add_argument("--jobs", type=int, default=1, help="trials at a time")
    parser.add_argument("--truth", type=Path, help="what is concealed, for `score`")
    options = parser.parse_args()
    if options.job == "make":
        make(options.path, 0, options.trials, options.seed, options.jobs, "", mechanisms=mechanisms,
             making=make_feature_trial)
    elif options.truth is None:
        parser.error("score needs --truth")
    else:
        score(options.path, options.truth)


if __name__ == "__main__":
    main()
