"""Held values on which no observation depends are not given values."""

import factorgraph_adj as fga
from factorgraph_adj.quality.causes.shared_error_tests import given_values


def test_x_and_y_of_a_levelling_network_are_no_given_values():
    network = fga.Network("levelling")
    for z, name in enumerate("ABCD"):
        network.add_point(name, (0, 0, z), fixed="xyz" if name in "AB" else "xy")
    for a, b, value in (("A", "B", 1.0), ("A", "C", 2.0), ("B", "C", 1.001), ("C", "D", 1.0)):
        network.add(fga.HeightDifference(a, b, value, sigma=0.001))
    solution = fga.adjust(network)
    assert [(v.name, v.components) for v in given_values(solution)] == [
        ("A", ("z",)),
        ("B", ("z",)),
    ]
    assert "2 given values held" in fga.text_report(solution)
