"""All rows of the standing suite, by number."""

from companion.core.base.errors import LeewayError
from sim_bridge.app.faults import (
    air,
    authority,
    decisions,
    energy,
    host,
    link,
    mission_and_home,
    signing,
    telemetry,
    workers,
)
from sim_bridge.app.faults.case import FaultCase
from sim_bridge.app.fleet_faults import fleet_cases
from sim_bridge.app.fleet_faults.fleet_case import FleetCase

Case = FaultCase | FleetCase
"""One vehicle's flight, or a small day of a fleet."""

CATALOGUE: tuple[Case, ...] = tuple(
    sorted(
        (
            *air.CASES,
            *authority.CASES,
            *decisions.CASES,
            *mission_and_home.CASES,
            *energy.CASES,
            *telemetry.CASES,
            *host.CASES,
            *workers.CASES,
            *link.CASES,
            *signing.CASES,
            *fleet_cases.CASES,
        ),
        key=lambda case: case.number,
    )
)
"""Every row."""


TIGHT = range(21, 40)
"""Rows whose physics the companion's model does not know: there P(home) is put to the test."""


def case_of(name: str) -> Case:
    """The row of this name."""
    return next(case for case in CATALOGUE if case.name == name)


def chosen(names: list[str]) -> list[Case]:
    """The rows of these names or numbers; all of them where none is named.

    Raises: LeewayError for a name that no row has.
    """
    if not names:
        return list(CATALOGUE)
    known = {case.name for case in CATALOGUE} | {str(case.number) for case in CATALOGUE}
    unknown = [name for name in names if name not in known]
    if unknown:
        raise LeewayError(
            f"--only {unknown[0]}: no such fault; `sim-bridge faults --list` names them"
        )
    return [case for case in CATALOGUE if case.name in names or str(case.number) in names]


def tight_enough(cases: list[Case], *, named: bool) -> list[Case]:
    """Those of them that tight flights are made of.

    Raises: LeewayError where a row was named that is none of them.
    """
    fit = [case for case in cases if case.number in TIGHT]
    if named and len(fit) < len(cases):
        odd = next(case for case in cases if case not in fit)
        raise LeewayError(
            f"--tight {odd.name}: row {odd.number}, expected one of {TIGHT[0]} to {TIGHT[-1]}"
        )
    return fit
