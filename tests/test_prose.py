"""The prose of pages, docstrings and messages: no banned word or inverted sentence; each rule finds a bad sentence."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

import pytest
from prose import BANNED, docstring_offences, message_offences, offences, rate, sentences

ROOT = Path(__file__).resolve().parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
#: Packages without an offence in their docstrings. Add a package when its docstrings are rewritten.
CLEAN = (
    "geometry", "materials", "workbench", "workbench/acoustics", "workbench/app", "workbench/bench",
    "workbench/campaign", "workbench/catalogue", "workbench/commands", "workbench/design", "workbench/diagnosis",
    "workbench/fem", "workbench/files", "workbench/fitting", "workbench/installation", "workbench/instruments",
    "workbench/jobs",
    "workbench/model", "workbench/physics", "workbench/readers", "workbench/reduced", "workbench/render",
    "workbench/report", "workbench/reproduction", "workbench/results", "workbench/search", "workbench/simulation",
)
#: Packages whose strings are names of effects, keys of records or parts of a page, beside messages.
WITH_NAMES = {"workbench/app", "workbench/catalogue", "workbench/readers", "workbench/report"}
#: Times per thousand words, over all pages. Manuals of this field have 0.1 and 0.0.
MOST_WHAT, MOST_SAID = 1.0, 0.5

#: A bad sentence for each banned word, by the word it must find.
BAD_WORDS = {
    "inflation": "The inflation is 1.2.",
    "laid to": "The shift is laid to the gel.",
    "taken up by": "The shift is taken up by the gel.",
    "at odds": "The two states are at odds.",
    "told": "The number of draws is told.",
    "held": "Density is held.",
    "worth": "The second mode is worth little.",
    "dearer": "A finer mesh is dearer.",
    "is left": "At the end 1 % is left.",
    "known numbers": "The known numbers move.",
    "released": "The thickness is released.",
    "rim": "The disc is loose at its rim.",
    "taker": "A taker of a job may end.",
    "basins": "The search has two basins.",
}
#: Bad sentences for the other rules.
BAD = [
    ("what as a noun", "The report shows what the circuit leaves."),
    ("inverted opening", "Asserted are 1e-4 for f0."),
    ("inverted opening", "Known is then the density."),
    ("inverted opening", "Not counted are the ports."),
    ("inverted opening", "Where the power goes says the field `losses`."),
    ("inverted opening", "Of a solid the loss is stated once."),
    ("inverted opening", "Who means it writes it down."),
    ("more than one relative clause", "A disc which has a film which is thin is loaded."),
]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_page_has_no_offence(page: Path) -> None:
    found = [f"{page.name}:{line}: {rule}: {text}" for line, rule, text in offences(page.read_text(encoding="utf-8"))]
    assert not found, "\n".join(found)


@pytest.mark.parametrize(("package", "read"), [
    *((package, docstring_offences) for package in CLEAN),
    *((package, message_offences) for package in CLEAN if package not in WITH_NAMES)])
def test_a_clean_package_has_no_offence(package: str, read: Callable[[str], Iterable[tuple[int, str, str]]]) -> None:
    modules = sorted((ROOT / package).glob("*.py"))
    assert len(modules) > 1
    found = [f"{module.relative_to(ROOT)}:{line}: {rule}: {text}" for module in modules
             for line, rule, text in read(module.read_text(encoding="utf-8"))]
    assert not found, "\n".join(found)


@pytest.mark.parametrize(("word", "most"), [("what", MOST_WHAT), ("said|told|asked", MOST_SAID)])
def test_rates_over_all_pages_are_those_of_a_manual(word: str, most: float) -> None:
    counts = [rate(page.read_text(encoding="utf-8"), word) for page in PAGES]
    words = sum(each for _, each in counts)
    assert words > 20_000
    assert 1000 * sum(each for each, _ in counts) / words < most


def test_there_is_a_bad_sentence_for_every_banned_word() -> None:
    assert len(BAD_WORDS) == len(BANNED)


@pytest.mark.parametrize(("word", "sentence"), BAD_WORDS.items())
def test_a_banned_word_is_found(word: str, sentence: str) -> None:
    ((line, rule, text),) = offences(f"A good sentence.\n\n- {sentence}\n")
    assert (line, text) == (3, sentence)
    assert rule.startswith(f"{word}: better ")


@pytest.mark.parametrize(("rule", "sentence"), BAD)
def test_a_bad_sentence_is_found(rule: str, sentence: str) -> None:
    assert [(line, each) for line, each, _ in offences(f"# Heading\n\nA good\nsentence. {sentence}\n")] == [(4, rule)]


def test_questions_and_code_are_no_offence() -> None:
    assert not list(offences("What is the gain? Which of the two says more?\n"))
    assert not list(offences("Run `what held` and\n\n```sh\nwhat is left\n```\n\n    what is told\n\nSpeed is 1.\n"))
    assert not list(offences("A state held out is predicted, and 2 % is left out.\n"))


def test_cells_items_and_paragraphs_are_sentences_of_their_own() -> None:
    text = "| a | which |\n| --- | --- |\n| `x` | who \\| it |\n\n1. First\n   part; second.\n2. Third\n"
    assert [(line, part) for line, part in sentences(text) if part.strip("-")] == [
        (1, "a"), (1, "which"), (3, "X"), (3, "who \\| it"), (5, "First part;"), (6, "second."), (7, "Third")]


def test_a_docstring_is_read_with_its_first_line() -> None:
    source = ('"""Good."""\n\n\ndef f() -> None:\n    """One two three four five six seven eight nine ten\n'
              '    eleven twelve thirteen.\n\n    It returns what it gets.\n    """\n')
    assert [(line, rule) for line, rule, _ in docstring_offences(source)] == [
        (5, "first line longer than 12 words"), (8, "what as a noun")]


def test_messages_are_read_without_docstrings_and_values() -> None:
    source = ('def f(held: float) -> str:\n    """Density is held."""\n    if held < 0:\n'
              '        raise ValueError(f"density {held} is told "\n                         "and held")\n'
              '    return "what"\n')
    assert [(line, rule.split(":")[0], text) for line, rule, text in message_offences(source)] == [
        (4, word, "density X is told and held") for word in ("told", "held")]
