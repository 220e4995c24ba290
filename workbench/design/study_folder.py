"""The folder of a study: its settings and every finished point.

    begun.json                  the settings; a study with other settings is refused
    models/0.spectra.npz        the range model of a part, see `workbench.reduced.ranges.RangeModel.save`
    models/0.npz                the model made from it, see `workbench.design.model.DesignModel.save`
    points/00000000.npz         finished points, called after the first of them
    points/full.00000042.npz    the full solve of a point

A run that is killed at any moment continues from here: each file is written whole or not at all, and missing ones are
computed again. Every file ends in, or contains, a digest of its content; models and points that are damaged are
computed again. Nothing in the folder is executed.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from workbench.design.evaluation import Evaluation
from workbench.design.parts import StudyPart
from workbench.design.plan import Study
from workbench.design.variables import VariedNumber
from workbench.files.errors import InputError
from workbench.files.output import OutputFolder, run_folder
from workbench.files.ownership import Manifest, Outputs, discard
from workbench.files.sealed import read_arrays, write_arrays
from workbench.files.writing import write_json
from workbench.model.problem import fill

Real = NDArray[np.float64]

#: Number of the layout at the head of begun.json; raise it where the layout changes.
FORMAT = 2

_BEGUN, _MODELS, _POINTS = "begun.json", "models", "points"

#: Beginning of the names of files of points solved in full.
FULL = "full."

#: Key of begun.json: the digest of the others.
_SELF = "digest"


@dataclass(frozen=True, eq=False)
class FinishedPoints:
    """Finished points of a study.

    ``index`` (k,) is their row in the study's table. ``figures`` (k, figures) are in SI; ``missing`` (k,) has the
    reasons for those that do not exist. ``frequency`` (k,) Hz is the driven one, ``error`` (k,) the estimated relative
    error of Z there.
    """

    index: NDArray[np.int64]
    figures: Real
    missing: NDArray[np.str_]
    frequency: Real
    error: Real

    @classmethod
    def of(cls, index: Sequence[int] | NDArray[np.int64], found: Sequence[Evaluation],
           names: Sequence[str]) -> FinishedPoints:
        """The evaluations of points of the table.

        `index` (k,) are their rows, `names` the study's figures.
        """
        return cls(
            np.asarray(index, dtype=np.int64),
            np.array([[each.figures[name] for name in names] for each in found], dtype=float).reshape(-1, len(names)),
            np.array([_reasons(each) for each in found], dtype=np.str_),
            np.array([each.frequency for each in found], dtype=float),
            np.array([each.error for each in found], dtype=float))

    @classmethod
    def joined(cls, rows: Sequence[FinishedPoints], names: Sequence[str]) -> FinishedPoints:
        """All points of several groups, each once, in the table's order."""
        whole = [cls.of([], [], names), *rows]
        together = cls(*(np.concatenate([getattr(each, column.name) for each in whole]) for column in fields(cls)))
        _, order = np.unique(together.index, return_index=True)
        return together.chosen(order)

    def chosen(self, at: NDArray[np.int64]) -> FinishedPoints:
        """The points at positions (m,)."""
        return FinishedPoints(*(getattr(self, column.name)[at] for column in fields(self)))


def _reasons(found: Evaluation) -> str:
    """The reasons for missing figures, each once, after the figures' names."""
    reasons: dict[str, list[str]] = {}
    for name, reason in found.missing.items():
        reasons.setdefault(reason, []).append(name)
    return "; ".join(f"{', '.join(names)}: {reason}" for reason, names in reasons.items())


@dataclass(frozen=True)
class StudyFolder:
    """The folder ``path`` of a study with those ``figures``.

    It belongs to this run as long as :func:`opened` is active.
    """

    path: Path
    figures: tuple[str, ...]

    def model(self, part: StudyPart) -> Path:
        """The file of the model of a part."""
        return self.path / _MODELS / f"{part.number}.npz"

    def keep(self, rows: FinishedPoints, kind: str = "") -> None:
        """Save finished points, or a full solve with the `kind` :data:`FULL`.

        They are on the disk when this returns.
        """
        write_arrays(self.path / _POINTS / f"{kind}{rows.index[0]:08d}.npz", vars(rows))

    def rows(self, kind: str = "") -> FinishedPoints:
        """All finished points, or with the `kind` :data:`FULL` all full solves."""
        return FinishedPoints.joined([_unpacked(path, len(self.figures)) for path in self._files(kind)], self.figures)

    def clear_damaged(self) -> None:
        """Remove damaged files of points, each with a warning that names it."""
        for path in (*self._files(""), *self._files(FULL)):
            try:
                _unpacked(path, len(self.figures))
            except InputError as error:
                if isinstance(error.__cause__, OSError):
                    raise  # the disk or a permission, no damage
                warnings.warn(f"{path} is damaged ({error.field}: {error.value}): its points are computed again",
                              stacklevel=2)
                path.unlink()

    def _files(self, kind: str) -> list[Path]:
        return sorted((self.path / _POINTS).glob(f"{kind}[0-9]*.npz"))


def study_outputs(study: Study, folder: Path) -> Outputs:
    """The output files of a study.

    A run continues with those of its models and points. If the folder contains no study yet, everything in folders of
    these names is in its way.
    """
    files = "*.npz" if (folder / _BEGUN).is_file() else "*"
    working = (_BEGUN, f"{_MODELS}/{files}", f"{_POINTS}/{files}")
    return Outputs("study", working=working, names=(
        *working, "study.parquet", "study.nc", "study.json", "report.html",
        *(f"{name}_{state}{end}" for state in study.states
          for name, end in (("parallel", ".png"), ("slices", "_*.png"), ("maps", "_*.png")))))


@contextmanager
def opened(
    path: Path | OutputFolder, study: Study, parts: Sequence[StudyPart], *, overwrite: bool = False
) -> Iterator[StudyFolder]:
    """Open the folder for a study, for this run alone.

    It is made if missing; `overwrite` begins anew.

    Raises:
        InputError: the folder contains another study, or see `workbench.files.output.begin`.
    """
    with run_folder(path, study_outputs(study, Path(path)), source=study.file) as folder:
        _begin(folder.path, study, parts, overwrite=overwrite)
        yield StudyFolder(folder.path, study.figures)


def _begin(path: Path, study: Study, parts: Sequence[StudyPart], *, overwrite: bool) -> None:
    begun, asked = path / _BEGUN, study_description(study, parts)
    if begun.exists() and overwrite:
        # Removed first: without it, points are orphans, which are removed below.
        discard(begun)
    if begun.exists():
        _check_same(_read_begun(begun), asked, path, study)
        return
    for name in Manifest(path).commands:
        if name.startswith((f"{_MODELS}/", f"{_POINTS}/")):
            discard(path / name)
    write_json(begun, {**asked, _SELF: _digest(repr(sorted(asked.items())))})


def _read_begun(begun: Path) -> dict[str, str]:
    """The settings that a study was begun with.

    Raises:
        InputError: the file is damaged.
    """
    try:
        stored = dict(json.loads(begun.read_text(encoding="utf-8")))
        # An older version has no digest, and is refused by its other keys.
        if stored.pop(_SELF, None) in (None, _digest(repr(sorted(stored.items())))):
            return stored
    except (OSError, ValueError, TypeError, RecursionError):
        pass
    raise InputError(str(begun), "file", begun.name, "the settings that the study in this folder was begun with; the "
                     "file is damaged: choose another folder, or begin anew (--overwrite)")


def _check_same(stored: dict[str, str], requested: dict[str, str], path: Path, study: Study) -> None:
    # The program names these settings, so other names come from another version.
    if {key for key in stored if key.startswith("study.")} != {key for key in requested if key.startswith("study.")}:
        raise InputError(study.file, "folder", str(path), "a study of this version; the one in there was begun by an "
                         "older version, and cannot go on: choose another folder, or begin anew (--overwrite)")
    for key in {**requested, **stored}:
        if stored.get(key) != requested.get(key):
            raise InputError(study.file, key, requested.get(key, "nothing"),
                             f"{stored.get(key, 'nothing')!r}, with which the study in {path} was begun; choose "
                             "another folder, or overwrite it (--overwrite)")


def study_description(study: Study, parts: Sequence[StudyPart]) -> dict[str, str]:
    """All settings that determine the table of a study.

    They are texts by the name of the setting.
    """
    operation, sampling = study.operation, study.sampling
    found = {
        "format": str(FORMAT), "version": importlib.metadata.version("acoustofluidic-chip-workbench"),
        "study.chip": f"{study.chip.name}, {_digest(repr(replace(study.chip, file='')))}",
        "study.states": ", ".join(study.states), "study.figures": ", ".join(study.figures),
        "study.drive": str(operation.drive),
        "study.frequency": f"{operation.frequency:.15g} Hz" if isinstance(operation.frequency, float) else str(
            operation.frequency or "as the chip states"),
        "study.band": f"{study.band[0]:.15g} to {study.band[1]:.15g} Hz",
        "study.relative_error": repr(study.relative_error),
        "study.accuracy": repr(study.accuracy), "study.limit": str(study.limit), "sample.method": sampling.method,
        "sample.points": str(sampling.points), "sample.seed": str(sampling.seed),
        **{f"thermal.{region or 'all'}": f"{value:.15g} K/W" for region, value in
           operation.thermal_resistance.items()},
        **{f"vary.{axis.name}": _described(axis) if isinstance(axis, VariedNumber) else ", ".join(axis.materials)
           for axis in study.axes}}
    for part in parts:
        held = dict(fill(part.chip, part.state, study.registry).materials)
        particle = part.chip.state(part.state).particle
        if particle is not None:
            held["particle"] = study.registry.load(particle)
        found[f"materials of {part.label}"] = ", ".join(
            f"{region}: {m.name} {_digest(repr(m))}" for region, m in sorted(held.items()))
    return found


def _described(axis: VariedNumber) -> str:
    if axis.values:
        return f"{', '.join(f'{value:.15g}' for value in axis.values)} {axis.unit}"
    points = f", {axis.points} points" if axis.points else ""
    return f"{axis.low:.15g} to {axis.high:.15g} {axis.unit}{points}"


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def _unpacked(path: Path, figures: int) -> FinishedPoints:
    """The points in a file, with `figures` figures each.

    Raises:
        InputError: the file is damaged.
    """
    _, arrays = read_arrays(path)
    names = [column.name for column in fields(FinishedPoints)]
    count = arrays["index"].size if "index" in arrays else 0
    if any(arrays[name].shape != ((count, figures) if name == "figures" else (count,)) for name in names
           if name in arrays) or not arrays.keys() >= set(names):
        raise InputError(str(path), "file", ", ".join(arrays), f"finished points with {figures} figures each")
    return FinishedPoints(*(arrays[name] for name in names))
