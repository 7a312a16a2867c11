"""Compiler settings compared by estimated cycles: where a recommendation turns, and whether the page follows its table."""

import re

import pytest
from tinykoop.firmware import cycles, settings, targets


@pytest.mark.parametrize(
    "ours, theirs, turn",
    [((100, 300), (200, 200), "2.0"), ((100, 500), (200, 200), "1.5"), ((100, 140), (90, 90), "never"), ((10, 20), (30, 30), "always")],
)
def test_two_settings_are_equal_where_their_lines_cross(ours, theirs, turn):
    assert settings.turns_at(ours, theirs) == turn


def row(setting, target="cortex-m4f", extra=0):
    counts = {("lift", "-"): (1, 1)}
    counts |= {(name, form): (1000 + extra, 1000 + extra) for name in targets.REGULATORS for form in targets.FORMS}
    counts |= {("mpc", kind): (5000, 9000) for kind in ("condense", "cold", "warm")}
    tripled = {key: [(3 * a, 3 * b), (a, b)] for key, (a, b) in counts.items()}
    return {
        "target": target,
        "setting": setting,
        "text": 123,
        "instructions": targets.instructions(counts),
        "cycles": targets.estimated(target, tripled),
    }


def test_a_table_for_each_processor_and_one_where_the_recommendation_turns():
    rows = [row(setting, target) for target in cycles.ESTIMATES for setting in settings.SETTINGS]
    text = settings.markdown(rows)
    assert text.count("| `-Os -ffp-contract=off` | 123 | 1,000 | 3,000 | 1,000 | 5,000 | 15,000 | 5,000 | 9,000 | 27,000 | 9,000 |") == 2
    assert "| `-Os -ffp-contract=off` instead of `-O2 -ffp-contract=off` | never | never | never |" in text


# ---- what the page recommends --------------------------------------------------------------------------


def tables():
    """{target: {setting: {figure: number}}} of the page."""
    text = (targets.ROOT / settings.PAGE).read_text()
    marked = re.search(r"<!-- settings: begin.*?-->(.*?)<!-- settings: end -->", text, re.S)[1]
    found = {}
    for target, table in re.findall(r"\*\*(cortex-\w+): .*?\*\*\n\n(.*?)\n\n", marked + "\n\n", re.S):
        header, _, *lines = [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()]
        numbers = {line[0].strip("`"): [int(cell.replace(",", "")) for cell in line[1:]] for line in lines}
        found[target] = {setting: dict(zip(header[1:], cells)) for setting, cells in numbers.items()}
    return found


def test_the_recommended_settings_take_the_fewest_cycles_at_their_level():
    m4, m7 = tables()["cortex-m4f"], tables()["cortex-m7"]
    off, fast, small = ("-O2 -ffp-contract=off", "-O2 -ffp-contract=fast", "-Os -ffp-contract=off")
    for call in settings.CALLS:
        assert m4[off][f"{call}, VMLA 3"] < min(m4[fast][f"{call}, VMLA 3"], m4[small][f"{call}, VMLA 3"])
        assert m4[off][f"{call}, VMLA 1"] > m4[fast][f"{call}, VMLA 1"]
        for estimate in cycles.ESTIMATES["cortex-m7"]:
            assert m7[fast][f"{call}, {estimate}"] < min(m7[off][f"{call}, {estimate}"], m7[small][f"{call}, {estimate}"])


def test_small_code_takes_more_cycles_for_a_solve_by_every_estimate():
    for target, here in tables().items():
        assert here["-Os -ffp-contract=off"]["code"] < 0.95 * here["-O2 -ffp-contract=off"]["code"]
        assert here["-O3 -ffp-contract=off"]["code"] > 1.1 * here["-O2 -ffp-contract=off"]["code"]
        for call in ("MPC warm", "MPC worst"):
            for estimate in cycles.ESTIMATES[target]:
                o2, os, o3 = (here[f"{level} -ffp-contract=off"][f"{call}, {estimate}"] for level in ("-O2", "-Os", "-O3"))
                assert os > o2 and o3 > 0.95 * o2
