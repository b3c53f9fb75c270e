"""Requirements on any simulated day with faults, checked on its result row from ground truth."""

from typing import Any

from ground_station.core.schema.order_states import OrderState

MIN_SEPARATION_M = 5.0
"""Minimum true distance of two airborne vehicles. Planned layers are 12 m from each other; each
vehicle may deviate by about 3 m through barometer drift and gusts."""

STUCK = OrderState.STUCK.value
"""The order waits for a dispatcher's decision."""

FINDINGS = (
    ("lost", "not home: {}"),
    ("flown_twice", "twice: {}"),
    ("believed_otherwise", "the store is wrong about {}"),
    ("promises_broken", "{}"),
    ("commands_after_take_over", "{}"),
    ("ended_by_themselves", "ended by itself: {}"),
)
"""Lists of a day's row that must be empty: flights that ended neither at home with the reserve nor
intact under a pilot override; orders delivered twice; wrong records in the store; departures of the
truck from a reported home; commands after a known take-over; unexpected exits of companions.
"""


def describe_day_violations(result_row: dict[str, Any]) -> list[str]:
    """Return descriptions of all violations in a day's result row."""
    late = [] if result_row["ended"] else [f"not over after {result_row['duration_s']:.0f} s"]
    found = [template.format(words) for key, template in FINDINGS for words in result_row[key]]
    return [
        *late,
        *found,
        *(  # neither delivered nor stuck with a stated reason
            f"lost: {line['order']}: {line['why']}"
            for line in result_row["undelivered"]
            if line["feasible"] and (line["state"] != STUCK or line["why"] == STUCK)
        ),
        *describe_separation_violation(result_row),
    ]


def describe_separation_violation(result_row: dict[str, Any]) -> list[str]:
    """Return a violation of the minimum separation; flights with a pilot override are exempt."""
    near, is_overridden = (
        result_row["nearest"],
        any(flight["taken"] for flight in result_row["flights"]),
    )
    if near is None or is_overridden or near["distance_m"] >= MIN_SEPARATION_M:
        return []
    pair = " and ".join(near["vehicles"])
    return [f"{pair} came to {near['distance_m']:.1f} m at {near['t_s']:.0f} s"]
