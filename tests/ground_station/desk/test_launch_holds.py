"""Launch holds of the desk: each source places, keeps and clears only its own."""

from collections.abc import Callable
from itertools import permutations

import pytest

from ground_station.adapters.store.hold_store import HoldStore
from ground_station.adapters.store.order_store import Store
from ground_station.app.desk.site.launch_holds import ADOPTED_HOLD_DURATION_S, LaunchHoldControl
from ground_station.core.dispatch.hold_source import HoldSource
from tests.ground_station.desk_parts import HandClock

SOURCES = [one for one in HoldSource if one is not HoldSource.UNKNOWN]
Update = Callable[..., list[str]]


@pytest.fixture
def clock() -> HandClock:
    return HandClock(1000.0)


@pytest.fixture
def people(store: Store, clock: HandClock) -> HoldStore:
    return HoldStore(store.database, clock.epoch_us)


@pytest.fixture
def start(store: Store, clock: HandClock) -> Callable[[], Update]:
    """Start a desk; its update takes the sources due for d1 and returns those that hold it."""

    def started() -> Update:
        control = LaunchHoldControl(store, clock, lambda text: None)

        def update(*due: HoldSource, after_s: float = 1.0) -> list[str]:
            clock.t_s += after_s
            control.adopt_existing_holds(clock.t_s)
            control.place_and_clear_holds({("d1", one): one.name for one in due}, clock.t_s)
            return [hold.by for hold in store.holds_in_force()]

        return update

    return started


@pytest.mark.parametrize(("first", "second"), list(permutations(SOURCES, 2)))
def test_a_release_or_the_end_of_one_sources_hold_leaves_another_also_after_a_restart(
    start, people, first, second
):
    update = start()
    assert update(first) == [first]
    people.clear_holds(["d1"], "anna")
    assert update(first) == [], "not placed again for the same reason"
    assert update(first, second) == [second]
    assert update(second) == [second]
    assert update(first, second) == [second, first]
    update = start()
    assert update(first) == [second, first], "a restarted desk does not know earlier fronts"
    assert update(first, after_s=ADOPTED_HOLD_DURATION_S) == [first]
    assert update() == []


@pytest.mark.parametrize("source", SOURCES)
def test_a_hold_of_an_earlier_version_has_no_source_and_stays_while_any_is_due(
    start, people, source
):
    people.place_holds(["d1"], "a front", "desk-wind")
    update = start()
    assert update(source, after_s=ADOPTED_HOLD_DURATION_S) == [HoldSource.UNKNOWN, source]
    assert update() == []
