"""Which days are predicted from which: each from all others, or a folder from another."""

from pathlib import Path

from companion.core.base.errors import LeewayError
from sim_bridge.research.real_flights.fold import Fold
from sim_bridge.research.real_flights.folder import FlightFolder

LEAST_DAYS = 4
"""Three to fit to (scatter between days) and one to judge."""


def folds_of(
    judged: FlightFolder, folder: Path, fit: Path | None, airframe: str, climate: bool
) -> list[Fold]:
    """One fold for each day with routes; with `fit` a single one, and no day is left out."""
    if fit is not None:
        return [Fold(folder, fit, "", airframe, climate)]
    days = sorted({f.ordered.date for f in judged.flights if f.ordered.has_route})
    if len(days) < LEAST_DAYS:
        raise LeewayError(
            f"{folder}: routes on {len(days)} days, {LEAST_DAYS} expected to predict each day from"
            " the others; or name flights to fit to with --fit"
        )
    return [Fold(folder, folder, day, airframe, climate) for day in days]
