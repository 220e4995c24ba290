"""The report is one file that opens offline, and the records are JSON any reader takes."""

from __future__ import annotations

import base64
import html
import json
import math
import re
from collections import namedtuple
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from workbench.files.writing import write_json
from workbench.render.canvas import Picture
from workbench.report import page
from workbench.report.comparison import comparison_record
from workbench.report.definitions import DEFINITIONS, definition
from workbench.report.figures import (
    CAPACITANCE_COLUMNS,
    FIGURE_COLUMNS,
    NAMED_COUPLINGS,
    figures_record,
    figures_rows,
    figures_table,
)
from workbench.report.page import Answer, Block, Note, TextTable, Verbatim, number_text, table, write_report
from workbench.report.record import record
from workbench.report.resonances import (
    RESONANCE_COLUMNS,
    resonance_notes,
    resonances_record,
    resonances_table,
    single_fit_record,
    single_fits_record,
)
from workbench.results.circuit import FittedNumber, fit_circuit
from workbench.results.comparison import compare
from workbench.results.merit import figures, measured_figures
from workbench.results.resonances import resonances_of
from workbench.results.spectrum import Spectrum

#: A Butterworth-Van Dyke resonator: series resonance at 1 MHz, 10 ohm, Q = 100, beside 1 nF.
F0, RESISTANCE, Q, STATIC = 1e6, 10.0, 100.0, 1e-9


def resonator(low: float = 0.95e6, high: float = 1.3e6) -> Spectrum:
    f = np.linspace(low, high, 1401)
    inductance = Q * RESISTANCE / (2 * math.pi * F0)
    motional = RESISTANCE + 2j * math.pi * f * inductance * (1.0 - (F0 / f) ** 2)
    return Spectrum(f, 1.0 / (1.0 / motional + 2j * math.pi * f * STATIC))


class Outline(HTMLParser):
    """Tags that are open, and the text."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.text = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)

    def handle_data(self, data: str) -> None:
        self.text += data


def test_a_report_holds_its_pictures_and_escapes_what_it_is_given(tmp_path: Path) -> None:
    picture = tmp_path / "a.png"
    picture.write_bytes(b"\x89PNG not really")
    path = write_report(tmp_path / "new" / "report.html", "A <b> & C", [
        ("First", ["one line\nand another", TextTable(("", "x (%)"), (("a<b", "1"),)), Note("mind \"this\"")]),
        ("Second", [Picture(picture, "a 'caption' <i>")]),
    ])
    text = path.read_text(encoding="utf-8")
    outline = Outline()
    outline.feed(text)
    assert "A <b> & C" in outline.text
    assert "a<b" in outline.text
    assert "a 'caption' <i>" in outline.text
    assert outline.tags.count("h2") == 2
    assert outline.tags.count("p") == 2
    assert not {"b", "i", "script", "link"} & set(outline.tags)
    found = re.findall(r'src="data:image/png;base64,([^"]+)"', text)
    assert [base64.b64decode(image) for image in found] == [picture.read_bytes()]
    assert "//" not in text.replace(found[0], "")


def test_headings_say_what_they_mean_and_a_legend_lists_it(tmp_path: Path) -> None:
    table = figures_table(figures_rows("disc", figures(resonator())))
    text = write_report(tmp_path / "a.html", "a", [("b", [table, TextTable(("x", "y"), (("1", "2"),))])]).read_text()
    assert text.count("<abbr title=") == 4
    assert text.count('<dl class="legend">') == 1
    for name in ("f0", "Z_min", "Q", "k_eff"):
        assert f'<abbr title="{DEFINITIONS[name]}">{name}' in html.unescape(text)
        assert f"<dt>{name}</dt><dd>{DEFINITIONS[name]}</dd>" in html.unescape(text)


def test_every_column_of_figures_and_traps_is_defined() -> None:
    figures_of = (*FIGURE_COLUMNS[1:], *NAMED_COUPLINGS, *CAPACITANCE_COLUMNS, *RESONANCE_COLUMNS[1:4])
    for heading in (*figures_of, "barrier (fJ)", "lift / weight", "above the floor (mm)", "focusing time (s)"):
        assert definition(heading), heading


def test_values_in_si_are_shown_in_the_units_of_their_columns() -> None:
    shown = table("place | f (MHz):.3f | p0 (kPa) | share (%):.0f | points | mean E_ac (J/m^3):+.1g",
                  [("a | b: c", 1.25e6, 12345.678, 0.5, 7, 2.0),
                   (["x", "y"], math.nan, None, math.inf, np.int64(3), -2.0)])
    assert shown.columns == ("place", "f (MHz)", "p0 (kPa)", "share (%)", "points", "mean E_ac (J/m^3)")
    assert shown.rows == (("a | b: c", "1.250", "12.35", "50", "7", "+2"), ("x; y", "", "", "inf", "3", "-2"))


def test_a_table_of_attributes_has_an_empty_cell_after_none() -> None:
    rows = [SimpleNamespace(name="a", peak=SimpleNamespace(frequency=2e6)), SimpleNamespace(name="b", peak=None)]
    assert table("name=name | f (MHz):.1f=peak.frequency", rows).rows == (("a", "2.0"), ("b", ""))


def test_a_record_has_the_attributes_of_its_keys() -> None:
    pairs = namedtuple("pairs", "low high")
    value = SimpleNamespace(
        frequency=np.float64(1e6), error=math.nan, chip=SimpleNamespace(name="disc"), best=None, is_wet=np.True_,
        bounds=(pairs(1.0, math.inf), pairs(-1.0, 2.0)), fitted=FittedNumber(3.0, math.nan), across=np.eye(2))
    found = record(value, "frequency_hz error chip=chip.name best { q } best_q=best.q is_wet "
                          "bounds { lowest_m=low high } fitted across_m_pa=across")
    assert found == {
        "frequency_hz": 1e6, "error": None, "chip": "disc", "best": None, "best_q": None, "is_wet": True,
        "bounds": [{"lowest_m": 1.0, "high": None}, {"lowest_m": -1.0, "high": 2.0}], "fitted": [3.0, None],
        "across_m_pa": [[1.0, 0.0], [0.0, 1.0]]}
    assert list(found) == ["frequency_hz", "error", "chip", "best", "best_q", "is_wet", "bounds", "fitted",
                           "across_m_pa"]
    json.dumps(found, allow_nan=False)
    with pytest.raises(AttributeError, match="phase"):
        record(value, "phase_rad")


def test_every_template_is_of_a_module() -> None:
    folder = Path(page.__file__).parent
    templates = {path.stem for path in (folder / "templates").glob("*.html")} - {"page", "blocks", "materials"}
    assert templates <= {path.stem for path in folder.glob("*.py")}
    assert len(templates) > 8


def test_a_table_has_a_heading_for_every_column() -> None:
    with pytest.raises(ValueError, match="a column without one"):
        TextTable(("", "x", ""), ())
    with pytest.raises(ValueError, match="does not have the 2 cells"):
        TextTable(("", "x"), (("1",),))


def test_text_of_several_lines_is_one_paragraph(tmp_path: Path) -> None:
    blocks: list[Block] = ["one\nparagraph.\n\nAnother.", Verbatim("a = 1\nb = 2"), Answer("Yes.")]
    text = write_report(tmp_path / "a.html", "a", [("b", blocks)]).read_text()
    assert "<p>one paragraph.</p><p>Another.</p>" in text
    assert "<pre>a = 1\nb = 2</pre>" in text
    assert '<p class="answer">Yes.</p>' in text


def test_json_has_no_numbers_that_json_does_not_have(tmp_path: Path) -> None:
    path = write_json(tmp_path / "a.json", {"x": [1.5, None], "y": {"z": "text"}})
    assert json.loads(path.read_text()) == {"x": [1.5, None], "y": {"z": "text"}}
    before = path.read_bytes()
    with pytest.raises(ValueError, match="x is nan, which JSON does not have"):
        write_json(path, {"x": math.nan})
    assert path.read_bytes() == before


def test_figures_are_recorded_in_si_and_shown_in_their_columns() -> None:
    merit = figures(resonator())
    record = figures_record(merit, "")
    # Near the series resonance the static branch, 159 ohm in parallel with 10, moves |Z| by under half a per cent.
    assert record["f0_hz"] == pytest.approx(F0, rel=1e-3)
    assert record["z_min_ohm"] == pytest.approx(RESISTANCE, rel=5e-3)
    assert record["q"] == pytest.approx(Q, rel=0.02)
    assert record["antiresonance_hz"] > record["f0_hz"]
    ((row, named),) = figures_rows("disc", merit)
    assert len(row) == len(FIGURE_COLUMNS)
    assert row[:2] == ("disc", f"{merit.f0 / 1e6:.4f}")
    assert not named
    assert not {"kt", "kp"} & set(record)


def test_without_a_resonance_there_are_no_figures_and_a_reason() -> None:
    merit, reason = measured_figures(resonator(0.95e6, 0.99e6))
    assert merit is None
    assert "edge of the band" in reason
    assert figures_record(merit, reason) == {"f0_hz": None, "z_min_ohm": None, "q": None, "no_resonance": reason}
    assert figures_rows("disc", None) == [(("disc", "none", "", "", ""), {})]


def test_fits_are_recorded_with_their_errors() -> None:
    spectrum = resonator()
    assert set(single_fits_record(spectrum)) == {"pole", "bvd"}
    record = single_fit_record(fit_circuit(spectrum))
    # The circuit itself, without noise: the fit returns what was put in.
    assert record["frequency_hz"][0] == pytest.approx(F0, rel=1e-6)
    assert record["q"][0] == pytest.approx(Q, rel=1e-5)
    assert record["C0"][0] == pytest.approx(STATIC, rel=1e-5)
    assert all(len(value) == 2 for key, value in record.items() if key != "rms_residual")


def test_resonances_are_listed_with_their_errors() -> None:
    found = {"disc": resonances_of(resonator()), "capacitor": None}
    table = resonances_table(found)
    assert [row[0] for row in table.rows] == ["disc", "capacitor"]
    assert table.rows[0][1].startswith(f"{1e-6 * F0:.4f}")
    assert table.rows[1][1] == "none"
    record = resonances_record(found["disc"])
    assert record["resonances"][0]["frequency_hz"][0] == pytest.approx(F0, rel=1e-6)
    assert record["static_capacitance_f"][0] == pytest.approx(STATIC, rel=1e-5)
    assert resonances_record(None) == {"resonances": []}
    assert re.fullmatch(r"disc: the circuit of these resonances, beside a shunt of 1000 ± .* pF with a loss tangent of "
                        r".*, leaves .* % of Z \(rms\), which is good: circuits .* leave less than 3 %",
                        resonance_notes(found)[0])


def test_a_comparison_is_recorded_with_all_it_found() -> None:
    spectrum = resonator()
    other = Spectrum(spectrum.frequency, 1.1 * spectrum.impedance)
    record = comparison_record(compare(spectrum, other))
    assert record["mape_percent"] == pytest.approx(10.0)
    assert record["worst_percent"] == pytest.approx(10.0)
    assert record["figures"]["Z_min (ohm)"]["difference_percent"] == pytest.approx(10.0)
    assert record["reduced_chi_square"] is None
    json.dumps(record, allow_nan=False)


@pytest.mark.parametrize(("value", "text"), [(1234.5678, "1235"), (0.00012345, "0.0001234"), (math.inf, "inf")])
def test_numbers_are_short(value: float, text: str) -> None:
    assert number_text(value) == text
