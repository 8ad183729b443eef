"""Every test of these runs on both engines."""

from tests.support.engines import engine

__all__ = ["engine"]
