"""A truck's promised stop is home: flights between stops, and a home that moves, both autopilots.

The result is judged by truth and by the frames on the link; each check fails in the world of
another test here, where the vehicle ends elsewhere.
"""

import math
from typing import Any

import pytest

pytestmark = pytest.mark.sitl

PADS = {"stop-1": (0.0, 0.0), "stop-2": (-40.0, 60.0), "stop-3": (-90.0, -50.0)}  # east, north
WORLD: dict[str, Any] = {
    "site": {
        "customer": {"name": "customer", "east_m": -120.0, "north_m": 10.0, "up_m": 0.6},
        "rally": [],
        "stops": [
            {"name": name, "east_m": east, "north_m": north, "up_m": -0.005 * east}
            for name, (east, north) in PADS.items()
        ],
        "home": "stop-2",
    },
    "mission": {"cruise_height_m": 20.0, "return_height_m": 26.0, "leg_length_m": 60.0},
    "wind": {"kind": "steady", "speed_mps": 3.0, "from_deg": 70.0},
}


def landed_at(flown) -> str | None:
    """Return the stop on whose pad it is by truth."""
    truth = flown.craft.record
    _, north, east, *_ = truth.rows[-1]
    near = {name: math.dist((east, north), pad) for name, pad in PADS.items()}
    name = min(near, key=lambda stop: near[stop])
    return name if truth.landed_s is not None and near[name] < 5.0 else None


def moved(phase: str, at_s: float, to: str) -> dict[str, Any]:
    return {"kind": "home_moves", "phase": phase, "at_s": at_s, "to": to}


def test_safety_rule_3_home_moves_on_the_way_out_and_again_on_the_way_home(fly_case):
    # PX4; ArduCopter's home moves in test_sitl_next_pad.py.
    moves = [moved("outbound", 1.0, "stop-3"), moved("return", 14.0, "stop-1")]
    flown = fly_case("px4", WORLD | {"faults": moves})
    assert (flown.row["outcome"], landed_at(flown)) == ("SUC", "stop-1")
    rows = flown.craft.record.rows
    dropped_s = next(row[0] for row in rows if row[-1] == 0.0)
    received = flown.craft.operator.received_texts
    told = [(t_s, text) for t_s, text in received if "landing site is now" in text]
    # On the outbound leg the old promise stays; it is void once the autopilot flies elsewhere.
    assert [text for _, text in told] == [f"landing site is now stop-{n}" for n in (3, 1)]
    assert told[0][0] > dropped_s
    # Each leg at its own true height; barometer and gusts change it by about a metre.
    out_m, back_m = (max(-r[3] for r in rows if (r[-1] > 0.0) == loaded) for loaded in (1, 0))
    assert (out_m, back_m) == (pytest.approx(20.0, abs=1.5), pytest.approx(26.0, abs=1.5))


@pytest.mark.drawn(of="autopilot_kind")
@pytest.mark.parametrize("autopilot_kind", ["px4", "ardupilot"])
def test_safety_rule_3_killed_on_the_way_out_it_comes_down_at_the_promised_stop(
    fly_case, autopilot_kind
):
    killed = {"kind": "companion_kill", "phase": "outbound", "at_s": 4.0, "restart": False}
    wish = moved("outbound", 0.5, "stop-3")  # accepted, and void after the companion's end
    flown = fly_case(autopilot_kind, WORLD | {"faults": [wish, killed]})
    assert "will land at stop-3" in flown.said
    assert (flown.row["outcome"], landed_at(flown)) == ("ABRT", "stop-2")
