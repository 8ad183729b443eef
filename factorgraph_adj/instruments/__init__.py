"""Instruments: lines of text from ports and files become observations of a network.

A line goes through four parts, each of which can be replaced:

========================  =====================================================================
part                      what it is
========================  =====================================================================
`line_sources`            ``source = "tcp://…"``: yields a `ReceivedLine` for each line
`grammars`                ``grammar = "…"``: makes `Reading`s of a line, in SI
`instrument_settings`     [[instrument]] in a site file: names, prisms, heights, σ, air, rules
`instrument`              `Instrument`: applies mapping and rules, makes a `Posting` of each set
========================  =====================================================================

**To add a grammar**: a module of this package with a class that has ``read(line)`` and a
`GrammarRecord` named ``GRAMMAR``; one line in ``GRAMMAR_MODULES`` of `grammars`; see `gsi_online`.
Keyword-only arguments of the class, with annotations and defaults, are further keys of
[[instrument]], which are checked as options of readers are. A grammar of field books reads a line
with the reader's own functions into a `ReadingBook` (`reading_book`). Readings are `Sight`,
`Occupation`, `InstrumentHeight` (total stations), `SensorValues` (temperature, pressure, and any
other sensor), `AntennaPosition` (GNSS, placed in the frame of the network by the mapping), and
`Observed`: observations that the grammar makes itself; the mapping renames their points and posts
them at once. A line that is not of the grammar
raises `InputError`, whole.

**To add a source**: a class with ``lines(stop, health)`` that yields `ReceivedLine` or, about five
times a second, None; one line in ``SOURCES`` of `line_sources`. A message of a broker has its topic
in ``channel``, and what is not text in ``content``.
"""

from .distance_corrections import SensorBoard
from .gnss_positions import AntennaPosition
from .grammars import Grammar, GrammarRecord, grammar_record, grammar_words, register_grammar
from .health import Health, HealthEvent
from .instrument import Instrument
from .instrument_settings import InstrumentSettings, read_instruments
from .line_sources import LineSource, line_source
from .readings import (
    InstrumentHeight,
    Observed,
    Occupation,
    Posting,
    Reading,
    ReceivedLine,
    SensorValues,
    Sight,
)

__all__ = [
    "AntennaPosition",
    "Grammar",
    "GrammarRecord",
    "Health",
    "HealthEvent",
    "Instrument",
    "InstrumentHeight",
    "InstrumentSettings",
    "LineSource",
    "Observed",
    "Occupation",
    "Posting",
    "Reading",
    "ReceivedLine",
    "SensorBoard",
    "SensorValues",
    "Sight",
    "grammar_record",
    "grammar_words",
    "line_source",
    "read_instruments",
    "register_grammar",
]
