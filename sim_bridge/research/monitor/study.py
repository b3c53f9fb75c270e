"""Monitor study: false alarms without a fault, flights until detection, losses."""

import math
from collections.abc import Iterator
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.monitor.promises import (
    DRAW,
    DRAW_STD,
    DRAW_TEST,
    PACK,
    PACK_TEST,
    WIND,
    WIND_TEST,
    alarm_log_e_threshold,
)
from companion.core.monitor.tally import DISCHARGE_STD_FRAC
from sim_bridge.research.monitor.services import (
    AlarmHistory,
    Losses,
    ServicePlan,
    World,
    count_losses,
    period_masks,
    shift_estimates_after_alarm,
    simulate_check_failure_alarms,
    simulate_shift_alarms,
)
from sim_bridge.research.study.intervals import wilson95
from sim_bridge.research.study.run import Report
from sim_bridge.research.study.sheet import Sheet, low_to_high

M100_DAY_STD, M100_FLIGHT_STD = 0.015, 0.024
"""Log ratio of used to modelled energy: 119 flights of an M100 (Rodrigues et al., 2021)."""

CHARGE_USED_FRAC = 0.55
"""Share of the charge that a flight uses, as in the default flight."""

PACK_STD = DISCHARGE_STD_FRAC / CHARGE_USED_FRAC
PACKS, PACK_SERVICE = 4, ServicePlan(flights=125, per_day=3)
"""Number of packs of a vehicle, used in rotation, and the service of one pack."""

WIND_CHECKS = 5
"""Number of wind forecasts that a six-minute flight checks."""

AS_MEASURED = World("as measured on the M100", 0.0, M100_DAY_STD, M100_FLIGHT_STD)
AT_THE_EDGE = World("at the edge of the null", DRAW_TEST.tolerance, DRAW_TEST.day_std, DRAW_STD)
HARSH = replace(AS_MEASURED, name="days scatter by 3 %, twice as measured", day_std=0.03)
PACK_WORLD = World("pack", 0.0, M100_DAY_STD, PACK_STD)
DRAW_RISE_FRACS, CHANGED_FLIGHT = (0.05, 0.10, 0.20), 203
"""Rises of the draw, and the flight index of the change: in mid-service and mid-day."""

DETECTION_SERVICES = 2000
"""Number of services, sufficient for a median with a resolution of one flight."""

MAX_LOSS = 0.01

Row = dict[str, Any]
"""Row of a table, with the keys of the JSON document."""


def evaluate_monitor(service_count: int, seed: int) -> Report:
    """Run the study; in the JSON document an infinite median is None."""
    alarms = list(simulate_false_alarms(service_count, seed))
    found = list(simulate_detection_times(seed))
    lost = list(simulate_losses_with_and_without_monitor(max(service_count // 10, 100), seed))
    document = {
        "format": "monitor-study/1",
        "false_alarms": alarms,
        "found": [{k: None if v == math.inf else v for k, v in row.items()} for row in found],
        "losses": [
            row | {key: asdict(row[key]) for key in ("with_monitor", "without")} for row in lost
        ],
    }
    sheets = {
        "false_alarms": Sheet.from_objects(
            "False alarms",
            alarms,
            {
                "world": "{0[world]}",
                "monitor": "{0[what]}",
                "services": "{0[services]}",
                "with an alarm": "{0[alarms]}",
                "share": lambda row: f"{row['alarms'] / row['services']:.2%}",
                "95 % interval": lambda row: low_to_high(row["interval95"], ".2%"),
            },
            f"Services of {ServicePlan().flights} flights, ten a day, four packs in turn. The edge"
            " of the null is the worst that is promised: every mean at its tolerance, every scatter"
            " as stated.",
        ),
        "found": Sheet.from_objects(
            "Flights until it is found",
            found,
            {
                "what": "{0[what]}",
                "flights a day": "{0[per_day]}",
                "median": "{0[median]:.0f}",
                "90 % within": "{0[most]:.0f}",
                "never": "{0[missed]:.1%}",
            },
            "From the first changed flight to the one whose end brings the alarm. A pack's flights"
            " are its own.",
        ),
        "losses": Sheet.from_objects(
            "Losses of the flights that the gate allowed",
            lost,
            {
                "what": "{0[what]}",
                "when": "{0[when]}",
                "lost, monitor": "{0[with_monitor].share:.2%}",
                "95 % interval": lambda row: low_to_high(
                    wilson95(row["with_monitor"].lost, max(row["with_monitor"].allowed, 1)), ".2%"
                ),
                "lost, without": "{0[without].share:.2%}",
                "allowed, monitor": "{0[with_monitor].allowed_share:.0%}",
                "allowed, without": "{0[without].allowed_share:.0%}",
            },
            f"The gate accepts {MAX_LOSS:.0%}; missions need 70 to 100 % of a full pack, so that"
            " each is near its limit.",
        ),
    }
    return Report(sheets, document)


def simulate_false_alarms(service_count: int, seed: int) -> Iterator[Row]:
    """Yield false alarms of whole services: as measured, at the edge of the null, harsher draw."""

    def count_services_with_alarm(world: World, label: str, alarm: Floats) -> Row:
        alarms = int(np.isfinite(alarm).sum())
        interval95 = wilson95(alarms, service_count)
        return {
            "world": world.name,
            "what": label,
            "alarms": alarms,
            "services": service_count,
            "interval95": interval95,
        }

    worlds = ((AS_MEASURED, 0.0, 0.05), (AT_THE_EDGE, PACK_TEST.tolerance, WIND_TEST.allowed))
    for number, (world, pack_mean, share) in enumerate(worlds):
        rng = np.random.default_rng([seed, 1, number])
        draw = _simulate_draw_alarms(ServicePlan(), service_count, rng, world).alarm
        pack_world = replace(world, mean=pack_mean, flight_std=PACK_STD)
        packs = [
            _simulate_pack_alarms(PACK_SERVICE, service_count, rng, pack_world, order).alarm
            for order in range(1, PACKS + 1)
        ]
        wind = _simulate_wind_alarms(share, service_count, rng)
        parts = {"draw": draw, "packs": np.min(packs, axis=0), "wind": wind}
        parts["the whole service"] = np.min([*parts.values()], axis=0)
        for label, alarm in parts.items():
            yield count_services_with_alarm(world, label, alarm)
    rng = np.random.default_rng([seed, 2, 2])
    draw = _simulate_draw_alarms(ServicePlan(), service_count, rng, HARSH).alarm
    yield count_services_with_alarm(HARSH, "draw", draw)


def simulate_detection_times(seed: int) -> Iterator[Row]:
    """Yield detection times of a draw that rises in mid-service, and of aged packs."""

    def summarize(label: str, service: ServicePlan, seen: AlarmHistory) -> Row:
        change = service.change or 0
        late = seen.alarm[seen.alarm >= change] - change + 1.0
        return {
            "what": label,
            "per_day": service.per_day,
            "median": float(np.median(late)),
            "most": float(np.percentile(late, 90)),
            "missed": float(np.isinf(late).mean()),
        }

    for number, rise in enumerate(DRAW_RISE_FRACS):
        rng = np.random.default_rng([seed, 4, number])
        service = ServicePlan(change=CHANGED_FLIGHT, change_size=math.log1p(rise))
        seen = _simulate_draw_alarms(service, DETECTION_SERVICES, rng)
        yield summarize(f"draw +{100 * rise:.0f} %", service, seen)
    for number, (health, per_day) in enumerate(((0.9, 10), (0.8, 10), (0.9, 3), (0.8, 3))):
        rng = np.random.default_rng([seed, 5, number])
        for change, when in ((0, "from its first flight"), (61, "after 61 flights")):
            service = ServicePlan(300, per_day, change, -math.log(health))
            seen = _simulate_pack_alarms(service, DETECTION_SERVICES, rng)
            yield summarize(f"a pack at {100 * health:.0f} % {when}", service, seen)


def simulate_losses_with_and_without_monitor(service_count: int, seed: int) -> Iterator[Row]:
    """Yield losses before the change, until the alarm and after it, with and without monitor."""
    for number, rise in enumerate(DRAW_RISE_FRACS):
        rng = np.random.default_rng([seed, 6, number])
        service = ServicePlan(400, change=CHANGED_FLIGHT, change_size=math.log1p(rise))
        seen = _simulate_draw_alarms(service, service_count, rng)
        mean, std = shift_estimates_after_alarm(DRAW_TEST, DRAW_STD, seen, service)
        none, whole = np.zeros_like(mean), np.ones_like(mean)
        monitored = mean, std, whole
        label = f"draw +{100 * rise:.0f} %"
        yield from _losses_by_period(label, seen, CHANGED_FLIGHT, seen.values, none, monitored, rng)
    for number, health in enumerate((0.9, 0.8)):
        rng = np.random.default_rng([seed, 7, number])
        service = ServicePlan(200, change=61, change_size=-math.log(health))
        seen = _simulate_pack_alarms(service, service_count, rng)
        mean, std = shift_estimates_after_alarm(PACK_TEST, PACK_STD, seen, service)
        none = np.zeros_like(mean)
        monitored = none, none, np.minimum(np.exp(-mean - std), 1.0)
        capacity = np.broadcast_to(-service.log_ratio_shifts[:, None], mean.shape)
        used = AS_MEASURED.mean + math.hypot(M100_DAY_STD, M100_FLIGHT_STD) * rng.standard_normal(
            mean.shape
        )
        label = f"a pack at {100 * health:.0f} %"
        yield from _losses_by_period(label, seen, 61, used, capacity, monitored, rng)


def _losses_by_period(
    label: str,
    seen: AlarmHistory,
    change: int,
    log_energy_ratio: Floats,
    log_capacity_frac: Floats,
    monitored: tuple[Floats, Floats, Floats],
    rng: np.random.Generator,
) -> Iterator[Row]:
    """Yield the losses with the estimates of the monitor, and with those of a vehicle as new."""
    none = np.zeros_like(log_energy_ratio)
    for when, flights in period_masks(seen, change).items():

        def count(estimates: tuple[Floats, ...], flights: Any = flights) -> Losses:
            mean, std, share = (each[flights] for each in estimates)
            actual = log_energy_ratio[flights], log_capacity_frac[flights]
            return count_losses(*actual, (mean, std, share), MAX_LOSS, rng)

        yield {
            "what": label,
            "when": when,
            "with_monitor": count(monitored),
            "without": count((none, none, 1.0 + none)),
        }


def _simulate_draw_alarms(
    service: ServicePlan, services: int, rng: np.random.Generator, world: World = AS_MEASURED
) -> AlarmHistory:
    limit = alarm_log_e_threshold(DRAW)
    return simulate_shift_alarms(DRAW_TEST, DRAW_STD, limit, world, service, services, rng)


def _simulate_pack_alarms(
    service: ServicePlan,
    services: int,
    rng: np.random.Generator,
    world: World = PACK_WORLD,
    pack_number: int = 1,
) -> AlarmHistory:
    limit = alarm_log_e_threshold(PACK, pack_number)
    return simulate_shift_alarms(PACK_TEST, PACK_STD, limit, world, service, services, rng)


def _simulate_wind_alarms(
    mean_failure_probability: float, services: int, rng: np.random.Generator
) -> Floats:
    """Return alarms of the wind test; daily shares follow a beta distribution with mean
    `mean_failure_probability` and the concentration of two checks.
    """
    concentrations = 2.0 * mean_failure_probability, 2.0 * (1.0 - mean_failure_probability)
    days = rng.beta(*concentrations, (ServicePlan().day_count, services))
    limit = alarm_log_e_threshold(WIND)
    return simulate_check_failure_alarms(WIND_TEST, limit, days, WIND_CHECKS, 10, rng)
