"""The command completion: scripts of shells, which bash runs; the command itself loads nothing."""

from __future__ import annotations

import shutil
import subprocess
import sys

import pytest

from factorgraph_adj.cli.command_line import COMMAND_MODULES, main
from factorgraph_adj.cli.shell_completion import SHELLS


@pytest.mark.parametrize("shell", SHELLS)
def test_the_script_of_each_shell_names_every_command(shell, capsys):
    pytest.importorskip("shtab")
    assert main(["completion", shell]) == 0
    script = capsys.readouterr().out
    assert not [name for name in COMMAND_MODULES if name not in script]
    assert "snoop" in script


@pytest.mark.parametrize(
    ("words", "expected", "other"),
    [
        (["pl"], {"plan", "plot"}, "adjust"),
        (["adjust", "--sno"], {"--snoop"}, "--sidak"),
        (["compare", "--method", "b"], {"backward"}, "robust"),
        (["plan", "pro"], {"project.toml"}, "other"),
    ],
)
def test_bash_completes_commands_options_choices_and_files(
    words, expected, other, tmp_path, capsys
):
    pytest.importorskip("shtab")
    if shutil.which("bash") is None:
        pytest.skip("bash is not installed")
    assert main(["completion", "bash"]) == 0
    (tmp_path / "script").write_text(capsys.readouterr().out, encoding="utf-8")
    (tmp_path / "project.toml").touch()
    (tmp_path / "other").touch()
    typed = " ".join(f"'{w}'" for w in ("factorgraph-adj", *words))
    asking = (
        f"source ./script; COMP_WORDS=({typed}); COMP_CWORD={len(words)}; COMPREPLY=(); "
        "$(complete -p factorgraph-adj | sed 's/.*-F \\([^ ]*\\).*/\\1/'); "
        "printf '%s\\n' \"${COMPREPLY[@]}\""
    )
    done = subprocess.run(
        ["bash", "-c", asking], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    found = set(done.stdout.split())
    assert expected <= found, done.stderr
    assert other not in found


def test_without_shtab_the_message_names_the_extra(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "shtab", None)
    monkeypatch.setattr("factorgraph_adj.cli.shell_completion.find_spec", lambda name: None)
    assert main(["completion", "bash"]) == 2
    assert 'pip install "factorgraph_adj[completion]"' in capsys.readouterr().err


def test_the_command_starts_without_shtab():
    code = (
        "import sys; from factorgraph_adj.cli.command_line import command_parser; "
        "command_parser(); print('shtab' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
