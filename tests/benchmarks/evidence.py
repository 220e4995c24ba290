"""Laplace's evidence beside importance sampling on a full campaign, and beside nested sampling on a free disc.

    .venv/bin/python tests/benchmarks/evidence.py chip [--draws 400] [--repeats 4] [--json FILE]
    .venv/bin/python tests/benchmarks/evidence.py disc [--live 200]

*chip*: a disc and a chip whose cavity is 4 % higher than stated, recorded by their own model with noise (the campaign
of `tests/test_workbench_diagnosis_named.py`), and their diagnosis. *disc*: one disc of two uncertain constants, with
one effect at a time (the campaign of `tests/test_workbench_diagnosis_posterior.py`).

*Importance sampling* draws from Student's distribution of :data:`FREEDOM` degrees of freedom with mean and covariance
(as its scale) of Laplace's approximation, in `--repeats` independent repetitions. *Effective* is the share of the draws
that (sum w)^2 / sum w^2 counts for, the least of all repetitions; the error is the standard deviation of the mean of
the repetitions. Nested sampling is dynesty's, with the error that it states. Times are of one run on one core.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp
from scipy.stats import multivariate_t
from threadpoolctl import threadpool_limits

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests"), str(ROOT / "tests" / "benchmarks")]

from measurements import Measurements, measurements, with_json  # noqa: E402
from test_workbench_diagnosis_named import concealed  # noqa: E402
from test_workbench_diagnosis_posterior import nested, recorded, settled  # noqa: E402

from workbench.diagnosis.appraisal import diagnose  # noqa: E402
from workbench.diagnosis.posterior import Posterior  # noqa: E402

#: Degrees of freedom of what is drawn from: tails wide enough for a posterior that is not normal. More, and single
#: draws in these tails may count for all others.
FREEDOM = 5.0

#: What is concealed in the disc, one at a time; 0.6 ohm of contacts is six standard deviations.
EFFECTS = {
    "resistance of leads and contacts": {"bench.series_resistance": 0.6},
    "load on the face of the transducer": {"backing.normal_impedance": 4e3},
    "electrode that ends before the rim": {"bare rim.width": 0.01},
}


def importance(posterior: Posterior, draws: int, seed: int, freedom: float = FREEDOM) -> tuple[float, float]:
    """ln of the evidence, and the share of the draws that are effective."""
    _, mean, covariance = posterior.laplace()
    scale = 1.0 / np.sqrt(np.diag(covariance))
    root = np.linalg.cholesky(covariance * np.outer(scale, scale)) / scale[:, None]
    drawn = multivariate_t(np.zeros(mean.size), np.eye(mean.size), freedom)
    steps: NDArray[np.float64] = drawn.rvs(draws, random_state=np.random.default_rng(seed)).reshape(draws, -1)
    density = drawn.logpdf(steps) - np.linalg.slogdet(root)[1]
    weights = np.array([posterior.log_posterior(mean + root @ step) for step in steps]) - density
    relative = np.exp(weights - weights.max())
    return float(logsumexp(weights)) - np.log(draws), float(relative.sum() ** 2 / (relative @ relative) / draws)


def repeated(posterior: Posterior, draws: int, repeats: int) -> tuple[float, float, float]:
    """ln of the mean evidence of all repetitions, its error, and the least share of draws that are effective."""
    found = [importance(posterior, draws, seed) for seed in range(repeats)]
    logs = np.array([each for each, _ in found])
    mean = float(logsumexp(logs)) - np.log(repeats)
    return mean, float(np.std(np.exp(logs - mean), ddof=1) / np.sqrt(repeats)), min(share for _, share in found)


def chip(options: argparse.Namespace, kept: Measurements) -> None:
    with tempfile.TemporaryDirectory() as folder:
        found = diagnose(concealed(Path(folder), {"sidewall.thickness": 1.04 * 0.7e-3}))
        print(f"{found.seconds:.0f} s: {found.headline}\n")
        print("| hypothesis | parameters | evidence of the search | Laplace | importance sampling | effective | s |")
        print("| --- | ---: | ---: | ---: | ---: | ---: | ---: |")
        evidences = {each.explanation.hypothesis.name: each.explanation.log_evidence for each in found.found.final}
        for name in (found.decision.chosen.name, "nothing"):
            posterior, started = found.posterior(name), time.perf_counter()
            mean, error, effective = repeated(posterior, options.draws, options.repeats)
            seconds, laplace = time.perf_counter() - started, posterior.laplace().log_evidence
            kept.add(f"{name}: Laplace less importance sampling", laplace - mean, "1")
            kept.add(f"{name}: effective", effective, "1")
            print(f"| {name} | {len(posterior.names)} | {evidences[name]:.2f} | {laplace:.2f} "
                  f"| {mean:.2f} ± {error:.2f} | {100.0 * effective:.0f} % | {seconds:.0f} |", flush=True)


def disc(options: argparse.Namespace, kept: Measurements) -> None:
    print("| concealed | hypothesis | Laplace | importance sampling | nested sampling | calls | s |")
    print("| --- | --- | ---: | ---: | ---: | ---: | ---: |")
    for effect, values in EFFECTS.items():
        with tempfile.TemporaryDirectory() as folder:
            model, truth = recorded(Path(folder), values)
            for name in (effect, "nothing"):
                posterior, started = settled(model, name, truth), time.perf_counter()
                worth, error, calls = nested(posterior, options.live)
                seconds, laplace = time.perf_counter() - started, posterior.laplace().log_evidence
                mean, deviation, _ = repeated(posterior, options.draws, options.repeats)
                kept.add(f"{effect}, {name}: Laplace less nested sampling", laplace - worth, "1")
                kept.add(f"{effect}, {name}: Laplace less importance sampling", laplace - mean, "1")
                print(f"| {effect} | {name} | {laplace:.2f} | {mean:.2f} ± {deviation:.2f} | {worth:.2f} ± {error:.2f} "
                      f"| {calls} | {seconds:.0f} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("case", choices=("chip", "disc"))
    parser.add_argument("--draws", type=int, default=400, help="of importance sampling, in each repetition")
    parser.add_argument("--repeats", type=int, default=4)
    parser.add_argument("--live", type=int, default=200, help="live points of nested sampling")
    with_json(parser)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    with measurements(options.json) as kept, threadpool_limits(limits=1):
        {"chip": chip, "disc": disc}[options.case](options, kept)


if __name__ == "__main__":
    main()
