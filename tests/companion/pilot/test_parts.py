"""The table of the pilot's parts: a wrong row is refused, at import."""

import runpy
from dataclasses import replace

import msgspec
import pytest

from companion.core.mission import checkpoint
from companion.core.pilot import parts
from companion.core.pilot.control.last_resort import LastResort
from companion.core.pilot.flight_state import FlightState
from companion.core.pilot.home_watch import HomeMonitor
from companion.core.pilot.parts import (
    PARTS,
    TICK_ORDER,
    PilotPart,
    check_methods_and_keys,
    sort_parts_by_dependency,
)


class Alone:
    """A part with a dependency that no part provides."""

    def __init__(self, nothing: int) -> None:
        self.nothing = nothing

    def tick(self) -> None:
        """Tick without the context."""


def test_a_part_whose_need_nothing_satisfies_is_refused():
    with pytest.raises(ValueError, match="missing or circular: Alone"):
        sort_parts_by_dependency([*PARTS, PilotPart(Alone)])


NEEDED = [
    p
    for p in PARTS
    if any(p.part_class in other.constructor_dependencies.values() for other in PARTS)
]


@pytest.mark.parametrize("left_out", NEEDED, ids=str)
def test_no_part_can_be_left_out(left_out):
    with pytest.raises(ValueError, match="missing or circular"):
        sort_parts_by_dependency([part for part in PARTS if part is not left_out])


@pytest.mark.parametrize("keys", [("leg",), ("unknown",)])
def test_a_checkpoint_key_with_two_owners_or_unknown_to_the_checkpoint_is_refused(keys):
    with pytest.raises(ValueError, match="expected one owner of each"):
        check_methods_and_keys([*PARTS[:-1], replace(PARTS[-1], checkpoint_keys=keys)], TICK_ORDER)


def test_a_tick_without_its_method_or_row_is_refused():
    with pytest.raises(ValueError, match=r"Alone has no method tick\(context\)"):
        check_methods_and_keys(PARTS, [Alone])
    with pytest.raises(ValueError, match=r"not in the table: .*LastResort"):
        check_methods_and_keys([p for p in PARTS if p.part_class is not LastResort], TICK_ORDER)


@pytest.mark.parametrize(
    ("part_class", "method"),
    [(LastResort, "tick"), (HomeMonitor, "on_event"), (FlightState, "restore")],
)
def test_a_row_without_its_method_fails_at_import(part_class, method, monkeypatch):
    monkeypatch.delattr(part_class, method)
    with pytest.raises(ValueError, match=rf"{part_class.__name__} has no method {method}"):
        runpy.run_path(parts.__file__)


def test_a_checkpoint_key_without_an_owner_fails_at_import(monkeypatch):
    runpy.run_path(parts.__file__)
    longer = msgspec.defstruct("Longer", [("more", int)], bases=(checkpoint.Checkpoint,))
    monkeypatch.setattr(checkpoint, "Checkpoint", longer)
    with pytest.raises(ValueError, match=r"expected one owner of each: .*'more'"):
        runpy.run_path(parts.__file__)
