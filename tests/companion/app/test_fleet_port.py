"""The vehicle's side of the desk without a network: what it keeps, and what if it cannot."""

import errno
import json
from pathlib import Path
from typing import Any

import pytest

from companion.app.flight import fleet_port
from companion.app.flight.standby import write_mission
from companion.core.base.errors import LeewayError
from companion.fleet import member as fleet_member
from companion.fleet.command_log import Verdict
from companion.fleet.event_log import BATCH, KEPT, LEAP, SLACK, EventLog
from companion.fleet.messages import (
    Answered,
    Assign,
    Command,
    Deed,
    EventKind,
    FleetEvent,
    Launch,
    Recall,
    Result,
    decode_result,
)
from companion.fleet.messages import encode as encoded
from companion.fleet.network import Ask, Asked
from ground_station.adapters.files.day_files import read_day
from ground_station.core.dispatch.flight_tables import delivery_table
from tests.fleet.zenoh_net import Vehicle, config_file, free_port

DAY = read_day(Path(__file__).parents[3] / "params" / "days" / "harbour.toml")


def an_event(text: str, kind: EventKind = EventKind.SAID) -> FleetEvent:
    return FleetEvent(vehicle="d1", log="x", seq=1, epoch_us=0, kind=kind, text=text)


@pytest.fixture
def port(tmp_path: Path) -> Any:
    nowhere = config_file(tmp_path / "v.json5", connect=free_port())
    vehicle = Vehicle("d1", tmp_path / "d1", nowhere)
    vehicle.stop()
    yield vehicle.port
    vehicle.port.close()


def ask(port: fleet_port.FleetPort, deed: Deed, id_: str = "c1") -> Result:
    """Hand it a command as its link would."""
    replies: list[bytes] = []
    command = Command(
        id=id_, vehicle="d1", life=port.life, as_of_s=port.uptime_s, by="desk", deed=deed
    )
    port.link.put(Asked(Ask.COMMAND, replies.extend, encoded(command)))
    port.turn(lambda asked: Verdict(Answered.DONE, "done"))
    (raw,) = replies
    result = decode_result(raw)
    assert isinstance(result, Result)
    return result


def test_on_a_full_disk_nothing_is_launched_but_a_recall_is_taken(port, monkeypatch):
    def full(*args: Any, **more: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as disk:
        disk.setattr(fleet_member, "write_whole", full)
        launch = ask(port, Launch(assignment="a1"))
        assert (launch.answer, launch.reason) == (
            Answered.LATER,
            "cannot write it down: No space left on device",
        )
        assert ask(port, Recall(), "c2").answer is Answered.DONE
    assert ask(port, Launch(assignment="a1")).answer is Answered.DONE


def test_a_flight_that_the_vehicle_may_not_fly_is_refused_in_words(port):
    good = delivery_table(DAY.day, DAY.day.drones[0], DAY.orders[0])
    deed = Assign(assignment="a1", order="o1", flight=good, obstacles=DAY.no_fly)
    path = write_mission(deed, port)
    assert json.loads(path.read_text())["site"]["obstacles"] == "obstacles.geojson"
    for change, words in (
        ({"vehicle": good["vehicle"] | {"airframe": "octo8"}}, "this is m100"),
        ({"vehicle": good["vehicle"] | {"payload_kg": 7.5}}, "at most 1"),
        ({"site": good["site"] | {"obstacles": "/etc/passwd"}}, "site.obstacles"),
        ({"colour": "red"}, "colour"),
        ({"mission": good["mission"] | {"max_loss": 3.0}}, "mission.max_loss"),
    ):
        deed = Assign(assignment="a2", order="o1", flight=good | change)
        with pytest.raises(LeewayError, match=words):
            write_mission(deed, port)


def test_events_outlive_a_kill_and_a_torn_last_line_is_left_out(tmp_path):
    path = tmp_path / "events.jsonl"
    first = EventLog(path)
    for n in range(3):
        first.append(an_event(f"words {n}"))
    path.write_bytes(path.read_bytes()[:-20])
    again = EventLog(path)
    assert (again.log, again.last_seq) == (first.log, 2)
    assert again.append(an_event("next")).seq == 2 + LEAP  # 3 may have been told before the cut
    assert [e.text for e in again.after(1)] == ["words 1", "next"]
    first.close()
    again.close()


def test_a_vehicle_without_a_ground_keeps_its_newest_events_and_never_fills_its_disk(tmp_path):
    log = EventLog(tmp_path / "events.jsonl")
    for n in range(KEPT + SLACK + 5):
        log.append(an_event(f"{n}"))
    kept = len((tmp_path / "events.jsonl").read_bytes().splitlines())
    assert kept == KEPT + 4
    oldest = log.after(0)
    assert len(oldest) == BATCH
    assert oldest[0].seq == SLACK + 2
    assert log.after(log.last_seq) == []
    log.close()


def test_an_outcome_is_known_again_after_a_restart(tmp_path):
    log = EventLog(tmp_path / "events.jsonl")
    event = FleetEvent(
        vehicle="d1", log="x", seq=1, epoch_us=0, kind=EventKind.OUTCOME, text="", assignment="a1"
    )
    log.append(event)
    log.close()
    again = EventLog(tmp_path / "events.jsonl")
    assert again.has_outcome("a1")
    assert not again.has_outcome("a2")
    again.close()


@pytest.mark.parametrize(
    "deed", [Launch(assignment="a1"), Assign(assignment="a1", order="o1", flight={})]
)
def test_no_flight_begins_that_would_outlast_the_certificate_and_a_recall_is_taken(port, deed):
    assert ask(port, deed).answer is Answered.DONE
    port.begin_trouble = lambda: "the certificate of d1 ends in 9 min"
    assert ask(port, deed).answer is Answered.DONE  # answered before: it is known, not begun anew
    refused = ask(port, deed, "c2")
    assert (refused.answer, refused.reason) == (
        Answered.REFUSED,
        "the certificate of d1 ends in 9 min",
    )
    assert ask(port, Recall(), "c3").answer is Answered.DONE


def test_what_is_aboard_stays_aboard_when_the_certificate_ends(port):
    port.take_aboard(fleet_port.Assigned(assignment="a1", order="o1"))
    port.begin_trouble = lambda: "the certificate of d1 ends in 9 min"
    again = Assign(assignment="a1", order="o1", flight={})
    assert ask(port, again).answer is Answered.DONE
