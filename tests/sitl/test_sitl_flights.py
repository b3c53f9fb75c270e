"""A companion and a simulated vehicle, both autopilots, over real UDP in lockstep.

One table: name, world, faults, the check. Every check has a canary, a badly wrong world in which
the same check must fail: a check that cannot fail shows nothing.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from pymavlink import mavutil

from companion.adapters.files.params import read_airframe, read_flight, read_wind_process
from companion.adapters.logs.open_log import read_log_of_any_format
from companion.analysis.replay.flight_replay import ReplayConfig, replay_flight

pytestmark = pytest.mark.sitl


def delivered_and_home(flown) -> bool:
    return flown.row["outcome"] == "SUC" and flown.row["margin_wh"] >= 0.0


def home_with_reserve(flown) -> bool:
    return flown.row["home"] and flown.row["margin_wh"] >= 0.0


def gate_closed_and_home(flown) -> bool:
    closed = {"turn_back", "divert"} & set(flown.kinds)
    return bool(closed) and flown.row["home"] and flown.row["margin_wh"] >= 0.0


def wind_known(flown) -> bool:
    rmse, nees = flown.row["wind_rmse_mps"], flown.row["wind_nees"]
    return rmse is not None and rmse < 1.0 and nees < 6.0


def no_frame_missed(flown) -> bool:
    """Return True if a strict client finds no gap in the autopilot's frames, TIMESYNC included."""
    stream = mavutil.mavlink_connection(str(flown.run_dir / "stream.tlog"))
    heard = [m for m in iter(stream.recv_msg, None) if m.get_srcComponent() == 1]
    stream.close()
    numbers = [m.get_seq() for m in heard]
    steps = {(after - before) % 256 for before, after in pairwise(numbers)}
    return "TIMESYNC" in {m.get_type() for m in heard} and steps == {1}


def home_undelivered(flown) -> bool:
    return flown.row["outcome"] == "ABRT"


def silent_after_pilot(flown) -> bool:
    taken_s = flown.fault_s("pilot_takes_over")
    flew = any(t_s < taken_s for t_s, _, _ in flown.craft.link.commands)
    return (
        flew
        and "companion released control" in flown.said
        and not flown.commands_after(taken_s + 0.2)
    )


def silent_after_ground(flown) -> bool:
    return not flown.commands_after(flown.fault_s("ground_takes_over") + 1.2)


def return_loaded_and_said(flown) -> bool:
    said = " ".join(text.lower() for _, text in flown.craft.operator.received_texts)
    return not flown.row["delivered"] and flown.row["home"] and "release not confirmed" in said


def delivered_without_a_record(flown) -> bool:
    told = flown.said.count("recording stopped")
    return delivered_and_home(flown) and flown.craft.companion.exit_code == 0 and told == 1


def down_and_said_where(flown) -> bool:
    """Return True if it landed without commands and the operator was given the position."""
    told = (
        "position lost" in flown.said and "descending without position, last at 55.4" in flown.said
    )
    down = flown.craft.record.landed_s is not None
    return down and told and not flown.commands_after(flown.fault_s("gnss_lost") + 3.0)


def down_whole_and_said_where(flown) -> bool:
    return down_and_said_where(flown) and not flown.craft.record.crashed


def refused_jumps_bring_it_home(flown) -> bool:
    return flown.row["outcome"] == "ABRT" and "did not jump" in flown.said


def stays_on_the_ground_and_says(words: str) -> Callable[[Any], bool]:
    def check(flown) -> bool:
        return flown.craft.record.takeoff_s is None and words in flown.said

    return check


not_armed = stays_on_the_ground_and_says("arm not confirmed: failed")
out_of_reach = stays_on_the_ground_and_says("no take-off: ")


@dataclass(frozen=True)
class Case:
    """A flight, its check, and the wrong world in which the check must fail.

    `canary` may be omitted where another case has the same check.
    """

    name: str
    check: Callable[[Any], bool]
    world: dict[str, Any] = field(default_factory=dict)
    canary: dict[str, Any] | None = None
    canary_gate: bool = True


def fault(kind: str, **more: Any) -> dict[str, Any]:
    return {"kind": kind, **more}


THIN = {"vehicle": {"charge_frac": 0.28}}  # enough to fly it, not to keep the reserve
LOW = {"vehicle": {"charge_frac": 0.18}}

# A headwind home that gains 3.5 m/s in two minutes: the most that the recordings show is 2.7 to
# 3.6 (99 of 100 cases, docs/reference/benchmarks.md). Without the gate it ends under the reserve.
GROWING = {
    "site": {"customer": {"name": "customer", "east_m": -900.0, "north_m": -60.0, "up_m": 4.5}},
    "vehicle": {"charge_frac": 0.5},
    "wind": {
        "kind": "points",
        "points": [
            {"t_s": 0.0, "speed_mps": 6.0, "from_deg": 80.0},
            {"t_s": 70.0, "speed_mps": 6.0, "from_deg": 80.0},
            {"t_s": 190.0, "speed_mps": 9.5, "from_deg": 80.0},
        ],
        "turbulence": "dryden",
    },
}

HOT_AND_HIGH = {"site": {"depot": {"alt_amsl_m": 3000.0}}, "vehicle": {"temperature_c": 40.0}}

CASES = [
    Case("in air of 0.78 kg/m3, which nobody states, the wind is known", wind_known, HOT_AND_HIGH),
    Case("a parcel is delivered and the vehicle comes home", delivered_and_home, {}, LOW),
    Case(
        "a growing headwind closes the gate, and the vehicle lands with its reserve",
        gate_closed_and_home,
        GROWING,
        GROWING,
        canary_gate=False,
    ),
    Case(
        "the wind is known within its stated error",
        wind_known,
        {},
        {"faults": [fault("attitude_wrong")]},
    ),
    Case(
        "killed in mid-air and restarted, the companion picks the flight up",
        delivered_and_home,
        {"faults": [fault("companion_kill", phase="outbound", at_s=4.0, duration_s=3.0)]},
        {"faults": [fault("companion_kill", phase="outbound", at_s=4.0, restart=False)]},
    ),
    Case(
        "killed for good, the vehicle comes home by itself",
        home_undelivered,
        {"faults": [fault("companion_kill", phase="outbound", at_s=4.0, restart=False)]},
        {},
    ),
    Case(
        "a link that is cut for good brings the vehicle home",
        home_undelivered,
        {"faults": [fault("link_silent", phase="outbound", at_s=4.0)]},
        {},
    ),
    Case(
        "a link silent for some seconds loses nothing",
        home_with_reserve,
        {"faults": [fault("link_silent", phase="outbound", at_s=4.0, duration_s=6.0)]},
        THIN,
        canary_gate=False,
    ),
    Case(
        "the pilot takes over and not one command follows",
        silent_after_pilot,
        {"faults": [fault("pilot_takes_over", phase="outbound", at_s=6.0)]},
        {},
    ),
    Case(
        "another ground station takes over and not one command follows",
        silent_after_ground,
        {"faults": [fault("ground_takes_over", phase="outbound", at_s=6.0)]},
        {},
    ),
    Case(
        "a parcel that sticks is brought home, and the operator hears it",
        return_loaded_and_said,
        {"faults": [fault("release_fails", phase="climb")]},
        {},
    ),
    Case(
        "an autopilot that reboots in flight comes home",
        home_with_reserve,
        {"faults": [fault("autopilot_reboot", phase="outbound", at_s=5.0)]},
        THIN,
        canary_gate=False,
    ),
    Case(
        "GNSS lost for five seconds costs nothing",
        home_with_reserve,
        {"faults": [fault("gnss_lost", phase="outbound", at_s=4.0, duration_s=5.0)]},
        {"faults": [fault("gnss_lost", phase="outbound", at_s=4.0)]},
    ),
    Case(
        "the autopilot numbers all its frames in one row",
        no_frame_missed,
        {},
        {"faults": [fault("link_silent", phase="outbound", at_s=4.0, duration_s=2.0)]},
    ),
    Case(
        "GNSS lost for a minute brings it down where it is, and it says where",
        down_and_said_where,
        {"faults": [fault("gnss_lost", phase="outbound", at_s=4.0, duration_s=60.0)]},
        {},
    ),
    Case(
        "GNSS lost for good brings it down whole where it is, and it says where",
        down_whole_and_said_where,
        {"faults": [fault("gnss_lost", phase="return", at_s=4.0)]},
        {},
    ),
    Case(
        "garbage, torn, doubled, late and foreign frames and unknown fields lose nothing",
        delivered_and_home,
        {"faults": [fault("bad_link")]},
    ),
    Case(
        "a clock that leaps ahead loses nothing",
        delivered_and_home,
        {"faults": [fault("clock_jump", phase="outbound", at_s=6.0, by_s=45.0)]},
    ),
    Case(
        "a clock that steps back loses nothing",
        delivered_and_home,
        {"faults": [fault("clock_jump", phase="outbound", at_s=6.0, by_s=-30.0)]},
    ),
    Case(
        "an autopilot that obeys no jump comes home by the mission aboard",
        refused_jumps_bring_it_home,
        {"faults": [fault("jumps_refused", phase="outbound")]},
        {},
    ),
    Case(
        "a disk that fills up in flight costs the record, not the flight",
        delivered_without_a_record,
        {"faults": [fault("disk_full", phase="outbound", at_s=4.0)]},
        {},
    ),
    Case(
        "an autopilot that will not arm is left alone",
        not_armed,
        {"faults": [fault("arming_refused", phase="start")]},
        {},
    ),
    Case(
        "a customer beyond reach is refused on the ground",
        out_of_reach,
        {"site": {"customer": {"east_m": -12_000.0}}},
        {},
    ),
]

CANARIES = [case for case in CASES if case.canary is not None]
_WORLDS = [case.world for case in CASES] + [case.canary for case in CANARIES]
_SHARED_WORLDS = [world for world in _WORLDS if _WORLDS.count(world) > 1]


@pytest.mark.sample
@pytest.mark.drawn(keep=6)  # by night every case by both autopilots
@pytest.mark.parametrize("autopilot_kind", ["px4", "ardupilot"])
@pytest.mark.parametrize("case", CASES, ids=lambda c: c.name.replace(" ", "_"))
def test_flight(fly_case, autopilot_kind, case):
    flown = _flown_once(fly_case, autopilot_kind, case.world)
    assert case.check(flown), _story(flown)


_FLOWN: dict[str, Any] = {}
"""Flights used by several checks, above all the one without faults: flown once per worker."""


@pytest.mark.sample
@pytest.mark.drawn(keep=3)
@pytest.mark.parametrize("case", CANARIES, ids=lambda c: c.name.replace(" ", "_"))
def test_the_check_fails_in_a_wrong_world(fly_case, case):
    autopilot_kind = "px4" if not case.canary else ("px4", "ardupilot")[CANARIES.index(case) % 2]
    flown = _flown_once(fly_case, autopilot_kind, case.canary, gate=case.canary_gate)
    assert not case.check(flown), _story(flown)


def _flown_once(fly_case, autopilot_kind, changes, *, gate=True):
    world = f"{autopilot_kind} {changes} {gate}"
    if world not in _FLOWN:
        flown = fly_case(autopilot_kind, changes, gate=gate)
        if changes not in _SHARED_WORLDS:
            return flown
        _FLOWN[world] = flown
    return _FLOWN[world]


@pytest.mark.sample
def test_a_replay_says_what_the_flight_said(fly_case):
    flown = _flown_once(fly_case, "px4", {}, gate=True)
    result = json.loads((flown.run_dir / "result.json").read_text())
    flight = read_flight(flown.run_dir.parents[1] / "case.toml")
    process = read_wind_process(flight.mission.wind_process)
    terms = ReplayConfig(
        read_airframe("m100"), flight, process, at_planned_site=True, with_energy=True
    )
    wind = _table(result["wind"], "t_s", "to_n_mps", "to_e_mps")
    for name, allowed_mps in (("decisions.mcap", 0.02), ("stream.tlog", 0.3)):
        seen = replay_flight(
            read_log_of_any_format(flown.run_dir / name),
            replace(terms, with_energy="tlog" not in name),
        )
        mine = [np.interp(wind[:, 0], seen.wind_t_s, axis) for axis in seen.wind_to_ne_mps.T]
        assert np.hypot(mine[0] - wind[:, 1], mine[1] - wind[:, 2]).mean() < allowed_mps, name
        if "tlog" in name:
            continue
        energy = _table(result["energy"], "t_s", "left_wh")
        left = np.array([(m.t_s, m.energy_left_wh) for m in seen.states if m.airborne])
        flying = (energy[:, 0] > left[0, 0]) & (energy[:, 0] < left[-1, 0])
        gap_wh = np.interp(energy[:, 0], *left.T) - energy[:, 1]
        assert np.abs(gap_wh[flying]).max() < 1.0
        for kind in ("go", "descend", "delivered", "release_unconfirmed", "turn_back", "divert"):
            was = [d["t_s"] for d in result["decisions"] if d["kind"] == kind]
            now = [d.t_s for d in seen.decisions if d.kind == kind]
            assert len(now) == len(was), kind
            assert np.allclose(now, was, atol=1.5), kind


@pytest.mark.sample
def test_a_flights_mission_is_in_its_run_folder_and_on_foxgloves_map(fly_case):
    """The items in mission.plan are those that the autopilot received, item by item."""
    flown = _flown_once(fly_case, "px4", {}, gate=True)
    document = json.loads((flown.run_dir / "mission.plan").read_text())
    stream = mavutil.mavlink_connection(str(flown.run_dir / "stream.tlog"))
    sent = {}
    while (message := stream.recv_match(type="MISSION_ITEM_INT")) is not None:
        if message.mission_type == 0:
            sent[message.seq] = (message.command, message.x, message.y, message.z)
    stream.close()
    items = document["mission"]["items"]
    assert len(items) == len(sent)
    for (command, x, y, z), item in zip((sent[k] for k in sorted(sent)), items, strict=True):
        lat_deg, lon_deg, height_m = item["params"][4:]
        assert item["command"] == command
        assert (lat_deg * 1e7, lon_deg * 1e7) == pytest.approx((x, y), abs=1.0)
        assert height_m == pytest.approx(z, abs=0.01)
    with (flown.run_dir / "decisions.mcap").open("rb") as file:
        routes = [message for _, _, message in make_reader(file).iter_messages("/foxglove_route")]
    drawn = json.loads(json.loads(routes[-1].data)["geojson"])
    names = {feature["properties"]["name"] for feature in drawn["features"]}
    assert {"launch", "customer", "outbound", "homeward"} <= names


def _table(rows, *names):
    return np.array([[row[name] for name in names] for row in rows])


def test_every_check_has_a_canary():
    assert {case.check for case in CASES} == {case.check for case in CANARIES}


def _story(flown) -> str:
    row = {k: v for k, v in flown.row.items() if k != "decisions"}
    kinds = [(round(d["t_s"]), d["kind"]) for d in flown.row["decisions"]]
    said = flown.craft.operator.received_texts[-8:]
    return f"{row}\n{kinds}\n{said}\n{flown.craft.started_faults}"


@pytest.mark.sample
def test_the_same_seed_gives_the_same_decisions_and_the_same_assessments(fly_case):
    seen = []
    for flown in (_flown_once(fly_case, "px4", {}), fly_case("px4", {}, name="again")):
        result = json.loads((flown.run_dir / "result.json").read_text())
        seen.append((result["decisions"], result["assessments"]))
    assert seen[0] == seen[1]
