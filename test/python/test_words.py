"""The project's pages and messages use the terms of the field: a dialect that readers must translate stays out."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
DIALECT = {  # what was written once: what the field says
    r"\banew\b": "again, restarted",
    r"\bere\b": "before",
    r"\bcalled so\b": "recognised as healthy",
    r"\bsure and wrong\b|\bsure \(0\.9": "wrong with confidence of 0.9 or more",
    r"\btold known from\b": "balanced accuracy of known versus unknown",
    r"\bstands there twice\b": "duplicate",
    r"\bfinite numbers\b": "diverged (NaN or Inf)",
    r"\bnothing fitted again\b": "without refitting",
    r"\bdo(?:es)? the same work\b": "explain as much",
    r"\bPARTLY\b|\bNOT TESTABLE\b": "in part, not testable",
    r"\bleast_(?:cosine|gain)\b|\bmost_(?:gain|error|tracking|residual)\b": "min_, max_",
    r"\b\d[\d.,]* (?:a|an) (?:sample|second|cycle|row|step)\b": "per",
}
PLACES = ("*.md", "docs/*.md", "targets/**/*.md", "lib/**/*.[ch]", "host_sim/*.[ch]", "tools/tinykoop/**/*.py", "examples/**/*.[ch]", "Makefile")
FILES = sorted({path for place in PLACES for path in ROOT.glob(place)})


def test_pages_headers_and_messages_are_looked_at():
    assert len(FILES) > 150


@pytest.mark.parametrize("words", DIALECT)
def test_dialect_stays_out(words):
    found = [f"{path.relative_to(ROOT)}: {line.strip()}" for path in FILES for line in path.read_text().splitlines() if re.search(words, line)]
    assert not found, f"write {DIALECT[words]}:\n" + "\n".join(found)
