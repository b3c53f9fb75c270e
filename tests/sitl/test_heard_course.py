"""The course in a flight's picture, where only the companion's own stream is there to draw from."""

import numpy as np
import pytest

from companion.core.mission.flight_plan import frame_at
from sim_bridge.app.flight.picture import heard_course, true_course

pytestmark = [pytest.mark.sitl, pytest.mark.timeout(120)]


@pytest.mark.parametrize("with_depot", [True, False])
def test_the_course_that_was_heard_is_the_one_that_was_flown(fly_case, with_depot):
    flown = fly_case("px4")
    result = flown.craft.companion.result()
    depot = flown.craft.flight.site.depot if with_depot else None
    heard = heard_course(flown.run_dir / "stream.tlog", result, depot and frame_at(depot))
    true = true_course(flown.craft.record, 0.0)
    assert heard is not None
    times_s = np.arange(2.0, true.end_s - 5.0)
    north_m = np.interp(times_s, heard.t_s, heard.north_m)
    east_m = np.interp(times_s, heard.t_s, heard.east_m)
    off_m = np.hypot(
        north_m - np.interp(times_s, true.t_s, true.north_m),
        east_m - np.interp(times_s, true.t_s, true.east_m),
    )
    assert float(np.median(off_m)) < 8.0  # half a second of flight, and the receiver's error
    assert heard.released_s == pytest.approx(true.released_s, abs=5.0)
    assert heard.end_s == pytest.approx(true.end_s, abs=8.0)
