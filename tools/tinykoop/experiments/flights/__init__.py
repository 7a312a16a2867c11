"""Real flights of two Crazyflies whose causes others know: what is said of each, beside peers on the same flights.

The flights are not part of the project. Each is compared with the healthy flights of its own vehicle, a healthy one with those of other
sessions.
"""

from importlib.util import find_spec
from pathlib import Path

from ...plumbing import checkout
from ...plumbing.errors import UserError
from ...plumbing.results import console, output_folder, print_table, replacing
from . import answers, data, page, peers

OURS = "tinykoop"


def _peers(update):
    """Names of the peers whose packages are installed; figures of the pages need all of them."""
    if find_spec("sklearn"):
        return tuple(peers.PEERS)
    if update:
        raise UserError(f"flights --update: the peers need scikit-learn: {checkout.install('peers')}")
    console.print(f"Without gradient boosting, which needs scikit-learn: {checkout.install('peers')}", highlight=False)
    return tuple(name for name in peers.PEERS if name != "gradient boosting")


def run(out, folder, update=False):
    """Writes flights.json and flights.png into `out`, and with `update` docs/quadrotor-flights.md; returns {region of the page: table}."""
    out, names = output_folder(out), _peers(update)
    flights = data.load(Path(folder))
    rows, said = answers.rows(flights)
    holds = answers.holds(flights, rows, said)
    found = {OURS: said} | peers.run(flights, names)
    changes = answers.sensitivity(flights, said)
    answered = {who: {name: vars(answer) for name, answer in part.items()} for who, part in found.items()}
    with replacing(out / "flights.json", {"flights": rows, "holds": holds, "answers": answered, "sensitivity": changes}):
        page.draw(out, rows)
    tables = page.tables(flights, rows, holds, found, changes)
    for table in tables.values():
        print_table(*table)
    if update:
        page.write(tables, out)
    return tables
