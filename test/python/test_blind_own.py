"""The blind check of your own robots: what is drawn, how it is sealed and scored."""

import json
import random

import pytest
from tinykoop.blind.own import ROBOTS, campaign, car
from tinykoop.blind.own.plant import Actuator, drive
from tinykoop.plumbing.errors import UserError

LABEL = {"tier": "single", "effects": {"gain:speed": 0.1}, "without": []}


def report(verdict="known", effects=(), also=None):
    """A report with effects [(name, size, confidence)]."""
    listed = [{"name": n, "params": {"a": v}, "params_ci95": {"a": [v - 0.01, v + 0.01]}, "confidence": c} for n, v, c in effects]
    return {
        "report": {"verdict": verdict, "effects": listed, "ranking": [], "ambiguous_with": also or {}, "passes": 90},
        "error": None,
        "seconds": 1.0,
    }


def test_same_seed_gives_the_same_log_and_another_seed_another():
    one, again, other = (campaign.draw(car, "single", seed, 3) for seed in (1, 1, 2))
    assert one == again and one != other


def test_withheld_effects_come_with_what_does_the_same():
    drawn = [campaign.draw(car, "left_out", 1, k)[0] for k in range(len(car.KNOWN))]
    (gain,) = (label for label in drawn if list(label["effects"]) == ["gain:speed"])
    assert {"gain:speed", "parameter:wheelbase", "clock"} <= set(gain["without"])
    assert {name for label in drawn for name in label["effects"]} == set(car.KNOWN)  # each once before any comes again


def test_pairs_are_of_effects_that_do_not_mimic_each_other():
    for k in range(20):
        one, two = campaign.draw(car, "pair", 5, k)[0]["effects"]
        assert two not in car.ALIKE.get(one, ()) and one not in car.ALIKE.get(two, ())


def test_a_plant_without_effects_is_the_same_as_with_effects_of_size_zero():
    none = drive(car, {}, random.Random(4))
    assert none == drive(car, dict.fromkeys(("gain:speed", "lag:steering", "delay:all", "understeer"), 0.0), random.Random(4))


def test_commands_arrive_as_late_as_told():
    way = Actuator({"delay": 0.05}, 0.02, 10.0)
    assert way.act([1.0, 2.0, 3.0, 4.0], 0.0601, 0.002) == 1.0 and way.act([1.0, 2.0, 3.0, 4.0], 0.0721, 0.002) == 2.0


@pytest.mark.parametrize(
    "effects, also, right, sure_wrong",
    [
        ([("gain:speed", 0.1, 0.99)], {}, True, False),
        ([("clock", 0.1, 0.99)], {"clock": ["gain:speed"]}, True, False),
        ([("clock", 0.1, 0.99)], {}, False, True),
        ([("clock", 0.1, 0.8)], {}, False, False),
    ],
)
def test_an_answer_counts_if_it_is_right_or_said_to_be_ambiguous(effects, also, right, sure_wrong):
    row = campaign.row_of(LABEL, report("known", effects, also))
    assert (row["right"], row["sure_wrong"]) == (right, sure_wrong)


def test_unknown_is_right_only_where_no_effect_of_the_library_acts():
    assert campaign.row_of(LABEL | {"tier": "unknown", "effects": {"understeer": 0.2}}, report("unknown"))["right"]
    assert not campaign.row_of(LABEL | {"tier": "unknown", "effects": {"understeer": 0.2}}, report("partly", [("clock", 0.1, 0.8)]))[
        "right"
    ]
    assert not campaign.row_of(LABEL, {"report": None, "error": "exit status 2", "seconds": 1.0})["right"]


def test_a_campaign_seals_its_labels_and_a_changed_label_is_refused(tmp_path):
    rows = campaign.run(tmp_path, "car", 1, 3, which=("none",))
    assert [row["right"] for row in rows] == [True] and (tmp_path / "blind_car.png").exists()
    work = tmp_path / "blind_car"
    assert [row["verdict"] for row in campaign.again(work)] == ["none"]
    labels = json.loads((work / "labels.json").read_text())
    labels["0000"]["tier"] = "unknown"
    (work / "labels.json").write_text(json.dumps(labels))
    with pytest.raises(UserError, match="sealed"):
        campaign.again(work)


def test_every_robot_says_what_the_campaign_needs():
    for plant in ROBOTS.values():
        assert (campaign.EXAMPLES / plant.FILE).exists() and plant.KNOWN and plant.UNKNOWN
        assert not set(plant.KNOWN) & set(plant.UNKNOWN)
