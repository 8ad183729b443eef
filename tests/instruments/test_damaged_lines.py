"""Lines that are damaged on their way: refused, never a fault, and never a change of the state."""

import json
import random

import pytest

import factorgraph_adj as fga
from factorgraph_adj.frames import LocalFrame
from factorgraph_adj.instruments import Instrument, ReceivedLine, read_instruments
from factorgraph_adj.instruments.grammars import grammar_words
from tests.support.damaged_lines import BEGIN, LINES, damaged


def instrument(word):
    table = {"name": "i", "network": "dam", "source": "tcp://h:1", "grammar": word}
    (settings,) = read_instruments([{**table, **LINES[word][1]}], where="site.toml")
    network = fga.Network("dam", frame=LocalFrame())
    return Instrument(settings, network=network)


@pytest.mark.parametrize("word", LINES)
def test_damaged_lines_are_no_fault(word):
    rng = random.Random(word)
    found = instrument(word)
    for number in range(1500):
        for text in LINES[word][0](number % 900):
            line = ReceivedLine(damaged(rng, text), BEGIN + number, number)
            for posting in found.take(line):
                json.dumps(posting.record, allow_nan=False)
    assert found.health.counts["refused"] > 500


@pytest.mark.parametrize("word", ["nmea", "sokkia-set", "gsi-level"])
def test_a_damaged_line_before_each_changes_no_observation(word):
    """Grammars with check sums or with a state from line to line: what is refused has no trace."""
    rng = random.Random(word)
    clean, noisy = instrument(word), instrument(word)
    seen = ([], [])
    for number in range(60):
        for text in LINES[word][0](number):
            received = BEGIN + 60.0 * number
            for found, postings in zip((clean, noisy), seen, strict=True):
                if found is noisy:
                    # A character that is lost at the end is found by all three.
                    found.take(ReceivedLine(text.encode()[: -rng.randrange(1, 4)], received, 1))
                made = found.take(ReceivedLine(text.encode(), received, 1))
                postings += [p.record["observations"] for p in made]
    assert seen[0] == seen[1] and len(seen[0]) >= 59
    refused = noisy.health.counts["refused"] - clean.health.counts["refused"]
    assert refused == 60 * len(LINES[word][0](0))


def test_each_grammar_of_lines_is_here():
    assert set(grammar_words()) - set(LINES) == {"ros"}
