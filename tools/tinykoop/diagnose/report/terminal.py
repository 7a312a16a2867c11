"""A Story on the terminal: the verdict, the tables that matter most, and what the log cannot tell."""

from ...plumbing import results


def say(text="", style=None):
    results.console.print(text, highlight=False, style=style)


def _section(section):
    if section.sentences and section.brief:
        say(f"\n{section.heading}", "bold")
        for sentence in section.sentences[: section.brief]:
            say(f"  {sentence}")


def show(told, page):
    """page: where the HTML is."""
    say()
    say(told.sentence, "bold")
    for aside in told.asides:
        say(f"  {aside}")
    for table in (table for section in told.sections for table in section.tables if table.brief):
        results.print_table(table.caption, table.headers, table.rows)
    for section in told.sections:
        _section(section)
    say(f"\nPage: {page}")
