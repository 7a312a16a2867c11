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
    r"\b(?:tell|tells|told) (?:\w+ ){0,2}apart\b|\b(?:be|is|are|not) told from\b": "distinguish",
    r"\bis not told\b|\bto be told\b": "with sealed labels, does not know",
    r"\bstands there twice\b": "duplicate",
    r"\bfinite numbers\b": "diverged (NaN or Inf)",
    r"\bnothing fitted again\b": "without refitting",
    r"\bdo(?:es)? the same work\b": "explain as much",
    r"\bOn this log these are the same\b": "this log cannot distinguish",
    r"\bPARTLY\b|\bNOT TESTABLE\b": "in part, not testable",
    r"\bleast_(?:cosine|gain|diagonal)\b|\bmost_(?:gain|error|tracking|residual)\b|_(?:MOST|LEAST)\b(?=.*\blib\b)": "min_, max_",
    r"\b\d[\d.,]* (?:a|an) (?:sample|second|cycle|row|step)\b|\brows a second\b|\bnumbers a channel\b|\b(?:logs|flights) a tier\b": "per",
    r"\bin (?:the|its|their) place of\b|\bin its place\b": "instead of",
    r"\blikewise\b": "the same, also",
    r"\ball along\b": "throughout",
    r"\bfor ever\b": "forever",
    r"\b(?:change[ds]?|changes) for good\b": "permanent",
    r"\bas a rule\b": "normally",
    r"\bby nobody\b|\bnobody (?:knows|has|is|to)\b|\bthat nobody\b": "unknown, undetected",
    r"\bcut off\b": "truncated, clipped",
    r"\bcall itself\b": "is recursive",
    r"\bone's own\b": "your own",
    r"\bgo(?:es)? downhill\b|\bway down\b": "decrease the cost, descent",
    r"\b(?:find|begin|continue|follow)_way\b|\bway_(?:down|to_bound)\b|\broom_along\b|\bbent\b": "direction, line search, hessian_direction",
    r"\bgate_(?:regrets|believes|usual|most|strain|begin|settle|watch)\b": "gate_saved_is_better, gate_may_save, gate_variance, ..",
    r"\b(?:is|was|what is) usual\b|\binnovations (?:over what they )?usually are\b": "variance, typical",
    r"\bsums? in two parts\b": "compensated sum",
    r"\bwound up\b|\bgo to sleep\b": "covariance windup, the gain vanishes",
    r"\bhanded over\b|\bhand \w+ over\b": "pass, copy",
    r"\b(?:on|with|in) what (?:was|is|it has) learned\b": "the learned model",
    r"\bnonsense\b": "outlier, sensor fault",
    r"\bharder (?:flags|ones|sets)\b": "more aggressive",
    r"\bcan be no worse than\b|\bwhich is no time\b": "say it with a number",
    r"\b(?:koopf?d?_|KOOP_|tinykoop_|\()[Gg]uard\b|\bKOOP_GUARD|\bunguarded\b|\bmake guard\b": "supervisor",
    r"health(?:\.|->)gated\b(?!` is)|\bgated %|\[\"gated\"\]": "frozen",
}
PLACES = (
    "*.md", "docs/*.md", "targets/**/*.md", "targets/**/*.[ch]", "lib/**/*.[ch]", "host_sim/**/*.[ch]", "tools/tinykoop/**/*.py", "tools/*.py",
    "examples/**/*.[ch]", "examples/**/*.py", "examples/**/*.toml", "arduino/**/*", "zephyr/**/*", "CMakeLists.txt", "Makefile",
)  # fmt: skip
FILES = sorted({path for place in PLACES for path in ROOT.glob(place) if path.is_file()})


def test_pages_headers_and_messages_are_looked_at():
    assert len(FILES) > 150


@pytest.mark.parametrize("words", DIALECT)
def test_dialect_stays_out(words):
    found = [
        f"{path.relative_to(ROOT)}: {line.strip()}" for path in FILES for line in path.read_text().splitlines() if re.search(words, line)
    ]
    assert not found, f"write {DIALECT[words]}:\n" + "\n".join(found)
