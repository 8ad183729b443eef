"""The version is that of pyproject.toml, and none in a source tree that is not installed."""

from __future__ import annotations

import importlib
import importlib.metadata
import tomllib
from collections.abc import Iterator

import pytest

import factorgraph_adj.version as module
from tests.support.places import ROOT


@pytest.fixture
def read_again() -> Iterator[None]:
    """Afterwards the module has the version again."""
    yield
    importlib.reload(module)


def test_it_is_that_of_the_project_file() -> None:
    with open(ROOT / "pyproject.toml", "rb") as file:
        assert module.__version__ == tomllib.load(file)["project"]["version"]


def test_a_source_tree_has_none(read_again: None, monkeypatch: pytest.MonkeyPatch) -> None:
    def version(name: str) -> str:
        raise importlib.metadata.PackageNotFoundError(name)

    with monkeypatch.context() as patched:
        patched.setattr(importlib.metadata, "version", version)
        importlib.reload(module)
    assert module.__version__ == ""
