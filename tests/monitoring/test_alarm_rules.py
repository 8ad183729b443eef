"""Rules of alarms: their records, their life, what they say."""

from __future__ import annotations

import numpy as np
import pytest

from factorgraph_adj.errors import InputError
from factorgraph_adj.monitoring.alarm_rules import (
    AlarmRule,
    AlarmState,
    epochs_per_month,
    next_alarm,
    outcome_of,
    rules_named_once,
    sentence_of,
)
from factorgraph_adj.monitoring.raise_rates import AlarmLife
from factorgraph_adj.monitoring.velocity_rates import raisings

RULE = AlarmRule(
    "crest", points=("D*",), size_mm=2.0, life=AlarmLife(2, 3, release=0.5, clear_after=3)
)


def played(values, rule=RULE, size=9.0):
    """Return the changes of an alarm with critical value 10 in epochs 0, 1, …, and its state."""
    state, out = AlarmState(rule.name, "D1"), []
    for epoch, value in enumerate(values):
        state, change = next_alarm(
            state, rule.life, outcome_of(rule, value, 10.0, size, 5.0), epoch
        )
        out.append(change)
    return out, state


def test_the_life_of_an_alarm():
    changes, state = played([11, 9, 9, 11, 11, 2, 2, 3, 1, 2, 11, 1])
    # Two of the last three exceed 10 in epoch 4 alone. 3 is above the release value 10 · 0.5² =
    # 2.5, and 11 is: the count of three calm epochs begins again.
    assert changes == [None] * 4 + ["raised"] + ["continues"] * 7
    assert (state.since, state.calm) == (4, 1)


def test_an_alarm_is_cleared_after_calm_epochs_and_raised_again():
    changes, state = played([11, 11, 1, 1, 1, 11, 11])
    assert changes == [None, "raised", "continues", "continues", "cleared", None, "raised"]
    assert (state.raised, state.since) == (True, 6)


def test_a_size_is_asked_for_beside_the_test():
    assert played([99, 99, 99], size=1.9)[0] == [None, None, None]
    assert played([99, 99], size=2.0)[0] == [None, "raised"]


@pytest.mark.parametrize("life", [AlarmLife(), RULE.life, AlarmLife(3, 5, clear_after=7)])
def test_the_life_is_that_of_the_calibration(life):
    """The alarms of series are raised where those that the rates were counted with are."""
    rng = np.random.default_rng(3)
    t = rng.chisquare(3, (200, 80))
    rule = AlarmRule("any", life=life)
    begun = raisings(t, 5.0, life)
    assert begun.sum() > 50
    for row, flags in zip(t.tolist(), begun, strict=True):
        state = AlarmState("any", "P")
        for i, value in enumerate(row):
            state, change = next_alarm(state, life, outcome_of(rule, value, 5.0, 1.0, 1.0), i)
            assert (change == "raised") == flags[i]


def test_sentences():
    found = outcome_of(RULE, 31.25, 12.0, 4.567, 3.0)
    state = AlarmState("crest", "D1", 7, (True, False, True))
    assert sentence_of(RULE, "D1", "raised", found, state) == (
        "crest: D1 lies 4.57 mm from its place of reference (T 31.2, critical 12.0; beyond it in "
        "2 of the last 3 epochs; stated: 0.1 false alarms per month)"
    )
    parts = zip("xyz", (0.123, -4.5, -0.0451), strict=True)
    told = sentence_of(RULE, "D1", "raised", outcome_of(RULE, 31.25, 12.0, 4.5, 3.0, parts), state)
    assert "D1 lies 4.50 mm (dx +0.12, dy -4.50, dz -0.05) from its place of reference" in told
    assert "still D1 lies" in sentence_of(RULE, "D1", "continues", found, state)
    assert "cleared after 3 epochs" in sentence_of(RULE, "D1", "cleared", found, state)
    shape = AlarmRule("shape", "congruence")
    assert "the reference points changed their shape" in sentence_of(
        shape, "", "raised", found, state
    )


def test_rules_of_records():
    record = {
        "name": "crest",
        "points": ["D*", "E1"],
        "test": "displacement",
        "k": 2,
        "n": 3,
        "false_alarms_per_month": 0.2,
        "size_mm": 3,
    }
    rule = AlarmRule.of_record(record)
    assert rule.life == AlarmLife(2, 3, clear_after=3)
    assert (rule.covers("D17"), rule.covers("E1"), rule.covers("E2")) == (True, True, False)
    assert rule.false_alarms_in(epochs_per_month(3600.0), 3600.0) == pytest.approx(0.2, rel=1e-3)
    assert epochs_per_month(86400.0) == 30


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"test": "displacment"}, "unknown test 'displacment'; valid: .*displacement"),
        ({"points": "D*"}, "points must be a list"),
        ({"false_alarms_per_month": 0}, "false_alarms_per_month must be positive"),
        ({"power": 1.0}, "power must lie between"),
        ({"size_mm": -1}, "size_mm must be at least 0"),
        ({"kk": 2}, "unknown key 'kk'; valid: allowance, .*test"),
        ({"n": "three"}, "n must be a whole number from 1 to 12, not 'three'"),
        ({"clear_after": 1.5}, "clear_after must be a whole number from 1, not 1.5"),
        ({"k": [1]}, r"k must be a whole number from 1 to 12, not \[1\]"),
        ({"release": "low"}, "release: 'low' is not a number"),
        ({"release": 2}, "release must be greater than 0 and at most 1"),
        ({"size_mm": [3]}, "size_mm: "),
        ({"points": [1]}, "points must be a list"),
        ({"points": []}, "points must be a list"),
        ({"test": "cusum", "k": 2, "n": 3}, "a cusum sums over epochs itself"),
        ({"test": "cusum", "allowance": 0}, "allowance must be positive"),
    ],
)
def test_wrong_records_are_refused_with_their_name(change, message):
    with pytest.raises(InputError, match=f"alarm 'crest': {message}"):
        AlarmRule.of_record({"name": "crest"} | change)


def test_all_mistakes_of_a_record_are_told_at_once():
    record = {"name": "crest", "test": "displacment", "n": "three", "k": 2, "release": 0, "kk": 1}
    with pytest.raises(InputError) as error:
        AlarmRule.of_record(record)
    said = [p.what for p in error.value.problems]
    assert len(said) == 4, said  # none about k of n: n is not known
    for word in ("did you mean 'displacement'", "n must be", "release must be", "unknown key 'kk'"):
        assert any(word in what for what in said), (word, said)


def test_a_rule_has_a_name_of_its_own():
    with pytest.raises(InputError, match="name is missing"):
        AlarmRule.of_record({"points": ["D1"]})
    with pytest.raises(InputError, match="alarm 'a': is the name of several rules"):
        rules_named_once([AlarmRule("a"), AlarmRule("b"), AlarmRule("a")])
