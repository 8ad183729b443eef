"""SINEX: coordinates with their covariance, with and without the constraints of the solution."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.observations import ControlPoint, Correlated, GnssPosition
from tests.networks.survey_files import SINEX as SMALL
from tests.support.places import data_dir

CORRELATIONS = """+SOLUTION/MATRIX_ESTIMATE L CORR
     1     1  0.20000000000000E-02
     2     1  0.50000000000000E+00  0.10000000000000E-02
     3     3  0.30000000000000E-02
     4     3  0.66666666666667E+00  0.10000000000000E-02
-SOLUTION/MATRIX_ESTIMATE L CORR
"""
COVARIANCE = np.array([[4e-6, 1e-6, 0.0], [1e-6, 1e-6, 0.0], [0.0, 0.0, 9e-6]])


def auspos() -> Path:
    return data_dir("sinex") / "STR1AUSPOS.SNX"


def small(folder: Path, text: str = SMALL, **options: object) -> fga.Network:
    path = folder / "small.snx"
    path.write_text(text, encoding="utf-8")
    return fga.read_sinex(path, **options)  # type: ignore[arg-type]


def matrix(name: str) -> np.ndarray:
    """Return a matrix of the published file, (45, 45), read here by other means."""
    text = auspos().read_text(encoding="utf-8").split(f"+SOLUTION/{name} L COVA\n")[1]
    out = np.zeros((45, 45))
    for line in text.split(f"-SOLUTION/{name}")[0].splitlines():
        if line.startswith(" "):
            i, j, *values = line.split()
            for k, v in enumerate(values):
                out[int(i) - 1, int(j) - 1 + k] = out[int(j) - 1 + k, int(i) - 1] = float(v)
    return out


@pytest.mark.published
def test_adjusting_the_estimates_gives_coordinates_and_covariance_of_the_file() -> None:
    network = fga.read_sinex(auspos(), apriori="keep")
    assert len(network.points) == 15
    solution = fga.adjust(network)
    assert solution.redundancy == 0
    assert solution.point("ALIC").tolist() == pytest.approx(
        [-4052052.96884358, 4212835.95074131, -2545104.26632942], abs=1e-8
    )
    found = solution.covariance(list(network.points))
    np.testing.assert_allclose(found, matrix("MATRIX_ESTIMATE"), rtol=1e-9, atol=1e-20)
    # .135326E-02 and so on: the standard deviations of SOLUTION/ESTIMATE, 0.5 of the last digit.
    np.testing.assert_allclose(
        solution.standard_deviations("ALIC"), [1.35326e-3, 1.27519e-3, 1.09485e-3], atol=6e-9
    )


@pytest.mark.published
def test_estimates_are_those_of_the_measurements_with_the_constraints_of_the_file() -> None:
    """Without the constraints, then with them as observations again: the estimates come back."""
    network = fga.read_sinex(auspos())
    text = auspos().read_text(encoding="utf-8").split("+SOLUTION/APRIORI")[1]
    rows = [r.split() for r in text.split("-SOLUTION/APRIORI")[0].splitlines() if " STA" in r]
    given = np.array([float(r[8]) for r in rows]).reshape(15, 3)
    prior = tuple(
        ControlPoint(name, tuple(at), axes="xyz", sigma=(1.0,) * 3)
        for name, at in zip(network.points, given.tolist(), strict=True)
    )
    alone = fga.adjust(network)
    assert alone.standard_deviations("STR1").min() > 5 * 1.4e-3
    network.add(Correlated(prior, matrix("MATRIX_APRIORI")))
    solution = fga.adjust(network)
    kept = fga.adjust(fga.read_sinex(auspos(), apriori="keep"))
    assert solution.redundancy == 45
    for name in network.points:
        np.testing.assert_allclose(solution.point(name), kept.point(name), rtol=0, atol=1e-7)
    names = list(network.points)
    np.testing.assert_allclose(
        solution.covariance(names), kept.covariance(names), rtol=0, atol=1e-6 * 1.8e-6
    )


@pytest.mark.published
def test_a_solution_is_written_and_read_with_the_same_digits(tmp_path: Path) -> None:
    solution = fga.adjust(fga.read_sinex(auspos()))
    fga.write_sinex(solution, tmp_path / "out.snx", agency="ABC", epoch=2025.9)
    again = fga.adjust(fga.read_sinex(tmp_path / "out.snx"))
    names = list(solution.network.points)
    assert list(again.network.points) == names
    for name in names:
        np.testing.assert_allclose(again.point(name), solution.point(name), rtol=0, atol=6e-9)
    np.testing.assert_allclose(again.covariance(names), solution.covariance(names), rtol=1e-12)
    fga.write_sinex(again.network, tmp_path / "network.snx")
    third = fga.read_sinex(tmp_path / "network.snx")
    for (_, a), (_, b) in zip(third.clusters, again.network.clusters, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12)


def test_other_parameters_leave_and_correlations_have_standard_deviations_on_the_diagonal(
    tmp_path: Path,
) -> None:
    network = small(tmp_path)
    (observed,) = network.observations.values()
    assert isinstance(observed, GnssPosition)
    assert observed.source == "small.snx:5"
    assert observed.value == (4000000.0, 1000000.0, 4800000.0)
    np.testing.assert_allclose(network.clusters[0][1], COVARIANCE, rtol=1e-12)
    begin, end = SMALL.index("+SOLUTION/MATRIX"), SMALL.index("%END")
    by_correlations = small(tmp_path, SMALL[:begin] + CORRELATIONS + SMALL[end:])
    np.testing.assert_allclose(by_correlations.clusters[0][1], COVARIANCE, rtol=1e-9)


def test_information_is_inverted(tmp_path: Path) -> None:
    information = np.linalg.inv(COVARIANCE)
    rows = [
        f"     {i + 1}     {j + 1}  {information[i, j]:.14E}"
        for i in range(3)
        for j in range(i + 1)
    ]
    begin, end = SMALL.index("+SOLUTION/MATRIX"), SMALL.index("%END")
    block = "\n".join(
        ["+SOLUTION/MATRIX_ESTIMATE L INFO", *rows, "-SOLUTION/MATRIX_ESTIMATE L INFO\n"]
    )
    text = SMALL[:begin].replace(SMALL.splitlines()[7] + "\n", "") + block + SMALL[end:]
    np.testing.assert_allclose(small(tmp_path, text).clusters[0][1], COVARIANCE, rtol=1e-9)


def test_standard_deviations_alone(tmp_path: Path) -> None:
    begin, end = SMALL.index("+SOLUTION/MATRIX"), SMALL.index("%END")
    text = SMALL[:begin] + SMALL[end:]
    with pytest.raises(fga.InputError, match="correlations='none' reads"):
        small(tmp_path, text)
    network = small(tmp_path, text, correlations="none")
    np.testing.assert_allclose(np.diag(network.clusters[0][1]), [4e-6, 1e-6, 9e-6], rtol=1e-9)


def test_velocities_move_coordinates_to_an_epoch(tmp_path: Path) -> None:
    line = "     4 VELX   AAAA  A    1 20:001:00000 m/y  2 0.200000000000000E-01 .100000E-02"
    others = [line.replace("     4 VELX", f"     {i} VEL{a}") for i, a in ((5, "Y"), (6, "Z"))]
    text = SMALL.replace(SMALL.splitlines()[7], "\n".join([line, *others]))
    text = text.replace("     4     3  0.20000000000000E-05  0.10000000000000E-05\n", "".join(
        f"     {i}     {i}  0.10000000000000E-05\n" for i in (4, 5, 6)))  # fmt: skip
    moved = small(tmp_path, text, epoch=2030.0)
    (observed,) = moved.observations.values()
    np.testing.assert_allclose(observed.value, [4000000.2, 1000000.2, 4800000.2], atol=1e-9)  # type: ignore[attr-defined]
    np.testing.assert_allclose(np.diag(moved.clusters[0][1]), [1.04e-4, 1.01e-4, 1.09e-4])
    with pytest.raises(fga.InputError, match=r"small\.snx:5: has no velocity"):
        small(tmp_path, epoch=2030.0)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("%=SNX", "SINEX", "small.snx:1: is not SINEX"),
        ("%ENDSNX\n", "", "ends without %ENDSNX"),
        ("+SOLUTION/ESTIMATE", "+SOLUTION/GUESS", "unknown block 'SOLUTION/GUESS'"),
        ("     3 STAZ", "     3 STAW", "small.snx:5: station AAAA has no STAZ"),
        ("     3 STAZ", "     2 STAZ", "small.snx:7: parameter 2 stands in line 6 already"),
        ("0.480000000000000E+07", "0.48x", "small.snx:7: the value: '0.48x' is not a number"),
        ("0.10000000000000E-05  0.10000000000000E-05\n     3", "0.9E-05  0.1E-05\n     3",
         "small.snx:10: SOLUTION/MATRIX_ESTIMATE COVA is not positive definite"),
        ("L COVA\n     1", "L SOMETHING\n     1", "needs L or U and one of CORR, COVA, INFO"),
        ("20:001:00000 m    2 0.48", "tomorrow m    2 0.48", "an epoch is year:day:second"),
        ("     4     3  0.2", "     9     3  0.2", "beyond the 4 estimated"),
        ("     4     3  0.2", "     2     1  0.2", "has element (2, 1) twice"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_told_with_its_line(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    assert old in SMALL
    with pytest.raises(fga.InputError) as caught:
        small(tmp_path, SMALL.replace(old, new, 1))
    assert message in str(caught.value)


def test_what_sinex_cannot_express_is_refused_all_at_once(tmp_path: Path) -> None:
    network = fga.Network("x", frame=fga.GeocentricFrame())
    network.add_point("A LONG NAME", (4e6, 1e6, 4.8e6), fixed="xyz")
    network.add_point("B", (4e6, 1e6, 4.8e6))
    network.add(fga.SlopeDistance("B", "A LONG NAME", 10.0, sigma=0.01))
    with pytest.raises(fga.InputError) as caught:
        fga.write_sinex(network, tmp_path / "no.snx", agency="too long")
    text = str(caught.value)
    for part in ("agency must be", "slope_distance is not an observed position", "point 'B'"):
        assert part in text
    assert not (tmp_path / "no.snx").exists()
    with pytest.raises(fga.InputError, match="must be geocentric or topocentric"):
        fga.write_sinex(fga.Network("local"), tmp_path / "no.snx")


def test_a_topocentric_solution_is_written_geocentric(tmp_path: Path) -> None:
    frame = fga.TopocentricFrame(0.8, 0.2, 300.0)
    network = fga.Network("x", frame=frame)
    network.add_point("AAAA", (100.0, 200.0, 5.0), sigma=(0.001, 0.002, 0.003))
    fga.write_sinex(fga.adjust(network), tmp_path / "a.snx")
    again = fga.adjust(fga.read_sinex(tmp_path / "a.snx"))
    enu = frame.from_geocentric(again.point("AAAA")[None])[0]
    np.testing.assert_allclose(enu, [100.0, 200.0, 5.0], atol=2e-8)
    axes = again.network.frame.basis(again.point("AAAA")[None], np.zeros((1, 2))).enu[0]
    found = axes @ again.covariance("AAAA") @ axes.T
    np.testing.assert_allclose(np.sqrt(np.diag(found)), [0.001, 0.002, 0.003], rtol=1e-3)
