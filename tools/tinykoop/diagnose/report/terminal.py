"""A Story on the terminal: the verdict, tables, and what the log cannot tell."""

from ...plumbing.results import print_table
from ..words import say

QUIET = ("Where and when", "The log and its noise")  # are for the page


def show(told, page):
    say()
    say(told.sentence, "bold")
    for aside in told.asides:
        say(f"  {aside}")
    for section in told.sections:
        if section.heading not in QUIET:
            for caption, headers, rows in section.tables:
                print_table(caption, headers, rows)
    for section in told.sections:
        if section.heading == "What this log cannot tell":
            say(section.heading, "bold")
            for sentence in section.sentences:
                say(f"  {sentence}")
    say(f"\nPage: {page}")
