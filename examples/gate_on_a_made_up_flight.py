"""Ask the return budget: may a loaded vehicle fly on, in this wind, with so much energy left?

A straight delivery 900 m to the west in three legs, asked before the first. The wind blows to the
west: cheap on the way out, dear on the way home. Run it from a checkout or an installed package:

    python examples/gate_on_a_made_up_flight.py
"""

from itertools import pairwise

import numpy as np

from companion.adapters.files.params import read_airframe, read_wind_process
from companion.core.return_budget.budget import (
    Gate,
    GateParams,
    RemainingMission,
    ReturnRoute,
    Stage,
)
from companion.core.routing.leg_energy import Leg, LegKind, RouteEnergy
from companion.core.vehicle.energy_ledger import EnergyBelief
from companion.core.wind.estimator import WindBelief
from companion.core.wind.forecast import WindOutlook

HEIGHT_M, PARCEL_KG, FULL_WH = 40.0, 0.6, 118.0
POINTS_M = (0.0, 300.0, 600.0, 900.0)  # west of the depot


def at(west_m: float, up_m: float = HEIGHT_M) -> tuple[float, float, float]:
    """A place as north, east, down."""
    return (0.0, -west_m, -up_m)


def return_route(west_m: float, payload_kg: float) -> ReturnRoute:
    """Back to the depot and down."""
    back = Leg(LegKind.CRUISE, at(west_m), at(0.0), payload_kg)
    land = Leg(LegKind.LAND, at(0.0), at(0.0, 0.0), payload_kg)
    return ReturnRoute("depot", (back, land) if west_m > 0.0 else (land,))


def mission() -> RemainingMission:
    """Three legs out, each with a way home from its end, then the drop."""
    stages = [
        Stage((Leg(LegKind.CRUISE, at(a), at(b), PARCEL_KG),), (return_route(b, PARCEL_KG),))
        for a, b in pairwise(POINTS_M)
    ]
    far = POINTS_M[-1]
    drop = (
        Leg(LegKind.DESCEND, at(far), at(far, 6.0), PARCEL_KG),
        Leg(LegKind.HOVER, at(far, 6.0), at(far, 6.0), PARCEL_KG, 6.0),
    )
    climb = Leg(LegKind.CLIMB, at(far, 6.0), at(far), 0.0)
    home = ReturnRoute("depot", (climb, *return_route(far, 0.0).leg_sequence))
    return RemainingMission(
        (return_route(0.0, PARCEL_KG),), (*stages, Stage(drop, (home,), delivers=True))
    )


def main() -> None:
    """A table over wind and energy."""
    route_energy = RouteEnergy(read_airframe("m100"))
    gate = Gate(route_energy, GateParams(max_loss=0.01, reserve_wh=0.15 * FULL_WH))
    process = read_wind_process("coast")
    print("wind m/s  left Wh  P(home)  P(success)  margin Wh  the gate")
    for wind_mps in (2.0, 8.0, 12.0):
        belief = WindBelief(300.0, np.array([0.0, -wind_mps]), 0.5**2 * np.eye(2), ("tilt",), True)
        outlook = WindOutlook(process)
        outlook.update_from_estimate(belief)
        for left_wh in (75.0, 62.0, 58.0):
            energy = EnergyBelief(300.0, left_wh, 2.0, FULL_WH, "made up")
            seen = gate.assess(mission(), belief, outlook, energy)
            print(
                f"{wind_mps:8.0f} {left_wh:8.0f} {seen.p_home:8.3f} {seen.p_success:11.3f}"
                f" {seen.margin_wh:+10.1f}  {'turn back' if seen.turn_back else 'fly on'}"
            )


if __name__ == "__main__":
    main()
