"""Real flights with known causes: splits, counting and peers on made-up flights, and the page where the real ones are there."""

import csv
import json
import re
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from test_convert import usd_event, write_usd
from test_page_writers import NUMBER
from tinykoop.diagnose.platforms.quadrotor import causes, features
from tinykoop.diagnose.platforms.quadrotor.causes import SLUNG
from tinykoop.experiments import flights as command
from tinykoop.experiments.flights import answers, data, page, peers
from tinykoop.experiments.flights.answers import Answer
from tinykoop.plumbing import pages
from tinykoop.plumbing.errors import UserError

ROOT = Path(__file__).resolve().parents[2]
REAL = ROOT.parent / "shared/data/crazyflie"
DT, ROWS, MEAN = 0.02, 400, 0.6
R1, R2, R3, R4 = map(causes.rotor, (1, 2, 3, 4))
LABELS = {
    "none": ("none", "", ""), "cut": ("rotor", "M3", "6"), "slight": ("rotor", "M3", "1"), "pair": ("rotor", "M1+M2", "4+5.5"),
    "weight": ("payload", "M4", "W1"), "tape": ("tape", "M3", ""), "hung": (SLUNG, "M3", "W2"),
}  # fmt: skip
RAISED = {
    "none": (0, 0, 0, 0), "cut": (0, 0, 0.14, 0), "slight": (0, 0, 0.004, 0), "pair": (0.11, 0.12, 0, 0),
    "weight": (0.02, 0.02, 0.03, 0.09), "tape": (0, 0, 0, 0), "hung": (0.02, 0.02, 0.06, 0.02),
}  # fmt: skip


def made(name, kind, vehicle="E8", seed=0, raised=None, size=None):
    """A steady flight of a kind of LABELS; its mean requests differ by 0.002 from flight to flight."""
    rng = np.random.default_rng(seed)
    mean = MEAN + np.array(RAISED[kind] if raised is None else raised) + 0.002 * rng.standard_normal(4)
    u = np.column_stack([mean + 0.02 * rng.standard_normal((ROWS, 4)), np.full(ROWS, 3.5)])
    x = np.full((ROWS, len(features.STATES)), np.nan)
    x[:, peers.MOTION] = 0.1 * rng.standard_normal((ROWS, 5))
    family, rotors, usual = LABELS[kind]
    log = SimpleNamespace(t=DT * np.arange(ROWS), x=x, u=u, usable=np.ones(ROWS - 1, bool), dt=DT, path=name)
    return data.Flight(name, vehicle, family, rotors, size or usual, log)


@pytest.fixture(scope="module")
def flights():
    """Two sessions of healthy flights and two flights of each other kind."""
    healthy = [made(name, "none", seed=k) for k, name in enumerate(("d021", "d022", "d023", "d024"))]
    return healthy + [made(f"{kind}{k}", kind, seed=10 * k + len(kind)) for kind in list(LABELS)[1:] for k in (1, 2)]


def write(folder, flights):
    """Flights as the data set has them: labels.csv, and a uSD log each."""
    (folder / "flights").mkdir(parents=True)
    with open(folder / "labels.csv", "w", newline="") as file:
        lines = csv.writer(file)
        lines.writerow(data.FIELDS)
        lines.writerows([f"{f.name}.usd", f.vehicle, f.family, f.rotors, f.size] for f in flights)
    for f in flights:
        columns = {f"motor.m{i + 1}": 65535 * f.log.u[:, i] for i in range(4)} | {"pm.vbatMV": 1000 * f.log.u[:, 4]}
        columns |= {f"stateEstimate.{name}": x for name, x in zip(("vx", "vy", "vz"), f.log.x[:, peers.MOTION].T)}
        columns |= {f"stateEstimate.{name}": np.degrees(x) for name, x in zip(("roll", "yaw"), f.log.x[:, peers.MOTION[3:]].T)}
        write_usd(folder / "flights" / f"{f.name}.usd", [usd_event(f.log.t, columns)])
    return folder


# ---- labels and splits -----------------------------------------------------------------------------


def test_labels_say_what_acts_where_and_what_must_be_found(flights):
    by = {f.name: f for f in flights}
    assert by["pair1"].cut == {1: 4.0, 2: 5.5} and by["pair1"].truth == {R1, R2} and by["pair1"].asks == "pair"
    assert by["cut1"].truth == {R3} and by["cut1"].asks == "rotor" and by["slight1"].asks is None and by["tape1"].asks is None
    assert by["weight1"].truth == by["hung1"].truth == {causes.PAYLOAD, SLUNG} and by["hung1"].at == (3,)
    assert made("a", "pair", size="1+2").asks is None and made("a", "pair", size="2+2").asks == "pair"
    assert by["d021"].truth == set() and by["d021"].asks == "healthy" and by["cut1"].condition == "E8, rotor M3, 6 mm"


def test_a_healthy_flight_is_never_compared_with_its_own_session(flights):
    assert [f.name for f in flights[0].healthy(flights)] == ["d023", "d024"]
    assert [f.name for f in flights[2].healthy(flights)] == ["d021", "d022"]


def test_a_changed_flight_is_compared_with_all_healthy_flights_of_its_vehicle(flights):
    other = made("other", "none", "E9")
    assert [f.name for f in flights[-1].healthy([*flights, other])] == ["d021", "d022", "d023", "d024"]


def test_where_a_vehicle_has_one_session_only_the_flight_itself_is_left_out():
    single = [made(name, "none", "E9") for name in ("d025", "d026", "d027")]
    assert [f.name for f in single[1].healthy(single)] == ["d025", "d027"]
    both = [made("d021", "none"), made("d022", "none")]
    assert [f.name for f in both[0].healthy(both)] == ["d022"]


# ---- counting --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "kind, named, declared, right, near",
    [
        ("none", (), (), True, True), ("none", (R2,), (), False, False),
        ("cut", (R3,), (causes.PAYLOAD,), True, True), ("cut", (causes.PAYLOAD,), (R3,), False, True), ("cut", (), (), False, False),
        ("pair", (R1,), (R3, R2), True, True), ("pair", (R1, R3), (), False, False), ("pair", (R1, R2), (R3, R4), False, True),
        ("weight", (R4,), (causes.PAYLOAD,), True, True), ("weight", (R4,), (), False, True), ("weight", (SLUNG,), (), True, False),
        ("hung", (causes.PAYLOAD,), (SLUNG, R3), True, True),
    ],
)  # fmt: skip
def test_an_answer_is_right_as_the_requirement_has_it(kind, named, declared, right, near):
    flight, answer = made("a", kind), Answer(named, declared)
    assert (answers.right(flight, answer), answers.near(flight, answer)) == (right, near)


@pytest.mark.parametrize(
    "kind, named, confidence, wrong",
    [
        ("cut", (R3,), 0.95, False), ("cut", (R3, R1), 0.95, True), ("cut", (), 0.95, True), ("cut", (R1,), 0.85, False),
        ("none", (), 0.99, False), ("none", (R1,), 0.99, True), ("hung", (causes.PAYLOAD,), 0.99, False), ("slight", (), 0.99, True),
        ("cut", (R1,), None, False),
    ],
)  # fmt: skip
def test_overconfidence_is_counted_strictly(kind, named, confidence, wrong):
    assert answers.sure_and_wrong(made("a", kind), Answer(named, (), confidence)) == wrong


def loses(size, a):
    named = [] if a is None else [{"name": R3, "params": {"a": (a, [a - 0.03, a + 0.02])}}]
    return {"vehicle": "E8", "family": "rotor", "rotors": "M3", "size": size, "named": named}


def test_the_loss_of_a_rotor_that_is_not_named_is_zero():
    assert answers.loss(loses("1", None), 3) == (0, 0, 0) and answers.loss(loses("6", -0.2), 1) == (0, 0, 0)
    assert answers.loss(loses("6", -0.2), 3) == pytest.approx((0.2, 0.18, 0.23))


def test_rank_correlation_is_that_of_ranks():
    """By the formula without ties, 1 - 6 sum d^2 / (n (n^2 - 1)), for ranks 1 2 3 4 against 1 3 2 4."""
    rows = [loses(size, a) for size, a in (("1", None), ("3", -0.1), ("4", -0.05), ("6", -0.2))]
    other = loses("8", None) | {"vehicle": "E9"}
    assert answers.rank_correlation([*rows, other]) == pytest.approx(1 - 6 * 2 / (4 * 15))
    assert answers.rank_correlation(rows[:1]) is None


def test_a_change_without_a_cause_is_wrong_for_a_healthy_flight_and_for_any_other():
    unknown = Answer((), (R3,), None, unknown=True)
    assert not answers.right(made("a", "none"), unknown) and not answers.near(made("a", "none"), unknown)
    assert not answers.right(made("a", "cut"), unknown) and answers.near(made("a", "cut"), unknown)


# ---- sensitivity -----------------------------------------------------------------------------------


def test_a_larger_prior_of_one_weak_rotor_makes_it_more_probable_and_is_taken_back(flights):
    cut = next(f for f in flights if f.name == "slight1")

    def probability():
        return dict(answers.changes(cut, flights[:4]).ranking())[R3]

    before = probability()
    with answers.single_prior(2.0):
        more = probability()
    with answers.single_prior(0.5):
        less = probability()
    assert less < before < more and probability() == before


def test_answers_that_another_constant_changes_are_counted(flights, monkeypatch):
    some = [f for f in flights if f.name in ("d021", "cut1", "slight1")]
    said = {"d021": Answer((), ()), "cut1": Answer((R3,), (causes.PAYLOAD,)), "slight1": Answer((), ())}
    other = said | {"d021": Answer((R1,), ()), "cut1": Answer((R3,), (R4,))}
    monkeypatch.setattr(answers, "variants", lambda flights: [("this", other), ("cut alone", {"cut1": Answer((R3,), ())})])
    assert answers.sensitivity(some, said) == [("this", 3, 1, 2, 2, 2, 1), ("cut alone", 1, 0, 1, 1, 1, 1)]


# ---- peers -----------------------------------------------------------------------------------------


def test_the_nearest_healthy_mean_names_the_rotor_that_asks_for_more(flights):
    found = peers.run(flights, ["nearest healthy mean"])["nearest healthy mean"]
    assert found["cut1"].named == (R3,) and {*found["pair2"].said} >= {R1, R2} and not found["d021"].named


def steps(name, coefficients, kind="none"):
    """A flight whose vertical speed follows the requests with these coefficients (4,)."""
    flight, rng = made(name, kind, seed=len(name)), np.random.default_rng(5)
    noise = 0.001 * rng.standard_normal(ROWS - 1)
    flight.log.x[1:, features.STATES.index("vz")] = (flight.log.u[:-1, :4] - MEAN) @ coefficients + noise
    return flight


@pytest.mark.parametrize("rotor", [0, 1, 2, 3])
def test_one_step_least_squares_sees_the_rotor_whose_coefficient_differs(rotor):
    weak = np.where(np.arange(4) == rotor, 0.5, 1.0)
    healthy = [steps("a", np.ones(4)), steps("bb", np.ones(4))]
    scores = peers.departure(steps("ccc", weak, "cut"), healthy)
    assert scores.argmax() == rotor and scores.max() > 3 * np.sort(scores)[-2]


FEW = ("d021", "d023", "cut1", "slight1", "pair1")  # enough for the whole command


def needs(peer):
    return pytest.param(peer, marks=pytest.mark.skipif(peer == "gradient boosting" and not find_spec("sklearn"), reason="no scikit-learn"))


@pytest.mark.parametrize("peer", [needs(peer) for peer in peers.PEERS])
@pytest.mark.parametrize("name, friend", [("cut1", "cut2"), ("d021", "d022")])
def test_what_a_peer_says_does_not_depend_on_flights_of_the_same_condition_or_session(flights, peer, name, friend):
    flight = next(f for f in flights if f.name == name)
    odd = [
        made(f.name, "none" if f.family == "none" else "cut", seed=9, raised=(0.3, 0, 0, 0.2)) if f.name == friend else f for f in flights
    ]
    assert peers.PEERS[peer](flight, flights) == peers.PEERS[peer](flight, odd)


def test_gradient_boosting_names_a_cause_that_another_condition_has():
    pytest.importorskip("sklearn", reason="no scikit-learn")
    flights = [made(f"h{k}", "none", seed=k) for k in range(6)] + [made(f"w{k}", "weight", seed=k + 20) for k in range(4)]
    flights += [made(f"c{k}", "cut", seed=k + 30) for k in range(4)]
    other = made("other", "cut", seed=50, size="5")
    answer = peers.boosting(other, [*flights, other])
    assert answer.named == (R3,) and answer.confidence > 0.5


# ---- the command -----------------------------------------------------------------------------------


def test_the_command_writes_what_is_said_of_each_flight(flights, tmp_path, tinykoop_in):
    write(tmp_path / "data", [f for f in flights if f.name in FEW])
    done = tinykoop_in(tmp_path, "flights", "--data", "data", "--out", "out")
    assert done.returncode == 0, done.stderr
    result = json.loads((tmp_path / "out/flights.json").read_text())
    rows = {row["flight"]: row for row in result["flights"]}
    assert [cause["name"] for cause in rows["cut1"]["named"]] == [R3] and causes.PAYLOAD in rows["cut1"]["declared"]
    _, (low, high) = rows["cut1"]["named"][0]["params"]["a"]
    assert low < MEAN / (MEAN + RAISED["cut"][2]) - 1 < high
    assert not rows["d021"]["named"] and rows["d021"]["right"] and rows["slight1"]["right"] is None
    assert {*result["answers"]} >= {"tinykoop", "nearest healthy mean", "one-step least squares"}
    assert (tmp_path / "out/flights.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    "change, said",
    [
        (lambda folder: (folder / "labels.csv").unlink(), "data/labels.csv: cannot be read (No such file or directory); name the folder"),
        (lambda folder: (folder / "labels.csv").write_text("flight,vehicle\nd021.usd,E8\n"), "needs the columns flight, vehicle, family"),
        (lambda folder: (folder / "flights/d021.usd").unlink(), "d021.usd: no such file"),
        (lambda folder: (folder / "labels.csv").write_text("flight,vehicle,family,rotors,size\nd021.usd,E8,none,,\n"), "no healthy flight of"),
        (lambda folder: write_usd(folder / "flights/d021.usd", [usd_event(np.arange(9), {"motor.m1": np.ones(9)})]), "motor.m2"),
        (lambda folder: (folder / "labels.csv").write_text("flight,vehicle,family,rotors,size\nd021.usd,E8,rotor,three,6\n"), "rotors 'three'"),
        (lambda folder: (folder / "labels.csv").write_text("flight,vehicle,family,rotors,size\nd021.usd,E8,rotor,M3,much\n"), "size 'much'"),
        (lambda folder: (folder / "labels.csv").write_text("flight,vehicle,family,rotors,size\nd021.usd,E8,bird,M3,1\n"), "family 'bird'"),
    ],
)  # fmt: skip
def test_a_bad_folder_is_refused_with_one_line(flights, tmp_path, tinykoop_in, change, said):
    change(write(tmp_path / "data", flights[:2]))
    done = tinykoop_in(tmp_path, "flights", "--data", "data")
    assert done.returncode == 2 and done.stderr.count("\n") == 1 and said in done.stderr


def test_without_scikit_learn_its_peer_is_left_out_and_no_page_is_written(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(command, "find_spec", lambda name: None)
    assert command._peers(update=False) == ("nearest healthy mean", "one-step least squares")
    assert "requirements-peers.txt" in capsys.readouterr().out
    with pytest.raises(UserError, match="flights --update: the peers need scikit-learn"):
        command.run(tmp_path, tmp_path, update=True)


def test_tables_have_one_number_per_cell(flights):
    flights = [f for f in flights if f.name in FEW]
    rows, said = answers.rows(flights)
    tables = page.tables(flights, rows, answers.holds(flights, rows, said), {"tinykoop": said}, [("this", 3, 1, 2, 2, 2, 1)])
    for title, headers, lines in tables.values():
        assert lines and all(len(line) == len(headers) for line in lines)
        assert all(len(NUMBER.findall(str(cell))) <= 1 for line in lines for cell in line[1:])


# ---- the real flights ------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def real(tmp_path_factory):
    if not REAL.is_dir():
        pytest.skip("the real flights are not there (../shared/data/crazyflie)")
    out = tmp_path_factory.mktemp("real")
    return command.run(out, REAL), json.loads((out / "flights.json").read_text())


def region(name):
    (found,) = re.findall(rf"<!-- flights-{name}: begin.*?-->\n(.*?)<!-- flights-{name}: end -->", (ROOT / page.PAGE).read_text(), re.S)
    return found.strip().splitlines()


def test_the_tables_of_the_page_are_those_of_the_code(real):
    tables, _ = real
    for name, table in tables.items():
        written, now = region(name), pages.table(*table).strip().splitlines()
        missing = [line for line in written if line not in now]
        assert now == [line for line in written if line in now], f"run `make flights UPDATE=1`: {name}"
        assert all(line.startswith("| gradient boosting |") and not find_spec("sklearn") for line in missing), missing


def test_real_flights_with_a_large_change_are_found(real):
    _, result = real
    rows = {row["flight"]: row for row in result["flights"]}
    assert len(rows) == 34 and sum(row["family"] == "none" for row in rows.values()) == 7
    assert all(rows[name]["named"][0]["name"] == R3 and causes.PAYLOAD in rows[name]["declared"] for name in ("d018", "d019", "d020"))
    assert all({R1, R2} <= {c["name"] for c in rows[name]["named"]} | {*rows[name]["declared"]} for name in ("d009", "d010", "d011"))


def test_losses_of_real_flights_are_those_of_the_raised_requests(real):
    """A rotor at the same thrust asks for more by 1 / (1 - loss)."""
    _, result = real
    for row in result["flights"]:
        if row["size"] == "6":
            value, low, high = answers.loss(row, 3)
            assert low < 1 - row["healthy"][2] / row["asked"][2] < high and low < value < high
