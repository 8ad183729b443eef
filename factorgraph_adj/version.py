"""The version of this package, which only pyproject.toml defines."""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("factorgraph_adj")
except PackageNotFoundError:
    __version__ = ""
"""Version of the installed package; empty in a source tree that is not installed."""
