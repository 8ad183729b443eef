"""Processes that tests start, on a machine however busy."""

from __future__ import annotations

HANGS = 900.0
"""Seconds after which a process that has not ended hangs. Tests wait for what happens, never for a
time: this bound only ends a wait for what will never happen."""
