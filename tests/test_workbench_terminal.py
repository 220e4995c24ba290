"""Tables on the terminal: at most 80 columns, no word cut, nothing lost, whatever the table."""

from __future__ import annotations

import numpy as np
import pytest
from support import check_table, table_lines

from workbench.commands.terminal import print_table
from workbench.fitting.batch import BatchColumn
from workbench.report.figures import FIGURE_COLUMNS
from workbench.report.fit_batch import batch_columns_table, devices_table
from workbench.report.page import TextTable

STATES = ("state", "spectrum", "f0 (kHz)", "Z_min (ohm)", "Q", "MAPE (%)", "rms (%)", "chi-square")
LABEL = "with stiffness_loss of pzt_mine/disc_1@2 and shear_modulus loss of glass/trial, held out"
PARAMETERS = ("parameter", "start", "fitted", "95 % interval", "unit", "change (%)", "remark")
DEVIATION = np.array([1.0, 2.0])

#: Title, table and how it is drawn.
TABLES: dict[str, tuple[str, TextTable, str]] = {
    "diagnosis": ("before and after", TextTable(STATES, tuple(
        (state, label, "1030.531", "5.391", "117.2", "1.234", "2.345", "10500")
        for state in ("empty", "filled") for label in ("measured", "as stated", "known parameters", LABEL))), "folded"),
    "fit": ("pzt_mine/acevedo_2026_initial@12, joint", TextTable(PARAMETERS, (
        ("transducer.thickness (disc_1, disc_2)", "2.02", "2.02131", "2.01988 to 2.02274", "mm", "+0.06",
         "held by passivity; not determined; by profile"),
        ("eps33.loss", "0.02", "0.0213145", "0.0201 to 0.0222", "1", "+6.57", "not determined"))), "one"),
    "batch": ("discs", devices_table({
        "disc_of_the_first_delivery": {"mape_percent": 1.02, "rms_log_residual": 0.019, "accepted": True,
                                       "saved_as": "pzt_mine/disc_of_the_first_delivery@1", "wall_seconds": 123.4},
        "disc_2": {"mape_percent": 55.02, "rms_log_residual": 0.519, "accepted": False, "saved_as": None,
                   "wall_seconds": 23.4}}), "folded"),
    "what devices have in common": ("quantities over the devices", batch_columns_table(tuple(
        BatchColumn(name, unit, ("a", "b"), DEVIATION, DEVIATION, DEVIATION, 1.5, 0.7071, 66.7, ("disc_7", "disc_12"))
        for name, unit in (("transducer.thickness", "m"), ("bench.series_resistance", "ohm"), ("c33.loss", "1")))),
        "one"),
    "convergence": ("refinement of chip, filled", TextTable(
        ("elements per wavelength", "unknowns", "f0 (MHz)", "change (%)", "Z_min (ohm)", "change (%)", "Q"),
        (("10.0", "88288", "1.03051", "", "5.3912", "", "117.2"),
         ("14.1", "170288", "1.03050", "-0.0010", "5.3901", "-0.020", "117.3"))), "one"),
    "measurement": ("disc_7.h5", TextTable(FIGURE_COLUMNS, (
        ("10 Vpp", "1.0305", "5.391", "117.2", "0.456"),)), "one"),
    "history": ("pzt_mine/disc_1", TextTable(("version", "fitted on", "MAPE (%)", "algorithm", "remark"), (
        ("pzt_mine/disc_1@1", "2026-01-02T12:23:34+00:00", "1.02", "joint",
         "withdrawn on 2026-01-03T12:23:34+00:00: the density was that of another disc"),
        ("pzt_mine/disc_1@2", "2026-01-04T12:23:34+00:00", "1.01", "joint", ""))), "folded"),
    "keys of two columns": ("", TextTable(("state", "effect", *(f"a-rather-long-heading-{n}" for n in range(6))), tuple(
        (state, effect, *"123456") for state in ("empty", "filled") for effect in ("bond", "gel"))), "folded"),
    "one long word": ("", TextTable(("recording", "value"), (
        ("SHA-256", "0123456789abcdef" * 4),
        ("file", "/a/folder/" + "with_a_long_name/" * 5 + "a_file_of_a_name" * 4 + "_.csv"))), "list"),
    "one column": ("", TextTable(("file",), (("with_a_long_name" * 4 + "_of_78_chars__",), ("a.csv",))), "list"),
    "no rows": ("empty", TextTable(("state", "value"), ()), "one"),
}


@pytest.mark.parametrize("name", TABLES)
def test_a_table_fits_80_columns_and_loses_no_word(name: str) -> None:
    title, table, drawn = TABLES[name]
    lines = table_lines(title, table, width=80)
    check_table(lines, title, table.columns, table.rows)
    tables = sum(line.startswith("┏") for line in lines)
    assert {"one": tables == 1, "folded": tables > 1, "list": tables == 0}[drawn]


def test_a_table_that_fits_is_not_wrapped() -> None:
    table = TextTable(("name", "value (mm)"), (("transducer.thickness", "2.02"), ("", "1.5")))
    assert table_lines("a title", table, width=80) == [
        "a title",
        "┏━━━━━━━━━━━━━━━━━━━━━━┳━━━━━━━━━━━━┓",
        "┃ name                 ┃ value (mm) ┃",
        "┡━━━━━━━━━━━━━━━━━━━━━━╇━━━━━━━━━━━━┩",
        "│ transducer.thickness │ 2.02       │",
        "│                      │ 1.5        │",
        "└──────────────────────┴────────────┘"]
    # One character less: the heading is wrapped between words, the name is whole.
    assert "┃ name                 ┃ (mm)      ┃" in table_lines("", table, width=36)
    # Names break behind their dots, numbers do not.
    narrow = table_lines("", table, width=24)
    assert [line[:15] for line in narrow if line.startswith(("│ tr", "│ th"))] == ["│ transducer. │", "│ thickness   │"]
    assert any("2.02" in line for line in narrow)


def test_folded_tables_repeat_the_columns_that_tell_the_rows_apart() -> None:
    _, table, _ = TABLES["keys of two columns"]
    heads = [line for line in table_lines("", table, width=80) if line.startswith("┃")]
    assert len(heads) > 1
    assert all(line.split()[1:4:2] == ["state", "effect"] for line in heads)


@pytest.mark.parametrize("width", [24, 40, 60, 80, 132])
def test_no_line_is_wider_than_the_terminal(width: int) -> None:
    for title, table, _ in TABLES.values():
        assert max(map(len, table_lines(title, table, width=width))) <= width


def test_the_terminal_says_how_wide_it_is(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    title, table, _ = TABLES["diagnosis"]
    for columns in (60, 80, 120):
        monkeypatch.setenv("COLUMNS", str(columns))
        print_table(title, table)
        widest = max(map(len, capsys.readouterr().out.splitlines()))
        assert columns - 5 <= widest <= columns
