"""What the pilot tells everybody about the mission, and what it keeps for a restart."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from companion.core.mission.actions import (
    Assessed,
    EnergyReport,
    Publish,
    SaveCheckpoint,
    WindReport,
)
from companion.core.pilot.checkpoint import Kept, kept_to_dict
from companion.core.pilot.transitions import END_PHASES, FLIGHT_PHASES, Phase
from companion.core.return_budget.budget import Assessment

if TYPE_CHECKING:
    from companion.core.pilot.pilot import Pilot

REPORT_S = 1.0
WIND_REPORT_S = 0.5
CHECKPOINT_S = 5.0


@dataclass(slots=True)
class Told:
    """When each was told last."""

    values_s: float = -1e9
    wind_s: float = -1e9
    saved_s: float = -1e9


def report(pilot: Pilot) -> None:
    """Tell wind, energy and promise as often as each is due; checkpoint the flight now and then."""
    t_s = pilot.now.t_s
    wind, energy, seen = pilot.judge.wind, pilot.judge.energy, pilot.assessment
    if wind is not None and wind.valid and t_s - pilot.told.wind_s >= WIND_REPORT_S - 1e-6:
        pilot.told.wind_s = t_s
        north, east = (float(x) for x in wind.mean_to_ne_mps)
        cov = wind.cov_ne_m2ps2
        pilot.do(WindReport(t_s, north, east, float(cov[0, 0]), float(cov[0, 1]), float(cov[1, 1])))
    if t_s - pilot.told.values_s >= REPORT_S - 1e-6:
        pilot.told.values_s = t_s
        values: dict[str, float] = {}
        if wind is not None and wind.valid:
            values["LW_WINDN"], values["LW_WINDE"] = (float(x) for x in wind.mean_to_ne_mps)
        if energy is not None:
            values["LW_ENERGY"] = energy.mean_wh
            told = (energy.mean_wh, energy.std_wh, energy.source, energy.used_wh)
            pilot.do(EnergyReport(t_s, *told))
        if seen is not None and t_s - seen.t_s <= 2.5:
            values |= {
                "LW_MARGIN": seen.margin_wh,
                "LW_PHOME": seen.p_home,
                "LW_PHNOW": seen.p_home_now,
                "LW_PSUCC": seen.p_success,
            }
            pilot.do(_assessed(seen))
        pilot.do(Publish(values))
    flying = pilot.phase in FLIGHT_PHASES or pilot.phase is Phase.SUSPENDED
    if flying and t_s - pilot.told.saved_s >= CHECKPOINT_S - 1e-6:
        save(pilot, routine=True)


def save(pilot: Pilot, *, routine: bool = False) -> None:
    """Ask for a checkpoint of the present state."""
    if pilot.options.check_only:
        return
    pilot.told.saved_s = pilot.now.t_s
    pilot.do(SaveCheckpoint(kept_to_dict(kept(pilot)), routine))


def kept(pilot: Pilot) -> Kept:
    """What a restart needs."""
    air, flown = pilot.air, pilot.flown
    waiting = pilot.phase is Phase.LINK_LOST and pilot.before in FLIGHT_PHASES
    recognising = pilot.phase is Phase.RECOGNISE and air.flying
    return Kept(
        flight=pilot.digest,
        t_s=pilot.now.t_s,
        phase=pilot.phase.value,
        authority=pilot.phase in FLIGHT_PHASES or waiting or recognising,
        authorised=air.authorised,
        flying=air.flying,
        finished=pilot.phase in END_PHASES,
        delivered=air.delivered,
        drop_begun=air.drop_begun,
        gate_closed=air.gate_closed,
        leg=air.leg,
        took_off_s=air.took_off_s,
        plan=flown.plan if flown is not None else None,
        frame=flown.site.frame if flown is not None else None,
        rally=air.rally,
        home=air.home,
        wanted=air.wanted,
        asides=flown is not None and bool(flown.mission.asides),
        settings_before=dict(pilot.ground.settings_before),
        judgement=pilot.judge.snapshot(),
    )


def _assessed(seen: Assessment) -> Assessed:
    return Assessed(
        seen.t_s,
        seen.p_home,
        seen.p_home_now,
        seen.p_success,
        seen.margin_wh,
        seen.energy_left_wh,
        seen.energy_need_wh,
        seen.p_home_unattended,
        seen.by_table,
    )
