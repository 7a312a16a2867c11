"""What snippets of any language share: which effects of a drive they can do to its commands, in the order in which these act."""

from ...plumbing.errors import UserError


def lines(table, report, path):
    """The lines of a table {effect: line} that the effects of a report need, with their sizes; the table has the order of action."""
    effects = {effect["name"]: effect["params"] for effect in report["effects"]}
    strange = [name for name in effects if name not in table]
    if strange:
        raise UserError(f"{path}: there is no snippet for {', '.join(strange)}; there is one for {', '.join(table)}")
    return [line.format(**effects[name]) for name, line in table.items() if name in effects]


def needed(helpers, lines):
    """The code of helpers {name: code} that some lines call."""
    return [code for name, code in helpers.items() if any(f"{name}(" in line for line in lines)]
