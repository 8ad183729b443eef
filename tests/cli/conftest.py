"""The command in the process of the tests."""

from tests.support.command import here

__all__ = ["here"]
