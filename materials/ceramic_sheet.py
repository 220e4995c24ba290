"""Constants of a ceramic from the figures of a data sheet.

Makers print coupling factors, frequency constants and Poisson's ratio in place of s12, s13 and much of shear. The rules
here give the ten constants of the strain-charge form from them (IEEE Std 176-1987; radial mode: Meeker's equation (1 -
sigma) J1(x) = x J0(x)). With S = s11 + s12 and B = -s13 sqrt(2 / (S s33)) the couplings of a plate obey, exactly,

    kp^2 = 2 d31^2 / (S eps33^T)        k33^2 = d33^2 / (s33 eps33^T)
    kt = (k33 - B kp) / sqrt((1 - B^2) (1 - kp^2))
    eps33^S = eps33^T (1 - kp^2) (1 - kt^2)        c33^D = 1 / (s33 (1 - B^2) (1 - kt^2))

Figures are real and SI, permittivities relative. Frequency constants are those of the resonance for Np and N31 and of
the antiresonance for N33, Nt and N15 (IEEE Std 176, EN 50324-1).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field

from workbench.files.errors import InputError
from workbench.files.quantities import VACUUM_PERMITTIVITY

#: Constants of the strain-charge form and their dimensions. OF_SHEAR act only in shear along the poling.
CONSTANTS = {
    **dict.fromkeys(("s11", "s12", "s13", "s33"), "compliance"),
    **dict.fromkeys(("d31", "d33"), "piezoelectric charge"), "free_eps33": "permittivity",
    "s44": "compliance", "d15": "piezoelectric charge", "free_eps11": "permittivity",
}
OF_SHEAR = ("s44", "d15", "free_eps11")

#: Further figures of data sheets, with their dimensions.
FIGURES = {
    **dict.fromkeys(("kp", "kt", "k31", "k33", "k15", "poisson_ratio"), "dimensionless"),
    **dict.fromkeys(("Np", "Nt", "N31", "N33", "N15"), "frequency constant"),
    **dict.fromkeys(("s33D", "s66"), "compliance"), **dict.fromkeys(("c33D", "Y11", "Y33"), "pressure"),
    **dict.fromkeys(("g31", "g33", "g15"), "piezoelectric voltage"),
    **dict.fromkeys(("eps11", "eps33"), "permittivity"),
}

#: Figures between 0 and 1.
_SHARES = ("kp", "kt", "k31", "k33", "k15", "poisson_ratio")

#: Largest relative difference of a printed figure from the derived one. Sheets print two or three digits, with
#: tolerances of 5 to 10 %. Doubled, a contradiction of this size passes.
CONTRADICTS = 0.02

#: Ratio of d31 to d33 above which equal signs raise; lead titanates, nearly uncoupled across, may have either sign.
UNCOUPLED = 0.1


@dataclass(frozen=True)
class Rule:
    """A rule for one number. ``formula`` uses the names of the sheet; ``value`` takes the ``needs`` in order."""

    target: str
    needs: tuple[str, ...]
    formula: str
    value: Callable[..., float]

    def __str__(self) -> str:
        return f"{self.target} = {self.formula}"


def radial_root(poisson_ratio: float) -> float:
    """The lowest root x of (1 - sigma) J1(x) = x J0(x). It is 2.05 for a ceramic."""
    from scipy.optimize import brentq
    from scipy.special import j0, j1

    return float(brentq(lambda x: (1.0 - poisson_ratio) * j1(x) - x * j0(x), 1.5, 2.404, xtol=1e-12))


def _radial_constant(s11: float, poisson_ratio: float, density: float) -> float:
    return radial_root(poisson_ratio) / (math.pi * math.sqrt(density * s11 * (1.0 - poisson_ratio**2)))


def _poisson_from_radial(radial: float, s11: float, density: float) -> float:
    from scipy.optimize import brentq

    return float(brentq(lambda ratio: _radial_constant(s11, ratio, density) - radial, 0.0, 0.9, xtol=1e-12))


def _s13(share: float, s11: float, s12: float, s33: float) -> float:
    """s13 from B of the module's docstring."""
    return -share * math.sqrt((s11 + s12) * s33 / 2.0)


def _s13_by_couplings(kp: float, kt: float, k33: float, s11: float, s12: float, s33: float) -> float:
    """The smaller |s13| of the two with that kt. If rounding allows none, the one with the nearest kt."""
    clamped = kt**2 * (1.0 - kp**2)
    square = max(clamped * (kp**2 + clamped - k33**2), 0.0)
    share = kp / k33 if square == 0.0 else (kp * k33 - math.sqrt(square)) / (kp**2 + clamped)
    return _s13(share, s11, s12, s33)


def _s13_by_stiffness(c33: float, kp: float, k33: float, s11: float, s12: float, s33: float) -> float:
    free = 1.0 - 1.0 / (s33 * (1.0 - k33**2) * c33)
    return _s13(kp * k33 + math.sqrt((1.0 - kp**2) * (1.0 - k33**2) * free), s11, s12, s33)


_EPS = VACUUM_PERMITTIVITY

#: The rules of every number, the best conditioned first.
RULES = (
    Rule("s11", ("Y11",), "1 / Y11", lambda y: 1.0 / y),
    Rule("s11", ("N31", "density"), "1 / (4 density N31^2)", lambda n, rho: 1.0 / (4.0 * rho * n**2)),
    Rule("s11", ("d31", "k31", "free_eps33"), "d31^2 / (k31^2 free_eps33)", lambda d, k, e: (d / k) ** 2 / (e * _EPS)),
    Rule("s11", ("Np", "poisson_ratio", "density"), "x^2 / (pi^2 density Np^2 (1 - poisson_ratio^2)), x of the radial "
         "mode", lambda n, p, rho: (radial_root(p) / (math.pi * n)) ** 2 / (rho * (1.0 - p**2))),
    Rule("s33", ("Y33",), "1 / Y33", lambda y: 1.0 / y),
    Rule("s33", ("s33D", "k33"), "s33D / (1 - k33^2)", lambda s, k: s / (1.0 - k**2)),
    Rule("s33", ("d33", "k33", "free_eps33"), "d33^2 / (k33^2 free_eps33)", lambda d, k, e: (d / k) ** 2 / (e * _EPS)),
    Rule("s33D", ("N33", "density"), "1 / (4 density N33^2)", lambda n, rho: 1.0 / (4.0 * rho * n**2)),
    Rule("free_eps33", ("d33", "g33"), "d33 / g33", lambda d, g: d / g / _EPS),
    Rule("free_eps33", ("d31", "g31"), "d31 / g31", lambda d, g: d / g / _EPS),
    Rule("free_eps33", ("d33", "k33", "s33"), "d33^2 / (k33^2 s33)", lambda d, k, s: (d / k) ** 2 / (s * _EPS)),
    Rule("free_eps33", ("eps33", "kp", "kt"), "eps33 / ((1 - kp^2) (1 - kt^2))",
         lambda e, p, t: e / ((1.0 - p**2) * (1.0 - t**2))),
    Rule("d33", ("g33", "free_eps33"), "g33 free_eps33", lambda g, e: g * e * _EPS),
    Rule("d33", ("k33", "s33", "free_eps33"), "k33 sqrt(s33 free_eps33)", lambda k, s, e: k * math.sqrt(s * e * _EPS)),
    Rule("d31", ("g31", "free_eps33"), "g31 free_eps33", lambda g, e: g * e * _EPS),
    Rule("d31", ("k31", "s11", "free_eps33"), "-k31 sqrt(s11 free_eps33)",
         lambda k, s, e: -k * math.sqrt(s * e * _EPS)),
    Rule("d31", ("kp", "s11", "s12", "free_eps33"), "-kp sqrt((s11 + s12) free_eps33 / 2)",
         lambda k, a, b, e: -k * math.sqrt((a + b) * e * _EPS / 2.0)),
    Rule("s12", ("s66", "s11"), "s11 - s66 / 2", lambda s, a: a - s / 2.0),
    Rule("s12", ("poisson_ratio", "s11"), "-poisson_ratio s11", lambda p, s: -p * s),
    Rule("poisson_ratio", ("kp", "k31"), "1 - 2 k31^2 / kp^2", lambda p, k: 1.0 - 2.0 * (k / p) ** 2),
    Rule("poisson_ratio", ("kp", "d31", "s11", "free_eps33"), "1 - 2 d31^2 / (kp^2 s11 free_eps33)",
         lambda p, d, s, e: 1.0 - 2.0 * (d / p) ** 2 / (s * e * _EPS)),
    Rule("poisson_ratio", ("Np", "s11", "density"), "that of the radial mode at Np with s11", _poisson_from_radial),
    Rule("c33D", ("Nt", "density"), "4 density Nt^2", lambda n, rho: 4.0 * rho * n**2),
    Rule("kp", ("d31", "s11", "s12", "free_eps33"), "sqrt(2 d31^2 / ((s11 + s12) free_eps33))",
         lambda d, a, b, e: abs(d) * math.sqrt(2.0 / ((a + b) * e * _EPS))),
    Rule("k33", ("d33", "s33", "free_eps33"), "sqrt(d33^2 / (s33 free_eps33))",
         lambda d, s, e: abs(d) / math.sqrt(s * e * _EPS)),
    Rule("kt", ("eps33", "free_eps33", "kp"), "sqrt(1 - eps33 / (free_eps33 (1 - kp^2)))",
         lambda e, f, p: math.sqrt(1.0 - e / (f * (1.0 - p**2)))),
    Rule("s13", ("c33D", "kt", "s11", "s12", "s33"), "-sqrt((s11 + s12) (s33 - 1 / (c33D (1 - kt^2))) / 2)",
         lambda c, k, a, b, s: -math.sqrt((a + b) * (s - 1.0 / (c * (1.0 - k**2))) / 2.0)),
    Rule("s13", ("kp", "kt", "k33", "s11", "s12", "s33"), "-B sqrt((s11 + s12) s33 / 2), kt = (k33 - B kp) / "
         "sqrt((1 - B^2) (1 - kp^2))", _s13_by_couplings),
    Rule("s13", ("c33D", "kp", "k33", "s11", "s12", "s33"), "-B sqrt((s11 + s12) s33 / 2), B = kp k33 + "
         "sqrt((1 - kp^2) (1 - k33^2 - 1 / (s33 c33D)))", _s13_by_stiffness),
    Rule("s44", ("N15", "k15", "density"), "1 / (4 density N15^2 (1 - k15^2))",
         lambda n, k, rho: 1.0 / (4.0 * rho * n**2 * (1.0 - k**2))),
    Rule("s44", ("d15", "k15", "free_eps11"), "d15^2 / (k15^2 free_eps11)", lambda d, k, e: (d / k) ** 2 / (e * _EPS)),
    Rule("d15", ("g15", "free_eps11"), "g15 free_eps11", lambda g, e: g * e * _EPS),
    Rule("d15", ("k15", "s44", "free_eps11"), "k15 sqrt(s44 free_eps11)", lambda k, s, e: k * math.sqrt(s * e * _EPS)),
    Rule("free_eps11", ("eps11", "k15"), "eps11 / (1 - k15^2)", lambda e, k: e / (1.0 - k**2)),
    Rule("free_eps11", ("d15", "g15"), "d15 / g15", lambda d, g: d / g / _EPS),
    Rule("free_eps11", ("d15", "k15", "s44"), "d15^2 / (k15^2 s44)", lambda d, k, s: (d / k) ** 2 / (s * _EPS)),
    Rule("free_eps11", ("eps11", "d15", "s44"), "eps11 + d15^2 / s44", lambda e, d, s: e + d**2 / (s * _EPS)),
)


def sheet_figures(constants: Mapping[str, float], density: float) -> dict[str, float]:
    """All :data:`FIGURES` from the ten :data:`CONSTANTS` and the density. They are real, in SI, with relative
    permittivities."""
    s11, s12, s13, s33, d31, d33, free33, s44, d15, free11 = (constants[name] for name in CONSTANTS)
    k31, k33, k15 = (abs(d) / math.sqrt(s * e * _EPS) for d, s, e in (
        (d31, s11, free33), (d33, s33, free33), (d15, s44, free11)))
    poisson = -s12 / s11
    kp = k31 * math.sqrt(2.0 / (1.0 - poisson))
    share = -s13 * math.sqrt(2.0 / ((s11 + s12) * s33))
    kt = (k33 - share * kp) / math.sqrt((1.0 - share**2) * (1.0 - kp**2))
    s33_open = s33 * (1.0 - k33**2)
    c33_open = 1.0 / (s33 * (1.0 - share**2) * (1.0 - kt**2))
    bar, rod, plate, shear = (0.5 / math.sqrt(density * s) for s in (
        s11, s33_open, 1.0 / c33_open, s44 * (1.0 - k15**2)))
    return {
        "kp": kp, "kt": kt, "k31": k31, "k33": k33, "k15": k15, "poisson_ratio": poisson,
        "Np": _radial_constant(s11, poisson, density), "Nt": plate, "N31": bar, "N33": rod, "N15": shear,
        "s33D": s33_open, "s66": 2.0 * (s11 - s12), "c33D": c33_open, "Y11": 1.0 / s11, "Y33": 1.0 / s33,
        "g31": d31 / (free33 * _EPS), "g33": d33 / (free33 * _EPS), "g15": d15 / (free11 * _EPS),
        "eps11": free11 * (1.0 - k15**2), "eps33": free33 * (1.0 - kp**2) * (1.0 - kt**2),
    }  # fmt: skip


@dataclass(frozen=True)
class Sheet:
    """The real numbers (SI) of a data sheet, printed and derived."""

    file: str
    printed: Mapping[str, float]
    derived: dict[str, Rule] = field(default_factory=dict)
    numbers: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.numbers.update(self.printed)
        for name in _SHARES:
            if name in self.printed and not 0.0 < self.printed[name] < 1.0:
                raise InputError(self.file, name, self.printed[name], "a number between 0 and 1")
        for name in FIGURES:
            if name in self.printed and name != "g31" and not self.printed[name] > 0.0:
                raise InputError(self.file, name, self.printed[name], "a number above zero")

    def resolve(self, name: str, pending: Collection[str] = ()) -> bool:
        """Whether a number is printed or derivable. The first usable rule derives it."""
        if name in self.numbers:
            return True
        waiting = {*pending, name}
        for rule in (each for each in RULES if each.target == name):
            if waiting.isdisjoint(rule.needs) and all(self.resolve(need, waiting) for need in rule.needs):
                self.numbers[name] = self._follow(rule)
                self.derived[name] = rule
                return True
        return False

    def _follow(self, rule: Rule) -> float:
        given = {need: self.numbers[need] for need in rule.needs}
        try:
            found = rule.value(*given.values())
        except (ValueError, ZeroDivisionError):
            found = math.nan
        if not math.isfinite(found):
            raise InputError(self.file, rule.target, f"{rule} of " + ", ".join(
                f"{name} {number:.4g}" for name, number in given.items()),
                "numbers for which it is real: one of them contradicts the others, or is misprinted")
        return float(found)

    def missing(self, names: Iterable[str]) -> list[str]:
        """The `names` that neither the sheet nor a rule gives."""
        return [name for name in names if not self.resolve(name)]

    def lacks(self, name: str) -> InputError:
        """The error for a constant that is neither printed nor derivable."""
        rules = [rule for rule in RULES if rule.target == name]
        inner = [rule for rule in RULES if rule.target not in CONSTANTS and rule.target not in self.numbers
                 and any(rule.target in each.needs for each in rules)]
        return InputError(self.file, name, None, f"{name}, or numbers that give it with the rest of the sheet: "
                          + "; ".join(map(str, (*rules, *inner))))


def check_signs(numbers: Mapping[str, float], shown: Mapping[str, str], file: str) -> None:
    """Raise if strain-charge constants have wrong signs, or s12 is too large.

    Args:
        numbers: of :data:`CONSTANTS`, SI; some may be missing.
        shown: each as written in the file.

    Raises:
        InputError: with the number as written in the file.
    """
    for name in ("s11", "s33", "s44", "free_eps33", "free_eps11"):
        if not numbers.get(name, 1.0) > 0.0:
            raise InputError(file, name, shown[name], "a number above zero")
    positive = [name for name in ("s12", "s13") if numbers.get(name, -1.0) > 0.0]
    if positive:
        verb = "are" if len(positive) > 1 else "is"
        raise InputError(file, positive[0], shown[positive[0]], f"a negative number; {', '.join(positive)} {verb} "
                         "positive: ceramics have s12 < 0 and s13 < 0, and sheets leave the minus sign out")
    if abs(numbers.get("s12", 0.0)) >= numbers.get("s11", math.inf):
        raise InputError(file, "s12", shown["s12"], f"less than s11, {shown['s11']}, in size")
    across, along = numbers.get("d31", -1.0), numbers.get("d33", 1.0)
    if across * along > 0.0 and abs(across) > UNCOUPLED * abs(along):
        name, wanted, word = ("d31", "negative", "positive") if across > 0.0 else ("d33", "positive", "negative")
        raise InputError(file, name, shown[name], f"a {wanted} number; {name} is {word}: ceramics have d31 < 0 < d33, "
                         "and sheets leave the minus sign out")


def check_sizes(numbers: Mapping[str, float], shown: Mapping[str, str], file: str) -> None:
    """Raise if the strain-charge constants are those of no stable ceramic.

    Raises:
        InputError: with the coupling factor or compliance at fault and the numbers that give it.
    """
    s11, s12, s13, s33, d31, d33, free33, s44, d15, free11 = (numbers[name] for name in CONSTANTS)
    most = math.sqrt((s11 + s12) * s33 / 2.0)
    if abs(s13) >= most:
        raise InputError(file, "s13", shown["s13"], f"less than sqrt((s11 + s12) s33 / 2), {most * 1e12:.4g} 1/TPa, in "
                         "size: otherwise the solid is not stable")
    couplings: dict[str, float] = {}
    for name, needs, square in (
        ("k31", ("d31", "s11", "free_eps33"), d31**2 / (s11 * free33)),
        ("kp", ("d31", "s11", "s12", "free_eps33"), 2.0 * d31**2 / ((s11 + s12) * free33)),
        ("k33", ("d33", "s33", "free_eps33"), d33**2 / (s33 * free33)),
        ("k15", ("d15", "s44", "free_eps11"), d15**2 / (s44 * free11)),
    ):
        couplings[name] = math.sqrt(square / _EPS)
        if couplings[name] >= 1.0:
            raise InputError(file, needs[0], shown[needs[0]], f"a number with a coupling factor below 1: {name} is "
                             f"{couplings[name]:.3g} from " + ", ".join(f"{each} {shown[each]}" for each in needs))
    share, kp, k33 = -s13 / most, math.copysign(couplings["kp"], -d31 * d33), couplings["k33"]
    if (k33 - share * kp) ** 2 >= (1.0 - share**2) * (1.0 - kp**2):
        raise InputError(file, "s13", shown["s13"], "a number with a thickness coupling kt below 1, which "
                         f"kp {kp:.3g}, k33 {k33:.3g} and the compliances do not give: the permittivity at constant "
                         "strain would be negative")


def contradictions(
    printed: Mapping[str, float], tolerances: Mapping[str, float], derived: Mapping[str, float]
) -> list[str]:
    """Sentences on `printed` figures that contradict the `derived` ones. A difference counts beyond :data:`CONTRADICTS`
    and beyond the `tolerances` (SI), the declared roundings and uncertainties."""
    found = []
    for name, number in printed.items():
        if name in derived and abs(derived[name] - number) > max(CONTRADICTS * abs(number), tolerances.get(name, 0.0)):
            found.append(f"{name} is printed as {number:.4g} and derived as {derived[name]:.4g} "
                         f"({100.0 * (derived[name] / number - 1.0):+.1f} %)")
    return found
