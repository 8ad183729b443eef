"""Messages of site files: all problems at once, in the order of lines, with what would be valid."""

from __future__ import annotations

import re

import pytest

from factorgraph_adj.cli.command_line import main
from factorgraph_adj.errors import InputError
from factorgraph_adj.instruments.line_sources import SOURCE_FORMS, SOURCES
from factorgraph_adj.site.alarm_notices import read_mail_server
from factorgraph_adj.site.site_file import read_site

SITE = '[site]\nname = "Wall"\n[[network]]\nname = "wall"\nproject = "."\n'
"""Five lines in which nothing is wrong."""


def problems(tmp_path, text):
    """Return line and text of each problem of a site file."""
    (tmp_path / "site.toml").write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as error:
        read_site(tmp_path)
    found = [re.fullmatch(r"site\.toml:(\d+)(?:: )?(.*)", str(p)) for p in error.value.problems]
    assert all(found), str(error.value)
    return [(int(m[1]), m[2]) for m in found]


CASES = {
    "a network with a wrong clock": (
        """clock = "reading"
max_ahead = "soon"
[[network]]
name = "b"
project = "."
max_ahead = -1
""",
        [
            (6, "unknown clock 'reading'; valid: machine, readings; did you mean 'readings'?"),
            (7, "max_ahead must be a duration such as '10 min'"),
            (11, "max_ahead must not be negative, not -1"),
        ],
    ),
    "a rule with many mistakes": (
        """[[alarm]]
name = "crest"
network = "wal"
test = "displacment"
points = "D*"
k = 2
n = "three"
false_alarms_per_month = "seldom"
notfy = ["mailto:a@b.org"]
""",
        [
            (8, "no network 'wal'; known: wall; did you mean 'wall'?"),
            (9, "test 'displacment'; valid: displacement, .*silence; did you mean 'displacement'?"),
            (10, "points must be a list of names or patterns of points, such as"),
            (12, "n must be a whole number from 1 to 12, not 'three'"),
            (13, "false_alarms_per_month: 'seldom' is not a number"),
            (14, "unknown key 'notfy'; valid: .*; did you mean 'notify'?"),
        ],
    ),
    "rules after one another, of which one name begins like another": (
        """[[alarm]]
name = "crest of the dam"
size_mm = -1
[[alarm]]
name = "crest"
test = "cusum"
k = 2
n = 3
release = 2
[[alarm]]
name = "crest"
""",
        [
            (8, "1 'crest of the dam': size_mm must be at least 0"),
            (12, "2 'crest': a cusum sums over epochs itself"),
            (14, "2 'crest': release must be greater than 0"),
            (16, "3 'crest': name 'crest' stands twice: it is that of .*2 'crest'"),
        ],
    ),
    "addresses": (
        """[[alarm]]
name = "crest"
notify = ["mailto:a@b.org", "mailto:a", "htps://b.org/x", "c@d.org", "mqtt://b", "https:"]
""",
        [
            (8, r"'mailto:a@b.org' needs a mail server.*\[smtp\] with host and sender"),
            (8, "'mailto:a' is no address of e-mail; valid: mailto:NAME@HOST"),
            (8, "'htps://b.org/…' is no address; valid: mailto:.*; did you mean 'https'?"),
            (8, "'c@d.org' is no address; .*did you mean 'mailto:c@d.org'?"),
            (8, "the topic is missing: mqtt://HOST/TOPIC"),
            (8, "'https:…' is no address; valid: https://HOST/PATH"),
        ],
    ),
    "a mail server": (
        """[[alarm]]
name = "crest"
notify = ["mailto:a@b.org"]
[smtp]
hst = "mail.example.org"
security = "startls"
sender = "site@example.org"
user = "site"
""",
        [
            (9, "host is missing"),
            (10, "unknown key 'hst'; valid: host, .*did you mean 'host'?"),
            (11, "unknown security 'startls'; valid: .*did you mean 'starttls'?"),
            (13, "user and password_env"),
        ],
    ),
    "what is kept": (
        '[retention]\njournal = "400 d"\nanswers = "7 days"\nevents = -3\n',
        [
            (7, "unknown key 'journal'; valid: answers, events, journals; .*'journals'?"),
            (8, "answers must be a duration such as .*, not '7 days'; 'for ever' is valid, too"),
            (9, "events must be greater than zero"),
        ],
    ),
    "an instrument": (
        """[[instrument]]
name = "ts1"
network = "wall"
source = "10.0.0.5:4001"
grammar = "gsi-onlin"
faces = 3
fcaes = 2
station_code = "11"
[instrument.atmosphere]
wavelenth_nm = 658
reference_index = 1.00028
sensor = "wether"
[[instrument]]
name = "weather"
network = "wall"
source = "tcp://10.0.0.6"
grammar = "sensor-lines"
""",
        [
            (9, "'10.0.0.5:4001'; valid: tcp://HOST:PORT, .*did you mean 'tcp://10.0.0.5:4001'?"),
            (10, "unknown grammar 'gsi-onlin'; valid: gsi-online, .*did you mean 'gsi-online'?"),
            (11, "faces must be 1 or 2, not 3"),
            (12, "unknown key 'fcaes'; valid: .*did you mean 'faces'?"),
            (14, "atmosphere: wavelength_nm is missing"),
            (15, "unknown key 'wavelenth_nm'; valid: .*did you mean 'wavelength_nm'?"),
            (17, "no instrument 'wether'; known: ts1, weather; did you mean 'weather'?"),
            (21, "'//10.0.0.6' is no address; valid: tcp://HOST:PORT"),
            (22, "grammar sensor-lines: state sensors, observations or both"),
        ],
    ),
    "options of a grammar": (
        """[[instrument]]
name = "ts1"
network = "wall"
source = "file:ts1.txt"
grammar = "geocom"
[[instrument]]
name = "ts1"
netwrk = "wall"
""",
        [
            (10, "grammar geocom needs the option aims"),
            (11, "network is missing"),
            (11, "source is missing"),
            (11, "grammar is missing"),
            (12, "name 'ts1' stands twice"),
            (13, "unknown key 'netwrk'; valid: .*did you mean 'network'?"),
        ],
    ),
    "silence": (
        """[[alarm]]
name = "quiet"
test = "silence"
points = ["ts2", "ts*"]
after = "soon"
k = 2
[[alarm]]
test = "silnce"
[[instrument]]
name = "ts1"
network = "wall"
source = "file:ts1.txt"
grammar = "gsi-online"
""",
        [
            (9, "no instrument 'ts2'; known: ts1"),
            (10, "after must be a duration"),
            (11, "unknown key 'k'; valid: after, name"),
            (12, "name is missing"),
            (13, "unknown test 'silnce'; valid: .*; did you mean 'silence'?"),
        ],
    ),
    "tables that are not known": (
        '[alarms]\nname = "a"\n[retenton]\njournals = "1 d"\n',
        [
            (6, "unknown table 'alarms'; valid: site, .*did you mean 'alarm'?"),
            (8, "unknown table 'retenton'; .*did you mean 'retention'?"),
        ],
    ),
}
"""What follows `SITE`, and its problems: lines, and texts with .* for what is left out."""


@pytest.mark.parametrize("case", CASES)
def test_all_problems_are_told_in_the_order_of_their_lines(tmp_path, case):
    text, wanted = CASES[case]
    found = problems(tmp_path, SITE + text)
    assert [line for line, _ in found] == [line for line, _ in wanted], found
    for line, what in wanted:
        pattern = re.escape(what).replace(r"\.\*", ".*").replace(r"\\", "")
        assert any(line == at and re.search(pattern, said) for at, said in found), (what, found)


def test_values_that_are_no_tables_are_refused(tmp_path):
    keys = ("site", "network", "alarm", "instrument", "smtp", "retention")
    found = problems(tmp_path, "".join(f"{key} = 3\n" for key in keys))
    assert [line for line, _ in found] == [1, 2, 3, 4, 5, 6]
    for key, (_, said) in zip(keys, found, strict=True):
        assert said.startswith(f"{key} must be ") and f"[{key}]" in said


def test_networks_with_one_name_are_named_by_their_numbers(tmp_path):
    twice = '[[network]]\nname = "wall"\nproject = "."\npolicy = "flga"\nobjects = "D*"\n'
    found = problems(tmp_path, SITE + twice)
    assert [line for line, _ in found] == [7, 9, 10]
    assert "[[network]] 2 'wall': name 'wall' stands twice" in found[0][1]
    assert "valid: accept, flag, reject; did you mean 'flag'?" in found[1][1]


@pytest.mark.parametrize(
    ("table", "mistyped", "meant"),
    [("site", "databse", "database"), ("network", "polcy", "policy")],
)
def test_an_unknown_key_is_answered_with_the_valid_ones(tmp_path, table, mistyped, meant):
    tables = {"site": ['name = "Wall"'], "network": ['name = "wall"', 'project = "."']}
    tables[table].append(f'{mistyped} = "x"')
    lines = ["[site]", *tables["site"], "[[network]]", *tables["network"]]
    ((line, said),) = problems(tmp_path, "\n".join(lines) + "\n")
    assert line == lines.index(f'{mistyped} = "x"') + 1
    assert re.search(f"'{mistyped}'; valid: .*did you mean '{meant}'", said)


def test_an_unknown_key_of_the_mail_server_too():
    table = {"host": "mail.example.org", "sender": "site@example.org", "usr": "site"}
    with pytest.raises(InputError, match=r"'usr'; valid: .*did you mean 'user'"):
        read_mail_server(table, where="site.toml")


def test_check_of_a_project_without_readings_says_what_takes_them(tmp_path, capsys):
    (tmp_path / "project.toml").write_text('name = "wall"\n[files]\npoints = "points.csv"\n')
    (tmp_path / "points.csv").write_text("name,x,y,z,fixed\nA,0,0,0,xyz\n")
    assert main(["check", str(tmp_path)]) == 2
    said = capsys.readouterr().err
    assert "no observations" in said and "`factorgraph-adj serve`" in said


def test_every_source_has_a_form():
    assert SOURCE_FORMS.keys() == SOURCES.keys()
    assert all(form.startswith(f"{scheme}:") for scheme, form in SOURCE_FORMS.items())
