"""Rules of plain English as data, and their offences in Markdown files, docstrings and messages."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

#: Words that the field does not use, and its word for each.
BANNED = {
    r"inflation": "noise scale factor",
    r"laid to": "attributed to",
    r"taken up by": "absorbed by",
    r"at odds": "beyond 3.5 sigma",
    r"said|told|asked": "reported, requested",
    r"held(?![- ]out)": "fixed; active bound",
    r"worth": "log evidence; gain",
    r"dear(?:er|est)?": "expensive",
    r"(?:is|are|was|were) left(?! (?:out|of)\b)|leaves? (?:most|least)": "residual; noise floor",
    r"known numbers?": "parameters; prior",
    r"released": "free",
    r"rims?": "annulus; edge",
    r"takers?": "worker",
    r"basins?(?! of attraction)": "basin of attraction (particles); local optimum (search)",
}
#: Openings that put the verb before its subject, or a clause in place of a thing.
INVERTED = (
    r"(?!Speed|Seed|Need|Feed)[A-Z]\w*ed (?:is|are|was|were)\b",
    r"(?:Known|Shown|Left|Taken|Found|Given|Read|None|Not \w+) (?:is|are|was|were)\b",
    r"(?:Where|How|Whether|Which) [^,?]* (?:says|tells|shows|decides)\b",
    r"(?:Of|Who|Whoever)\b",
)
#: Most words in the first sentence of a docstring, which is its line in a list of names.
FIRST_WORDS = 12
#: Fewest words of a string in code that is read as a message.
MESSAGE_WORDS = 3


def sentences(markdown: str) -> Iterator[tuple[int, str]]:
    """(line, text) of each sentence, or part up to a colon or semicolon, outside code; code in a line becomes X."""
    for code in (r"^( *)```.*?^\1```", r"(?<=\n\n)(?: {4}.*\n)+"):
        markdown = re.sub(code, lambda found: "\n" * found[0].count("\n"), markdown, flags=re.M | re.S)
    markdown = re.sub(r"(?:\{\w+\})?(`+).*?\1", lambda code: "X" + "\n" * code[0].count("\n"), markdown, flags=re.S)
    markdown = re.sub(r"\]\([^)]*\)", "]", markdown)
    # A paragraph, an item, a heading and a cell of a table each end the sentence before them.
    markdown = re.sub(r"^\|.*$", lambda row: re.sub(r"(?<!\\)\|", "\0", row[0]), markdown, flags=re.M)
    markdown = re.sub(r"^[ \t]*(?:[-*]|\d+\.|#+) ", "\0", markdown, flags=re.M)
    markdown = re.sub(r"\n(?=[ \t]*\n)", "\0\n", markdown)
    for found in re.finditer(r"[^\s\0][^\0]*?(?:[.!?:;](?=\s|\0)|(?=\s*(?:\0|\Z)))", markdown):
        yield 1 + markdown[:found.start()].count("\n"), " ".join(found[0].split())


def offences(markdown: str) -> Iterator[tuple[int, str, str]]:
    """(line, rule, text) of each offence in a Markdown text."""
    for line, text in sentences(markdown):
        banned = ((re.search(rf"\b(?:{word})\b", text, re.I), better) for word, better in BANNED.items())
        rules = [f"{found[0].lower()}: better {better}" for found, better in banned if found]
        if re.search(r"\bwhat\b", text, re.I) and not text.endswith("?"):
            rules.append("what as a noun")
        if any(re.match(rf"[*_]*{opening}", text) for opening in INVERTED) and not text.endswith("?"):
            rules.append("inverted opening")
        if len(re.findall(r"\b(?:which|who|whose|whom)\b", text, re.I)) > 1:
            rules.append("more than one relative clause")
        yield from ((line, rule, text) for rule in rules)


def rate(markdown: str, word: str) -> tuple[int, int]:
    """(times, words): how often a pattern occurs in a Markdown text, and the words of the text, outside code."""
    prose = " ".join(text for _, text in sentences(markdown))
    return len(re.findall(rf"\b(?:{word})\b", prose, re.I)), len(prose.split())


def docstring_offences(source: str) -> Iterator[tuple[int, str, str]]:
    """(line, rule, text) of each offence in the docstrings of a Python module."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) and (
                text := ast.get_docstring(node)):
            line = node.body[0].lineno
            first = re.split(r"(?<=[.])\s", " ".join(text.split("\n\n")[0].split()))[0]
            if len(first.split()) > FIRST_WORDS:
                yield line, f"first line longer than {FIRST_WORDS} words", first
            yield from ((line + further - 1, rule, part) for further, rule, part in offences(text))


def message_offences(source: str) -> Iterator[tuple[int, str, str]]:
    """(line, rule, text) of each offence in the messages of a Python module.

    Messages are the texts of errors, findings and reports: all strings of :data:`MESSAGE_WORDS` or more outside
    docstrings. A value in an f-string becomes X.
    """
    nodes = list(ast.walk(ast.parse(source)))
    skipped = {id(node.value) for node in nodes if isinstance(node, ast.Expr)}
    skipped |= {id(part) for node in nodes if isinstance(node, ast.JoinedStr) for part in node.values}
    for node in nodes:
        match node:
            case ast.Constant(value=str(text)):
                pass
            case ast.JoinedStr(values=values):
                text = "".join(str(part.value) if isinstance(part, ast.Constant) else "X" for part in values)
            case _:
                continue
        if id(node) not in skipped and len(text.split()) >= MESSAGE_WORDS:
            yield from ((node.lineno, rule, part) for _, rule, part in offences(text))
