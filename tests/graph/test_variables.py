"""Values of components and values in column order."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from factorgraph_adj.graph.variables import Unknowns
from tests.networks.small_block import small_block


def test_values_return_from_columns_to_components() -> None:
    network = small_block(4)
    network.photos["F1"] = replace(network.photos["F1"], fixed=True)
    unknowns = Unknowns(network)
    seen = 0
    for kind, table in unknowns.tables.items():
        columns = np.arange(table.columns.start, table.columns.stop)
        expected = [unknowns.columns(kind, i) for i in range(len(table.names))]
        np.testing.assert_array_equal(columns, np.concatenate([columns[:0], *expected]))
        by_component = table.of_columns(columns.astype(float))
        for own, values in zip(expected, by_component, strict=True):
            np.testing.assert_array_equal(values[: len(own)], own)
            assert not values[len(own) :].any()
        np.testing.assert_array_equal(table.in_columns(by_component), columns)
        seen += len(columns)
    assert seen == unknowns.n_columns
