"""Messages of site files."""

from __future__ import annotations

import pytest

from factorgraph_adj.errors import InputError
from factorgraph_adj.site.alarm_notices import read_mail_server
from factorgraph_adj.site.site_file import read_site


@pytest.mark.parametrize(
    ("table", "mistyped", "meant"),
    [("site", "databse", "database"), ("network", "polcy", "policy")],
)
def test_an_unknown_key_is_answered_with_the_known_ones(tmp_path, table, mistyped, meant):
    tables = {"site": ['name = "Wall"'], "network": ['name = "wall"', 'project = "."']}
    tables[table].append(f'{mistyped} = "x"')
    lines = ["[site]", *tables["site"], "[[network]]", *tables["network"]]
    (tmp_path / "site.toml").write_text("\n".join(lines) + "\n")
    with pytest.raises(InputError, match=f"'{mistyped}'; known: .*did you mean '{meant}'"):
        read_site(tmp_path)


def test_an_unknown_key_of_the_mail_server_too():
    table = {"host": "mail.example.org", "sender": "site@example.org", "usr": "site"}
    with pytest.raises(InputError, match=r"'usr'; known: .*did you mean 'user'"):
        read_mail_server(table, where="site.toml")
