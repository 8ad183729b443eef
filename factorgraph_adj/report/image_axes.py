"""Sign of y of a camera's files applied to calibrations, significance tests, held values, causes.

The network, its solution and its reliability have y up. Reports change the sign of y, of y0, and
of their residuals, test values, errors and correlations, where the files of a camera have y down.
`factorgraph_adj.report.observation_rows.Row.sign` does this for observations.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..graph.variables import camera_of_calibration
from ..models.unknown_registry import VariableKind
from ..network.network import Network
from ..quality.causes.cause_search import Causes
from ..quality.causes.evidence import Cause
from ..quality.causes.shared_error_tests import GivenValue, SharedErrorTest
from ..quality.parameter_correlations import StrongestCorrelation
from ..quality.parameter_significance import ParameterLabel, Significance, TestedParameter
from ..solve.estimates import CalibrationEstimate
from ..types import Array


def signs_in_files(
    network: Network, kind: VariableKind, name: str, components: tuple[str, ...]
) -> Array | None:
    """Return the factors (n,) from components of an unknown to those shown; None if all are 1."""
    if kind != "calibration":
        return None
    camera = camera_of_calibration(network, name)
    if not camera.y_down_in_files:
        return None
    return np.array([camera.sign_in_files(c) for c in components])


def calibration_in_files(
    network: Network, name: str, estimate: CalibrationEstimate
) -> CalibrationEstimate:
    """Return a calibration in the axes of the files of its camera."""
    sign = signs_in_files(network, "calibration", name, estimate.names)
    if sign is None:
        return estimate
    correlation = estimate.correlation * np.outer(sign, sign)
    return replace(estimate, values=sign * estimate.values, correlation=correlation)


def significance_in_files(network: Network, found: Significance) -> Significance:
    """Return tests and correlations of parameters in the axes of the files of their cameras."""
    return replace(
        found,
        parameters=tuple(_tested(network, p) for p in found.parameters),
        correlations=tuple(
            replace(c, value=_sign(network, c.a) * _sign(network, c.b) * c.value)
            for c in found.correlations
        ),
    )


def _sign(network: Network, label: ParameterLabel) -> float:
    kind, name, component = label
    sign = signs_in_files(network, kind, name, (component,))
    return 1.0 if sign is None else float(sign[0])


def _tested(network: Network, parameter: TestedParameter) -> TestedParameter:
    if _sign(network, parameter.label) > 0:
        return parameter
    return replace(
        parameter,
        value=-parameter.value,
        reference=-parameter.reference,
        orientation=_turned_tie(parameter.orientation),
        point=_turned_tie(parameter.point),
    )


def _turned_tie(tie: StrongestCorrelation | None) -> StrongestCorrelation | None:
    return None if tie is None else replace(tie, correlation=-tie.correlation)


def given_value_in_files(network: Network, value: GivenValue) -> GivenValue:
    """Return the test of a held value in the axes of the files of its camera."""
    sign = signs_in_files(network, value.kind, value.name, value.components)
    if sign is None:
        return value
    return replace(
        value,
        together=_turned(value.together, sign),
        apart=tuple(_turned(e, s) for e, s in zip(value.apart, sign[:, None], strict=True)),
    )


def _turned(found: SharedErrorTest, sign: Array) -> SharedErrorTest:
    return replace(found, error=sign * found.error)


def causes_in_files(network: Network, found: Causes) -> Causes:
    """Return causes in the axes of the files of their cameras."""
    return replace(
        found,
        found=tuple(_cause(network, c) for c in found.found),
        given=tuple(given_value_in_files(network, v) for v in found.given),
    )


def _cause(network: Network, cause: Cause) -> Cause:
    if cause.given is None:
        return cause
    shown = given_value_in_files(network, cause.given)
    return replace(cause, given=shown, error=shown.together.error)
