"""Wind reports that a desk sends to each vehicle: content and timing."""

from dataclasses import dataclass, field

import msgspec

from companion.core.wind_field.shared_winds import MAX_REPORTS, REPORT_INTERVAL_S, SharedWinds
from companion.fleet.messages import State
from ground_station.app.desk.site import wind_publisher
from ground_station.app.desk.site.wind_publisher import WindPublisher
from ground_station.core.fleet.fleet_status import FleetStatus
from ground_station.core.site_wind import site_fronts
from tests.ground_station.site_wind.told_air import PLACES, Air, front_comes


@dataclass
class Ear:
    """A network that records the wind reports sent to vehicles."""

    told: list[SharedWinds] = field(default_factory=list)

    def publish(self, winds: SharedWinds) -> None:
        self.told.append(winds)


class Site:
    """Drones that report wind once a second, and a desk that runs one cycle as often."""

    def __init__(self, **more: object) -> None:
        self.air, self.ear = Air(**more), Ear()  # type: ignore[arg-type]
        self.wind_publisher = WindPublisher(self.air.wind, self.ear)  # type: ignore[arg-type]
        self.status = FleetStatus()
        on_state = self.air.wind.update_from_state

        def hear(state: State, t_s: float):
            self.status.record_state_and_new_doubts(state, t_s, state.epoch_us)
            self.status.status_of(state.vehicle).instance_ids = {state.instance_id}
            return on_state(state, t_s)

        self.air.wind.update_from_state = hear  # type: ignore[method-assign]

    def blow(self, for_s: float, silent: frozenset[str] = frozenset()) -> list[SharedWinds]:
        before = len(self.ear.told)
        for _ in range(round(for_s)):
            self.air.blow(1.0, silent)
            self.wind_publisher.send_due_wind_reports(self.status, self.air.t_s)
        return self.ear.told[before:]


def of(told: list[SharedWinds], vehicle: str) -> list[SharedWinds]:
    return [one for one in told if one.vehicle == vehicle]


def test_each_in_the_air_is_told_of_the_others_nearest_first_every_ten_seconds():
    site = Site()
    site.blow(60.0)
    told = of(site.blow(10.0 * REPORT_INTERVAL_S), "d1")
    assert 9 <= len(told) <= 11
    for winds in told:
        names = [one.member for one in winds.reports]
        assert "d1" not in names
        assert set(names) == PLACES.keys() - {"d1"}
        assert len(names) <= MAX_REPORTS
        away = [one.north_m**2 + one.east_m**2 for one in winds.reports]
        assert away == sorted(away)
        d2 = next(one for one in winds.reports if one.member == "d2")
        assert abs(d2.north_m - (PLACES["d2"][0] - PLACES["d1"][0])) <= 12  # 1e-4 degrees
        assert abs(d2.east_m - (PLACES["d2"][1] - PLACES["d1"][1])) <= 12
        assert d2.age_s <= 1
        state = site.status.status_of("d1").state
        assert state is not None
        assert winds.instance_id == state.instance_id


def test_a_crowd_is_told_over_some_turns_the_longest_untold_first(monkeypatch):
    monkeypatch.setattr(wind_publisher, "MAX_REPORTS_PER_CYCLE", 3)
    site = Site()
    site.blow(60.0)
    told = site.blow(20.0)
    counts = [len(of(told, name)) for name in PLACES]
    assert min(counts) >= 1
    assert max(counts) - min(counts) <= 1
    site.ear.told.clear()
    monkeypatch.setattr(wind_publisher, "REPORT_INTERVAL_S", 0.0)
    site.wind_publisher.send_due_wind_reports(site.status, site.air.t_s + 0.5)
    first = [one.vehicle for one in site.ear.told]
    site.wind_publisher.send_due_wind_reports(site.status, site.air.t_s + 0.6)
    second = [one.vehicle for one in site.ear.told[3:]]
    assert len(first) == len(second) == 3
    assert set(first) | set(second) == PLACES.keys()


def test_who_stands_by_without_an_assignment_is_told_nothing():
    site = Site(armed=False, assignment=None)
    assert site.blow(60.0) == []


def test_who_has_fallen_silent_is_told_nothing_and_his_wind_is_not_told_for_long():
    site = Site()
    site.blow(60.0)
    silent = frozenset({"d2"})
    site.blow(30.0, silent)
    late = site.blow(30.0, silent)
    assert late
    assert not of(late, "d2")
    assert all(one.member != "d2" for winds in late for one in winds.reports)


def test_who_is_left_out_by_the_desk_is_not_passed_on():
    site = Site()
    site.blow(120.0)
    site.air.mean["d3"] = site.air.mean["d3"] + (12.0, 0.0)
    site.blow(240.0)
    told = site.blow(60.0)
    assert "d3" in site.air.wind.exclusion_reason_by_member(site.air.t_s)
    assert told
    assert all(one.member != "d3" for winds in told for one in winds.reports)
    assert of(told, "d3"), "it is told itself, as all are"


def test_a_front_is_told_at_once_to_all_and_three_times():
    site = Site()
    site.blow(120.0)
    site.ear.told.clear()
    blown, seen_s = site.air.blow, []

    def blow(for_s: float, silent: frozenset[str] = frozenset()) -> None:
        blown(for_s, silent)
        if site.air.wind.fronts and not seen_s:
            seen_s.append(site.air.t_s)
        before = len(site.ear.told)
        site.wind_publisher.send_due_wind_reports(site.status, site.air.t_s)
        for winds in site.ear.told[before:]:
            if winds.front is not msgspec.UNSET:
                told_s.setdefault(winds.vehicle, []).append(site.air.t_s)

    told_s: dict[str, list[float]] = {}
    site.air.blow = blow  # type: ignore[method-assign]
    front_comes(site.air, (0.0, 9.0), 10.0, 60.0)
    assert seen_s
    assert told_s.keys() == PLACES.keys()
    for times in told_s.values():
        assert times[0] == seen_s[0]
        assert len(times) >= 3
    site.air.blow = blown  # type: ignore[method-assign]
    assert all(winds.front is msgspec.UNSET for winds in site.blow(60.0)[-4:])


def test_a_front_that_has_left_the_site_is_not_told_as_withdrawn(monkeypatch):
    monkeypatch.setattr(site_fronts, "FRONT_KEPT_S", 300.0)
    monkeypatch.setattr(wind_publisher, "FRONT_KEPT_S", 300.0)
    site = Site()
    site.blow(120.0)
    front_comes(site.air, (0.0, 9.0), 10.0, 60.0)
    assert any(one.front is not msgspec.UNSET for one in site.blow(30.0))
    later = site.blow(400.0)
    assert site.air.wind.drop_expired_and_get_fronts(site.air.t_s) == []
    assert not [one for one in later if one.front is None]


def test_a_front_that_is_withdrawn_is_told_as_none_to_all_at_once_and_three_times():
    site = Site()
    site.blow(150.0)
    gust = (0.0, 9.0)
    site.air.mean["d1"] = site.air.mean["d1"] + gust
    told = site.blow(15.0)
    site.air.mean["d1"] = site.air.mean["d1"] - gust
    assert {one.vehicle for one in told if one.front is not msgspec.UNSET} == PLACES.keys()
    assert not [one for one in told if one.front is None]
    while site.air.wind.fronts:
        assert site.air.t_s < 250.0
        told = site.blow(1.0)
    withdrawn = [one for one in told if one.front is None]
    assert {one.vehicle for one in withdrawn} == PLACES.keys(), "in the turn in which it is known"
    withdrawn += [one for one in site.blow(60.0) if one.front is not msgspec.UNSET]
    assert all(one.front is None for one in withdrawn)
    for name in PLACES:
        assert len(of(withdrawn, name)) == 3
