"""Plain English: turns of phrase that must not come back, in documents, help texts and code."""

from __future__ import annotations

import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
BANNED = {
    r"cannot be meant": "is impossible, is out of range",
    r"nothing is where": "is empty if",
    r"who is who": "association",
    r"\b(is|are|was|were|be|being|not) told\b(?! (apart|from))": "is given, is reported",
    r"\bcannot be had\b": "is not available",
    r"\bstands? there twice\b": "is duplicated",
    r"\bis laid\b": "is placed, is fixed",
    r"\b(tells?|told) of\b": "describes, reports",
    r"\b(whoever|somebody|nobody)\b": "name who it is",
    r"\bfor want of\b": "without",
    r"\blaid by\b": "fixed by",
    r"\bfinds? out (which|who|itself)\b": "determines",
    r"\bfalls? to pieces\b": "breaks",
    r"\bwho (is (due|static)|moves)\b": "which landmarks",
    r"\bare believed\b": "are accepted",
    r"\bin a frame of its own\b": "in its own frame",
    r"\bin one way alone\b": "uniquely",
    r"\btaken for rounding\b": "treated as rounding",
    r"\bhas no say\b": "has no influence",
    r"\bfree to swing\b": "poorly determined",
    r"\bthan chance brings\b": "than expected by chance",
    r"\bthe surest\b": "the most certain",
    r"\bless sure\b": "less certain",
    r"\blook(s|ed)? for company\b": "name the search",
    r"\bmeans? nothing\b": "is undefined",
    r"\bcannot be right\b": "is inconsistent",
    r"\bfix(es)? no\b": "does not determine",
    r"\bmade use of\b": "used",
    r"\bhalf done\b": "incomplete",
    r"\bwhom each is of\b": "the landmark of each",
    r"\blies? to one another\b": "relative location",
    r"\bwhat came out\b": "the result",
    r"\btell (whether|what|which|where)\b": "return, show",
    r"\btells (nothing|something|whether|which|how|where|when)\b": "shows",
    r"(?<!`)\bbelieved?\b": "accept, use",
    r"\bhangs? on\b": "depend on",
    r"\bheld against\b": "compared with",
    r"\bround and round\b": "repeatedly",
    r"\bas (far as )?it deserves\b": "by its noise",
    r"\bwhat (comes|became) of\b": "the result of",
    r"\bwho comes\b": "in which order",
    r"\b(a|one) thing\b": "an object",
    r"(?<!there )\b(is|are) no (?!longer|farther|more|worse|better|other|nearer)\w+": "is not a",
    r"\bdoes not grow\b": "does not increase",
    r"\bhow far it is\b": "the progress",
    r"\bin plainer words\b": "clearer",
    r"\bof (its|their) own\b": "separate",
    r"\b(the|a|its|before|Return) begin\b|\bbegin of\b": "start, beginning",
    r"\b(Begin|begin|begins) and (end|stop)s? (point|of|along)": "start and end",
    r"\bfrom which on\b": "above which",
    r"\b(within|at most|at least|after|with) so many\b": "name the number",
    r"\bstands? free\b|\bfree-standing things\b": "free-standing objects",
    r"\bknown (worst|best)\b": "least certain, most certain",
    r"\bunsharp\b": "blurred",
    r"\b(are|is) weighed by\b|\"Weighs\b": "weighted, weights",
    r"\"Enter (the|a|which|rows|rotation|landmarks|into)\b": "write, insert, add",
    r"\bwhat would be right\b": "what is expected",
    r"\bnow and then\b": "occasionally, at intervals",
    r"\b(round|straight) way\b": "path",
}
"""What is banned, as a regular expression, and what to write instead."""
DOCUMENTS = ["README.md", "ARCHITECTURE.md", "CONTRIBUTING.md"]
DOCUMENTS += sorted(f"docs/{path.name}" for path in (ROOT / "docs").glob("*.md"))
SOURCES = sorted(
    path.relative_to(ROOT).as_posix()
    for folder in ("relmap", "benchmarks", "examples", "tests")
    for path in (ROOT / folder).rglob("*.py")
    if path != Path(__file__)
)


def words_of(source: str) -> Iterator[str]:
    """Yield comments, docstrings and messages of Python code, and the names of tests."""
    kinds = {tokenize.COMMENT, tokenize.STRING, getattr(tokenize, "FSTRING_MIDDLE", -1)}
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type in kinds:
            yield token.string
        elif token.string.startswith("test_"):
            yield token.string.replace("_", " ")


def found_in(text: str) -> list[str]:
    plain = re.sub(r"\s+(# )?", " ", text)
    return [
        f"{match[0]!r}: {instead}"
        for phrase, instead in BANNED.items()
        for match in re.finditer(phrase, plain, re.IGNORECASE)
    ]


def test_a_banned_phrase_is_found() -> None:
    assert found_in("What cannot\n    be meant raises an error.")
    assert not found_in("Impossible values raise an error.")


@pytest.mark.parametrize("name", DOCUMENTS)
def test_documents_are_in_plain_english(name: str) -> None:
    assert found_in((ROOT / name).read_text(encoding="utf-8")) == []


def test_unreleased_changes_are_in_plain_english() -> None:
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    unreleased = text.partition("\n## Unreleased\n")[2].partition("\n## ")[0]
    assert found_in(unreleased) == []


@pytest.mark.parametrize("name", SOURCES)
def test_code_is_in_plain_english(name: str) -> None:
    words = " ".join(words_of((ROOT / name).read_text(encoding="utf-8")))
    assert found_in(words) == []
