"""Mutated files: is every one read or refused in one line, and is a changed spectrum noticed?

    .venv/bin/python tests/benchmarks/mutations.py [--seed 1] [--count 500] [--kinds recording chip] [--limit 60]

Files of several kinds (:data:`KINDS`) are mutated one at a time and read in a process beside, which is ended and begun
again after `--limit` seconds or a crash. The first table counts how the readings ended: read, refused (InputError),
traceback (any other error), hang, crash. The second counts the spectra that differ by more than 1 % in a row from the
file as it was, and how many of these have a finding more: by a cell of a value, by one of a frequency, and by what
stands above the rows, which no reader can see through. Files that are refused, and rows left out as without a value,
are not among them. The public recordings beside the checkout are
mutated too, if there are any. The status is 1 after a traceback, hang or crash.
"""

from __future__ import annotations

import argparse
import dataclasses
import multiprocessing
import re
import shutil
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(Path(__file__).resolve().parent)]

from measurements import measurements, with_json  # noqa: E402

from workbench.files.errors import InputError  # noqa: E402

#: Relative change of Z in one row that has to be noticed.
NOTICED = 0.01
#: Standard deviations of the noise that simulated recordings are written with.
NOISES = (0.0, 1e-4, 1e-3)
#: Points of the simulated recordings.
POINTS = 121

OUTCOMES = ("read", "refused", "traceback", "hang", "crash")
_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_WITH_COMMA = _NUMBER.replace(r"\.", "[.,]")


@dataclass(frozen=True)
class Mutation:
    """A mutated content, what was done, and whether to the "value" or "frequency" of a row, or to the "rest"."""

    content: bytes
    done: str
    where: str


@dataclass(frozen=True)
class Kind:
    """One kind of file: `make` writes files into a folder, `mutate` changes the content of one, `read` reads it and
    returns frequency, impedance and codes of findings, or None."""

    make: Callable[[Path], Sequence[Path]]
    mutate: Callable[[bytes, np.random.Generator], Mutation]
    read: Callable[[Path], tuple[Any, Any, list[str]] | None]


# --------------------------------------------------------------------------------------------------------------------
# Mutations.


def changed_bytes(content: bytes, random: np.random.Generator) -> Mutation:
    """One byte, a run of bytes, a line, a number or the end."""
    if not content:
        return Mutation(content, "nothing", "rest")
    at = int(random.integers(len(content)))
    lines = content.splitlines(keepends=True)
    line = int(random.integers(len(lines)))
    found: list[tuple[str, Callable[[], bytes]]] = [
        ("byte", lambda: content[:at] + bytes([int(random.integers(256))]) + content[at + 1:]),
        ("bytes lost", lambda: content[:at] + content[at + int(random.integers(1, 40)):]),
        ("bytes added", lambda: content[:at] + random.bytes(int(random.integers(1, 40))) + content[at:]),
        ("cut", lambda: content[:at]),
        ("line lost", lambda: b"".join(lines[:line] + lines[line + 1:])),
        ("line twice", lambda: b"".join(lines[:line + 1] + lines[line:])),
        ("lines swapped", lambda: b"".join(lines[:line] + lines[line + 1:line + 2] + [lines[line]] + lines[line + 2:])),
        ("zeros", lambda: content[:at] + bytes(len(content) - at)),
    ]
    name, make = found[int(random.integers(len(found)))]
    return Mutation(make(), name, "rest")


#: What takes the place of a value of a TOML file.
TOML_VALUES = ("nan", "-inf", "1e308", "-1", "0", "true", '""', '"\\u001b[31m"', "[]", "{}", "[[1]]", '"9.9e37 mm"',
               '"nan mm"', '"1 parsec"', '"../../x"', "1979-05-27", "9" * 5000, "[" * 3000 + "]" * 3000, "0x7f")


def changed_toml(content: bytes, random: np.random.Generator) -> Mutation:
    """A value, a key or a table of TOML, or bytes."""
    lines = content.decode().splitlines()
    with_value = [i for i, line in enumerate(lines) if re.match(r"[\w.\"-]+ *= *\S", line)]
    if random.random() < 0.4 or not with_value:
        return changed_bytes(content, random)
    line = int(random.choice(with_value))
    key, _, value = lines[line].partition("=")
    numbers = list(re.finditer(_NUMBER, value))
    match int(random.integers(4)):
        case 0:
            done, lines[line] = "value", f"{key}= {TOML_VALUES[int(random.integers(len(TOML_VALUES)))]}"
        case 1:
            done, lines[line] = "key", f"{key.strip()}x = {value}"
        case 2 if numbers:
            number = numbers[int(random.integers(len(numbers)))]
            done, lines[line] = "number", f"{key}={value[:number.start()]}{_cell(number[0], random)[1]}" + value[
                number.end():]
        case _:
            done, lines[line] = "line moved", ""
            lines.insert(int(random.integers(len(lines))), f"{key}={value}")
    return Mutation("\n".join(lines).encode() + b"\n", done, "rest")


def changed_table(content: bytes, random: np.random.Generator) -> Mutation:
    """A cell of a row, or in one case of five bytes anywhere."""
    lines = content.decode("latin-1").splitlines(keepends=True)
    rows = [index for index, line in enumerate(lines) if _tokens(line)]
    if random.random() < 0.2:
        found = changed_bytes(content, random)
        first = next((i for i, (a, b) in enumerate(zip(content, found.content, strict=False)) if a != b), len(content))
        line = content.count(b"\n", 0, min(first, len(found.content)))
        return dataclasses.replace(found, where="value" if line >= rows[0] else "rest")
    row = rows[int(random.integers(len(rows)))]
    tokens = _tokens(lines[row])
    place = int(random.integers(len(tokens)))
    token, where = tokens[place], "frequency" if place == 0 else "value"
    if random.random() < 0.15:
        # With the cell below, as by a slip in a spreadsheet, or with any other of the column.
        other = min(row + 1, rows[-1]) if random.random() < 0.5 else rows[int(random.integers(len(rows)))]
        if len(_tokens(lines[other])) == len(tokens) and other != row:
            there = _tokens(lines[other])[place]
            for index, old, new in ((row, token, there[0]), (other, there, token[0])):
                lines[index] = lines[index][:old.start()] + new + lines[index][old.end():]
        return Mutation("".join(lines).encode("latin-1"), "cells swapped", where)
    done, cell = _cell(token[0], random)
    lines[row] = lines[row][:token.start()] + cell + lines[row][token.end():]
    return Mutation("".join(lines).encode("latin-1"), done, where)


def _tokens(line: str) -> list[re.Match[str]]:
    """The numbers of a line that holds nothing but two or more; none of any other."""
    pattern = _WITH_COMMA if ";" in line else _NUMBER
    found = list(re.finditer(pattern, line))
    return found if len(found) > 1 and not re.sub(pattern, "", line).strip(" ,;\t\r\n") else []


def _cell(cell: str, random: np.random.Generator) -> tuple[str, str]:
    """One change of the kinds that copying and transmission make, and the changed cell."""
    mantissa, mark, exponent = re.fullmatch(r"([^eE]*)([eE]?)(.*)", cell).groups()  # type: ignore[union-attr]
    digits = [index for index, letter in enumerate(mantissa) if letter.isdigit()]
    # The first digits weigh most; of the others most changes are below what has to be noticed.
    at = digits[min(int(random.exponential(2.0)), len(digits) - 1)]
    decimal = "," if "," in mantissa else "."
    match int(random.integers(7)):
        case 0:
            other = str((int(mantissa[at]) + int(random.integers(1, 10))) % 10)
            return "digit", mantissa[:at] + other + mantissa[at + 1:] + mark + exponent
        case 1:
            return "digit lost", mantissa[:at] + mantissa[at + 1:] + mark + exponent
        case 2:
            return "digit twice", mantissa[:at + 1] + mantissa[at:] + mark + exponent
        case 3:
            return "sign", cell[1:] if cell[0] in "+-" else f"-{cell}"
        case 4:
            bare = mantissa.replace(decimal, "")
            place = int(random.integers(1, max(len(bare), 2)))
            return "point", bare[:place] + decimal + bare[place:] + mark + exponent
        case 5:
            return "exponent", f"{mantissa}e{int(exponent or 0) + int(random.choice([-10, -3, -1, 1, 3, 10, 300]))}"
        case _:
            return "no value", str(random.choice(["9.9e37", "9.91E+37", "-9.9e37", "OVLD", "nan", "1e308", "0"]))


# --------------------------------------------------------------------------------------------------------------------
# Kinds of files.


def _simulated() -> Iterator[tuple[Any, Any, float]]:
    """Frequencies, impedances and noises of simulated devices."""
    from workbench.readers import read_recording

    random = np.random.default_rng(7)
    for path in sorted((ROOT / "tests/data/reference").glob("*.csv"))[:4]:
        spectrum = read_recording(path).spectrum
        begin = int(random.integers(spectrum.frequency.size - POINTS))
        f, z = spectrum.frequency[begin:begin + POINTS], spectrum.impedance[begin:begin + POINTS]
        for noise in NOISES:
            yield f, z * (1.0 + noise * (random.standard_normal(POINTS) + 1j * random.standard_normal(POINTS))), noise


def _table(head: str, *columns: Any, delimiter: str = ",", form: str = "%.10g", end: str = "") -> str:
    return head + "".join(delimiter.join(form % value for value in row) + "\n" for row in zip(
        *columns, strict=True)) + end


def make_recordings(folder: Path) -> list[Path]:
    """Simulated recordings in several formats, and the real ones beside the checkout whose noise allows 1 %."""
    from workbench.results.spectrum import Spectrum, write_spectrum

    files = []
    for number, (f, z, _) in enumerate(_simulated()):
        y, degrees = 1.0 / z, np.angle(z, deg=True)
        analyser = "!Keysight Technologies,E4990A,MY0,A.04.00\n!Date: now\nBEGIN CH1_DATA\nFrequency(Hz),{}\n"
        texts = {
            "e4990a_polar.csv": _table(analyser.format("|Z|(Ohm)-data,theta-z(deg)-data"), f, abs(z), degrees,
                                       end="END\n"),
            "e4990a_rx.csv": _table(analyser.format("R(Ohm)-data,X(Ohm)-data"), f, z.real, z.imag, end="END\n"),
            "e4990a_gb.csv": _table(analyser.format("G(S)-data,B(S)-data"), f, y.real, y.imag, form="%.9e",
                                    end="END\n"),
            "semicolons.csv": _table("f (Hz);R (Ohm);X (Ohm)\n", f, z.real, z.imag, delimiter=";").replace(".", ","),
            "tabs.txt": _table("Frequency (Hz)\t|Y| (S)\tphase Y (deg)\n", f, abs(y), -degrees, delimiter="\t"),
            "capacitance.csv": _table("f (Hz),Cp (F),G (S)\n", f, y.imag / (2.0 * np.pi * f), y.real),
        }
        name, text = list(texts.items())[number % len(texts)]
        files += [folder / f"{number}_{name}", write_spectrum(Spectrum(f, z), folder / f"{number}_own.csv")]
        files[-2].write_text(text)
    beside = ROOT.parent / "shared" / "recordings"
    for name in ("unibas-disc-20x2/MODULOFASEMODOTHICKNES.CSV", "stutts-4294a/RB5100.txt", "stutts-4294a/MD1.txt",
                 "stutts-4294a/sampleadmittance.txt", "format-samples/zfitpy_E4990A-example1.csv",
                 "format-samples/zfitpy_E4990A-example2.csv", "format-samples/ethz_4294A_impedance.txt"):
        if (beside / name).is_file():
            files.append(folder / Path(name).name)
            shutil.copy(beside / name, files[-1])
    return files


def make_touchstone(folder: Path) -> list[Path]:
    """Touchstone files of one and two ports, S, Y and Z."""
    files = []
    for number, (f, z, _) in enumerate(_simulated()):
        s = (z - 50.0) / (z + 50.0)
        texts = {
            "s_ri.s1p": _table("! simulated\n# MHz S RI R 50\n", f / 1e6, s.real, s.imag, delimiter=" "),
            "s_db.s1p": _table("# Hz S DB R 50\n", f, 20.0 * np.log10(abs(s)), np.angle(s, deg=True), delimiter="\t"),
            "z.s1p": _table("# kHz Z MA R 1\n", f / 1e3, abs(z), np.angle(z, deg=True), delimiter=" "),
            "y.ts": _table(f"[Version] 2.0\n# Hz Y RI R 50\n[Number of Ports] 1\n[Number of Frequencies] {len(f)}\n"
                           "[Network Data]\n", f, (1.0 / z).real, (1.0 / z).imag, delimiter=" ", end="[End]\n"),
            "two.s2p": _table("# GHz S MA R 50\n", f / 1e9, abs(s), np.angle(s, deg=True), *[1e-3 + 0.0 * f] * 6,
                              delimiter=" ")}
        name, text = list(texts.items())[number % len(texts)]
        files.append(folder / f"{number}_{name}")
        files[-1].write_text(text)
    return files


def read_spectrum(path: Path) -> tuple[Any, Any, list[str]]:
    from workbench.readers import read_recording

    reading = read_recording(path)
    return reading.spectrum.frequency, reading.spectrum.impedance, [finding.code for finding in reading.findings]


def _copied(source: Path, *names: str) -> Callable[[Path], list[Path]]:
    """A maker of copies of a folder of the checkout, of which the files `names` are mutated."""
    def make(folder: Path) -> list[Path]:
        shutil.copytree(source, folder, dirs_exist_ok=True)
        return [path for name in names for path in sorted(folder.glob(name))]

    return make


def make_run(folder: Path) -> list[Path]:
    """A run file of a bench."""
    from workbench.bench.run_file import RunPoint, new_run, write_run

    random = np.random.default_rng(3)
    points = tuple(RunPoint(
        number, 1e6 + 500.0 * number, 5.0, 4.5, 0, 1.7e9 + number, raw=np.ones((1, 2, 60), np.int16),
        volts_per_count=random.random((1, 2)), volts_at_zero=random.random((1, 2)), start=random.random(1), step=4e-9,
        voltage=random.random((1, 2)) + 0j, voltage_uncertainty=random.random((1, 2)),
        fitted_frequency=random.random(1), impedance=1.0 + 1.0j, uncertainty=0.01, flags=()) for number in range(12))
    run = new_run('[generator]\nport = "x"\n', {"generator": "g", "oscilloscope": "o"}, 1.7e9)
    write_run(dataclasses.replace(run, points=points), folder / "run.h5")
    return [folder / "run.h5"]


def make_step(folder: Path) -> list[Path]:
    """A STEP file of two discs."""
    import cadquery

    assembly = cadquery.Assembly(name="chip")
    for name, height in (("transducer", 0.0), ("substrate", 1.0)):
        assembly.add(cadquery.Workplane().workplane(offset=height).circle(10).extrude(1), name=name)
    assembly.export(str(folder / "chip.step"))
    return [folder / "chip.step"]


def _read_chip(path: Path) -> None:
    from geometry.chip import read_chip

    read_chip(path)


def _read_campaign(path: Path) -> None:
    from workbench.campaign.campaign import read_campaign

    read_campaign(path)


def _read_study(path: Path) -> None:
    from workbench.design.plan import read_study

    read_study(path)


def _read_run(path: Path) -> None:
    from workbench.bench.run_file import read_run

    read_run(path)


#: A chip whose substrate is a part of a STEP file beside it.
STEP_CHIP = """
[chip]
name = "chip"
band = ["0.95 MHz", "1.15 MHz"]
[[layers]]
role = "transducer"
material = "pzt4/acevedo_2026_fitted"
thickness = "1 mm"
radius = "10 mm"
[[layers]]
role = "substrate"
material = "pmma"
profile = { step = "STEP", part = "substrate" }
"""


def _read_step(path: Path) -> None:
    """Read the file as every command does: as a layer of a chip, in a process of the kernel's own."""
    from geometry.chip import read_chip

    chip = path.with_suffix(".toml")
    chip.write_text(STEP_CHIP.replace("STEP", path.name))
    read_chip(chip)


KINDS: dict[str, Kind] = {
    "recording": Kind(make_recordings, changed_table, read_spectrum),
    "touchstone": Kind(make_touchstone, changed_table, read_spectrum),
    "chip": Kind(_copied(ROOT / "geometry/chips", "*.toml"), changed_toml, _read_chip),
    "campaign": Kind(_copied(ROOT / "geometry/chips/small_campaign", "campaign.toml", "chip.toml"), changed_toml,
                     lambda path: _read_campaign(path.parent / "campaign.toml")),
    "study": Kind(_copied(ROOT / "examples/small_study", "study.toml", "chip.toml"), changed_toml,
                  lambda path: _read_study(path.parent / "study.toml")),
    "run": Kind(make_run, changed_bytes, _read_run),
    "step": Kind(make_step, changed_bytes, _read_step),
}


# --------------------------------------------------------------------------------------------------------------------
# Reading in a process beside.


def _serve(connection: Connection) -> None:
    """Read what comes, in the process beside."""
    while True:
        kind, path = connection.recv()
        try:
            found: tuple[str, Any] = "read", KINDS[kind].read(path)
        except InputError as error:
            found = "refused", str(error)
        except Exception:
            found = "traceback", traceback.format_exc()
        connection.send(found)


class Beside:
    """A process that reads files, begun anew where it hangs or crashes."""

    def __init__(self, limit: float) -> None:
        self.limit = limit
        self._begin()

    def _begin(self) -> None:
        context = multiprocessing.get_context("spawn")
        self.connection, other = context.Pipe()
        self.process: SpawnProcess = context.Process(target=_serve, args=(other,), daemon=True)
        self.process.start()
        other.close()

    def read(self, kind: str, path: Path) -> tuple[str, Any]:
        """The outcome, of :data:`OUTCOMES`, with what was read or said."""
        try:
            self.connection.send((kind, path))
            if self.connection.poll(self.limit):
                return self.connection.recv()  # type: ignore[no-any-return]
            found = "hang", f"more than {self.limit:g} s"
        except (EOFError, ConnectionResetError, BrokenPipeError):
            self.process.join()
            found = "crash", f"exit status {self.process.exitcode}"
        self.end()
        self._begin()
        return found

    def end(self) -> None:
        self.process.kill()
        self.process.join()
        self.connection.close()


@contextmanager
def beside(limit: float) -> Iterator[Beside]:
    found = Beside(limit)
    try:
        yield found
    finally:
        found.end()


# --------------------------------------------------------------------------------------------------------------------
# Counting.


@dataclass
class Counts:
    """How the readings ended, by kind; spectra ``changed`` by more than :data:`NOTICED` and those ``noticed``, by kind
    and place; ``unnoticed`` and ``faults`` in words."""

    outcomes: Counter[tuple[str, str]]
    changed: Counter[tuple[str, str]]
    noticed: Counter[tuple[str, str]]
    unnoticed: list[str]
    faults: list[str]

    def share(self, where: str) -> float:
        """The share of the changed spectra that are noticed."""
        changed, noticed = (sum(n for (_, place), n in each.items() if place == where)
                            for each in (self.changed, self.noticed))
        return noticed / changed if changed else 1.0


def differs(first: tuple[Any, Any, list[str]], second: tuple[Any, Any, list[str]]) -> float:
    """The largest relative difference of two spectra in a row, at the frequencies that both have.

    Infinite if the second has a frequency of its own.
    """
    if np.setdiff1d(second[0], first[0]).size:
        return np.inf
    _, one, two = np.intersect1d(first[0], second[0], return_indices=True)
    return float(np.max(np.abs(second[1][two] / first[1][one] - 1.0), initial=0.0))


def run(kinds: Sequence[str], count: int, seed: int, limit: float, *, show: bool = False) -> Counts:
    """Mutate and read `count` files, as many of each kind."""
    random, found = np.random.default_rng(seed), Counts(Counter(), Counter(), Counter(), [], [])
    with tempfile.TemporaryDirectory() as name, beside(limit) as reader:
        files, whole = {}, dict[Path, Any]()
        for kind in kinds:
            (folder := Path(name) / kind).mkdir()
            files[kind] = KINDS[kind].make(folder)
        for number in range(count):
            kind = kinds[number % len(kinds)]
            path = files[kind][int(random.integers(len(files[kind])))]
            content = path.read_bytes()
            if path not in whole:
                outcome, whole[path] = reader.read(kind, path)
                if outcome != "read":
                    raise RuntimeError(f"{path} as it is: {outcome}: {whole[path]}")
            mutation = KINDS[kind].mutate(content, random)
            path.write_bytes(mutation.content)
            outcome, result = reader.read(kind, path)
            words = f"{kind} {path.name}, {mutation.done}"
            if outcome not in ("read", "refused"):
                found.faults.append(f"{words}: {outcome}: {result}")
                if show:
                    print(found.faults[-1], flush=True)
            path.write_bytes(content)
            found.outcomes[kind, outcome] += 1
            if outcome == "read" and result is not None:
                _count(found, kind, mutation, words, whole[path], result)
    return found


def _count(found: Counts, kind: str, mutation: Mutation, words: str, whole: Any, result: Any) -> None:
    """Count a spectrum that was read and differs by more than :data:`NOTICED`."""
    difference = differs(whole, result)
    if difference <= NOTICED:
        return
    where = "frequency" if np.isinf(difference) and mutation.where == "value" else mutation.where
    more = Counter(result[2]) - Counter(whole[2])
    found.changed[kind, where] += 1
    found.noticed[kind, where] += bool(more)
    if not more:
        found.unnoticed.append(f"{words} ({where}): {100.0 * difference:.3g} %")


def print_tables(found: Counts, kinds: Sequence[str]) -> None:
    print(f"{'kind':<12}{'mutated':>9}" + "".join(f"{outcome:>11}" for outcome in OUTCOMES))
    for kind in kinds:
        counts = [found.outcomes[kind, outcome] for outcome in OUTCOMES]
        print(f"{kind:<12}{sum(counts):>9}" + "".join(f"{n:>11}" for n in counts))
    print(f"\n{'spectra changed by more than 1 %':<34}{'changed':>9}{'noticed':>9}")
    for key in sorted(found.changed):
        print(f"{key[0] + ', ' + key[1]:<34}{found.changed[key]:>9}{found.noticed[key]:>9}")
    for where in ("value", "frequency"):
        print(f"share noticed, {where}: {100.0 * found.share(where):.1f} %")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])  # type: ignore[union-attr]
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=500, help="mutated files, over all kinds (default 500)")
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), choices=KINDS, help="of files (default all)")
    parser.add_argument("--limit", type=float, default=60.0, metavar="SECONDS", help="for one file (default 60)")
    with_json(parser)
    options = parser.parse_args()
    started = time.perf_counter()
    with measurements(options.json) as kept:
        found = run(options.kinds, options.count, options.seed, options.limit, show=True)
        for where in ("value", "frequency"):
            kept.add(f"share noticed, {where}", 100.0 * found.share(where), "%")
        kept.add("tracebacks, hangs, crashes", len(found.faults), "1")
    for words in found.unnoticed:
        print(f"not noticed: {words}")
    print_tables(found, options.kinds)
    print(f"seed {options.seed}, {time.perf_counter() - started:.0f} s")
    sys.exit(1 if found.faults else 0)


if __name__ == "__main__":
    main()
