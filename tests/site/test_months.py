"""Days of a dam through the whole service are those of the engine, whatever is away or killed."""

import pytest

from tests.benchmarks.site_months import drawn_month, serve_month
from tests.support.sites import storing_in

pytest.importorskip("fastapi")

DAYS = 8


@pytest.mark.slow("epochs and alarms of a served site are those of the engine, with a kill")
def test_days_of_a_dam_are_those_of_the_engine(tmp_path):
    month = drawn_month(3, DAYS)
    with storing_in("sqlite"):
        served = serve_month(tmp_path, month, seed=3, kills=1)  # compares estimates and tests
    assert served.kills == 1 and served.readings > 500
    assert served.raised() == month.raised() != set()
    assert len(served.told) >= len(served.alarms)
