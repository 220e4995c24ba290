"""Touchstone one-port files (.s1p), read by scikit-rf; network analysers use e^{+j w t}, as a spectrum does."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from workbench.files.errors import InputError
from workbench.readers.text import RecordingText, cells, check_frequencies, check_impedance, numbers
from workbench.spectrum import Origin, Spectrum

_OPTION = re.compile(r"#\s*([kmg]?hz\b|[szy]\b|ma\b|db\b|ri\b|r\s+[\d.]+)", re.IGNORECASE)


def recognises(text: RecordingText) -> bool:
    if Path(text.path).suffix.casefold() == ".s1p":
        return True
    first = next((line.strip() for line in text.lines if line.strip() and not line.strip().startswith("!")), "")
    return _OPTION.match(first) is not None


def parse(text: RecordingText) -> Spectrum:
    """Read the file.

    Raises:
        InputError: a row without exactly three numbers, frequencies that do not increase, a short circuit exactly
            (zero impedance) or an open one, or anything scikit-rf cannot read.
    """
    content = [(index + 1, line.split("!")[0].strip()) for index, line in enumerate(text.lines)]
    data = [(line, " ".join(row.split())) for line, row in content if row and not row.startswith(("#", "["))]
    rows = numbers(text, [(line, row.replace(" ", "\t")) for line, row in data], delimiter="\t", columns=3)
    check_frequencies(text, rows.values[:, 0], rows.lines, column=1)

    import skrf

    try:
        network = skrf.Network(text.path)
    except (ValueError, IndexError, KeyError, TypeError, NotImplementedError, AttributeError, OSError) as error:
        raise InputError(text.path, "Touchstone", str(error), "a one-port file that scikit-rf reads") from None
    if network.s.shape != (len(data), 1, 1):
        raise InputError(text.path, "Touchstone", f"{network.s.shape} read", f"one port and the {len(data)} rows")
    reflection, reference = network.s[:, 0, 0], network.z0[:, 0]
    # Not the network's own z: scikit-rf moves an ideal open circuit a little to keep its matrices invertible.
    with np.errstate(divide="ignore", invalid="ignore"):
        impedance = reference * (1.0 + reflection) / (1.0 - reflection)
    check_impedance(text, impedance, rows.lines)
    notes = [line.lstrip(" !").strip() for line in text.lines if line.strip().startswith("!")]
    option = next((" ".join(cells(row[1:], "\t")[0].split()) for _, row in content if row.startswith("#")), "")
    settings = {"option line": option} | {f"comment {i}": note for i, note in enumerate(notes, 1) if note}
    origin = Origin("measured", text.path, text.sha256, settings=settings)
    return Spectrum(np.asarray(network.f, dtype=np.float64), impedance, None, origin)
