"""What the programs of 1980 did: each gives results, and those that are one another agree."""

from __future__ import annotations

import numpy as np
import pytest

from examples.papers.methods_1980 import Table3, run_methods
from examples.papers.methods_1980_block import simulated_block
from examples.papers.programs_1980 import PROGRAMS, main, run_programs

EACH = {
    "ALBANY": "models beside photos",
    "GIANT": "weighted bundle",
    "STEREO": "models",
    "SAPGO-mfl": "two cameras",
    "MUSAT": "data snooping",
    "URELO": "large units",
    "SURBAT": "data snooping and self-calibration",
    "LOSAT LOBAT": "trajectories",
    "TPA": "resections",
    "PAT-M4": "plan",
    "PAT-M43-APR-STATOS-LAKE": "auxiliary heights",
    "PAT-B": "bundle",
    "HVB": "polynomials",
    "SPACE-M": "auxiliary tilts",
    "BATT-SAP": "affine models",
    "EMMBA": "additional parameters",
    "BUNDLE": "quasi-observations",
}
"""A program for each distinct computation; PAT-M43 is method 19, which a slow test runs."""


@pytest.fixture(scope="module")
def table() -> Table3:
    return run_programs(simulated_block(), names=EACH)


def errors(table: Table3, name: str) -> np.ndarray:
    """Return the errors of a program at check points, metres."""
    return table.of(1 + [p.name for p in PROGRAMS].index(name)).outcome.errors


def rms(table: Table3, name: str) -> np.ndarray:
    """Return the RMS errors of a program in E, N, H, metres."""
    return table.of(1 + [p.name for p in PROGRAMS].index(name)).rms


def test_every_program_of_the_table_is_there_or_says_why() -> None:
    assert len(PROGRAMS) == 28
    assert all((p.run is None) == bool(p.reason) for p in PROGRAMS)


def test_each_distinct_program_gives_results(table: Table3) -> None:
    for row in table.rows:
        assert row.outcome is not None, (row.row.name, row.reason)
        assert row.outcome.r > 100
        assert np.all(row.rms[:2] < 1.0)


def test_cameras_of_two_principal_distances_are_the_block_of_one(table: Table3) -> None:
    """Half the principal distance, coordinates and σ: the same rays with the same weights."""
    single = run_methods(simulated_block(), numbers=[26]).of(26).outcome.errors
    np.testing.assert_allclose(errors(table, "SAPGO-mfl"), single, rtol=0, atol=1e-5)


def test_resected_photos_end_at_the_bundle(table: Table3) -> None:
    np.testing.assert_allclose(errors(table, "TPA"), errors(table, "PAT-B"), rtol=0, atol=1e-5)


def test_strips_as_quasi_observations_need_their_covariance(table: Table3) -> None:
    """Uncorrelated, a strip of seven photos is rigid; its covariance lets it bend."""
    assert np.all(rms(table, "BUNDLE") < 0.4 * rms(table, "URELO"))


def test_snooping_keeps_a_block_without_gross_errors(table: Table3) -> None:
    """Of 1128 and 1309 observations with the right model few are rejected."""
    for name, most in (("MUSAT", 6), ("SURBAT", 6)):
        row = table.of(1 + [p.name for p in PROGRAMS].index(name))
        all_of_them = {"MUSAT": 1132, "SURBAT": 1309}[name]
        assert all_of_them - most <= row.outcome.n <= all_of_them


def test_measured_tilts_hold_heights_better_than_surfaces_of_pressure(table: Table3) -> None:
    assert rms(table, "SPACE-M")[2] < 0.7 * rms(table, "PAT-M43-APR-STATOS-LAKE")[2]


def test_the_command_prints_the_programs_asked_for(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--programs", "PAT-B"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "15 PAT-B: 25 bundle 1120 645 475" in said


def test_what_a_block_lacks_is_said() -> None:
    block = simulated_block()
    bare = type(block)(block.network, block.network)
    found = run_programs(bare, names=["SPACE-M"]).rows[0]
    assert found.outcome is None
    assert found.reason == "the block has no statoscope"


@pytest.mark.slow("plan and height in turn, whose parts have short tests, and all programs at once")
def test_all_programs_are_printed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 0
    said = " ".join(capsys.readouterr().out.split())
    for i, p in enumerate(PROGRAMS, 1):
        assert f"{i} {p.name}: {p.what}" in said
