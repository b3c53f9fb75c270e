"""All rows of the fault suite, by number."""

from companion.core.base.errors import LeewayError
from sim_bridge.app.faults import (
    air,
    authority,
    decisions,
    energy,
    fleet,
    host,
    link,
    mission_and_home,
    observed,
    packs,
    return_budget,
    signing,
    steps,
    telemetry,
    workers,
)
from sim_bridge.app.faults.fault import FaultCase
from sim_bridge.app.faults.pair import SEPARATOR, combine_cases

MODULES = (air, authority, decisions, mission_and_home, return_budget, energy, packs, telemetry,
           observed, host, workers, link, signing, fleet, steps)  # fmt: skip
CATALOGUE: tuple[FaultCase, ...] = tuple(
    sorted((case for module in MODULES for case in module.FAULTS.cases), key=lambda c: c.number)
)
"""Every row, by number."""


TIGHT_ROW_NUMBERS = range(21, 40)
"""Rows whose physics the companion does not model: they test P(home)."""


def find_case(name: str) -> FaultCase:
    """Return the row, or the pair of rows, with this name."""
    if SEPARATOR in name:
        return combine_cases(*map(find_case, name.split(SEPARATOR)))
    return next(case for case in CATALOGUE if case.name == name)


def select_cases(names_or_numbers: list[str]) -> list[FaultCase]:
    """Return the rows with these names or numbers, or all rows if `names_or_numbers` is empty.

    Raises: LeewayError for an unknown name.
    """
    if not names_or_numbers:
        return list(CATALOGUE)
    known = {case.name for case in CATALOGUE} | {str(case.number) for case in CATALOGUE}
    unknown = [name for name in names_or_numbers if not known.issuperset(name.split(SEPARATOR))]
    if unknown:
        raise LeewayError(
            f"--only {unknown[0]}: no such fault; `sim-bridge faults --list` lists all"
        )
    pairs = [find_case(name) for name in names_or_numbers if SEPARATOR in name]
    return [
        case
        for case in CATALOGUE
        if case.name in names_or_numbers or str(case.number) in names_or_numbers
    ] + pairs


def select_tight_cases(cases: list[FaultCase], *, named_explicitly: bool) -> list[FaultCase]:
    """Return those of the rows that tight flights use.

    Raises: LeewayError if the rows were `named_explicitly` and one of them is not used by tight
    flights.
    """
    suitable = [case for case in cases if case.number in TIGHT_ROW_NUMBERS]
    if named_explicitly and len(suitable) < len(cases):
        unsuitable = next(case for case in cases if case not in suitable)
        raise LeewayError(
            f"--tight {unsuitable.name}: row {unsuitable.number}, expected one of"
            f" {TIGHT_ROW_NUMBERS[0]} to {TIGHT_ROW_NUMBERS[-1]}"
        )
    return suitable
