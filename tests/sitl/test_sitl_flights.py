"""A companion and a simulated vehicle, both flavours, over real UDP in lockstep.

One table: name, world, faults, the check. Every check has a canary, a badly wrong world in which
the same check must fail: a check that cannot fail shows nothing.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import pytest
from pymavlink import mavutil

pytestmark = pytest.mark.sitl


def delivered_and_home(flown) -> bool:
    return flown.row["outcome"] == "SUC" and flown.row["margin_wh"] >= 0.0


def home_with_reserve(flown) -> bool:
    return flown.row["home"] and flown.row["margin_wh"] >= 0.0


def wind_known(flown) -> bool:
    rmse, nees = flown.row["wind_rmse_mps"], flown.row["wind_nees"]
    return rmse is not None and rmse < 1.0 and nees < 6.0


def no_frame_missed(flown) -> bool:
    """A strict client's count: the autopilot's frames, TIMESYNC among them, without a gap."""
    stream = mavutil.mavlink_connection(str(flown.run_dir / "stream.tlog"))
    heard = [m for m in iter(stream.recv_msg, None) if m.get_srcComponent() == 1]
    stream.close()
    numbers = [m.get_seq() for m in heard]
    steps = {(after - before) % 256 for before, after in pairwise(numbers)}
    return "TIMESYNC" in {m.get_type() for m in heard} and steps == {1}


def home_undelivered(flown) -> bool:
    return flown.row["outcome"] == "ABRT"


def silent_after_pilot(flown) -> bool:
    return not flown.commands_after(flown.fault_s("pilot_takes_over") + 0.2)


def silent_after_ground(flown) -> bool:
    return not flown.commands_after(flown.fault_s("ground_takes_over") + 1.2)


def return_loaded_and_said(flown) -> bool:
    said = " ".join(text.lower() for _, text in flown.craft.operator.said)
    return not flown.row["delivered"] and flown.row["home"] and "release not confirmed" in said


@dataclass(frozen=True)
class Case:
    """A flight, what must hold, and the wrong world in which it must not."""

    name: str
    check: Callable[[Any], bool]
    world: dict[str, Any] = field(default_factory=dict)
    canary: dict[str, Any] = field(default_factory=dict)
    canary_gate: bool = True


def fault(kind: str, **more: Any) -> dict[str, Any]:
    return {"kind": kind, **more}


THIN = {"vehicle": {"charge_frac": 0.28}}  # enough to fly it, not to keep the reserve
LOW = {"vehicle": {"charge_frac": 0.18}}

CASES = [
    Case("a parcel is delivered and the vehicle comes home", delivered_and_home, {}, LOW),
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
]


@pytest.mark.parametrize("flavour", ["px4", "ardupilot"])
@pytest.mark.parametrize("case", CASES, ids=lambda c: c.name.replace(" ", "_"))
def test_flight(fly_case, flavour, case):
    flown = fly_case(flavour, case.world)
    assert case.check(flown), _story(flown)


@pytest.mark.parametrize("case", CASES, ids=lambda c: c.name.replace(" ", "_"))
def test_the_check_fails_in_a_wrong_world(fly_case, case):
    flavour = ("px4", "ardupilot")[CASES.index(case) % 2]
    flown = fly_case(flavour, case.canary, gate=case.canary_gate)
    assert not case.check(flown), _story(flown)


def _story(flown) -> str:
    row = {k: v for k, v in flown.row.items() if k != "decisions"}
    kinds = [(round(d["t_s"]), d["kind"]) for d in flown.row["decisions"]]
    said = flown.craft.operator.said[-8:]
    return f"{row}\n{kinds}\n{said}\n{flown.faults.log}"
