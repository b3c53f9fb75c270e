"""A person closes an order whose vehicle cannot report any more, with all dependent records."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from companion.fleet.messages import CommandStatus, Withdraw
from ground_station.adapters.store.settle import close_order_with_outcome
from ground_station.app.cli.main import app
from ground_station.core.schema.order_states import ParcelOutcome
from ground_station.core.schema.orders import AssignmentState, OrderState
from tests.ground_station.store.test_order_store import (
    FLIGHT,
    an_order,
    an_outcome,
    flown,
    opened,
    states,
)


@pytest.mark.parametrize(
    ("settled", "order", "assignment", "held"),
    [
        (ParcelOutcome.DELIVERED, OrderState.DELIVERED, AssignmentState.DELIVERED, False),
        (ParcelOutcome.LOST, OrderState.CANCELLED, AssignmentState.LOST, True),
        (ParcelOutcome.BACK, OrderState.OPEN, AssignmentState.RETURNED, False),
    ],
)
def test_a_settled_order_frees_its_vehicle_or_takes_it_out_of_service(
    store_url, settled, order, assignment, held
):
    with opened(store_url) as store:
        store.add_orders_unless_conflict([an_order("o1"), an_order("o2")])
        id_ = flown(store)
        said = close_order_with_outcome(
            store.database, lambda: 1, "o1", settled, "asked the customer", "anna"
        )
        assert said is not None
        assert states(store)["o1"] is order
        (row,) = store.assignments()
        assert row.state is assignment
        assert "says anna: asked the customer" in row.reason
        assert [hold.scope for hold in store.holds_in_force()] == (["d1"] if held else [])
        assert (store.assign_order("o2", "d1", FLIGHT, None, "desk") is None) == held
        store.record_event_batches(
            [([an_outcome(id_, "FAIL")], False)]
        )  # a late log: a person has decided
        assert states(store)["o1"] is order


def test_a_mission_that_may_still_be_aboard_is_withdrawn(store):
    store.add_orders_unless_conflict([an_order("o1")])
    id_ = store.assign_order("o1", "d1", FLIGHT, None, "desk")
    store.record_and_apply_response(f"{id_}:assign", CommandStatus.DONE, "", "life")
    close_order_with_outcome(
        store.database, lambda: 1, "o1", ParcelOutcome.BACK, "never left", "anna"
    )
    assert [(row.vehicle, row.command) for row in store.outbox()] == [
        ("d1", Withdraw(assignment="o1.1"))
    ]


def test_the_command_wants_one_word_a_reason_and_an_order_that_is_under_way(tmp_path: Path):
    url, runner = f"sqlite:///{tmp_path}/d.db", CliRunner()
    with opened(url) as store:
        store.add_orders_unless_conflict([an_order("o1"), an_order("o2")])
        flown(store)

    def run(*arguments: str) -> str:
        done = runner.invoke(app, ["order", "settle", *arguments, "--store", url, "--user", "anna"])
        return done.output + str(done.exception or "")

    assert "expected one of --delivered" in run("o1", "--reason=x")
    assert "expected one of --delivered" in run("o1", "--reason=x", "--lost", "--back")
    assert "o2: open, expected assigned or stuck or cancelled" in run("o2", "--reason=x", "--back")
    assert "o9: not known" in run("o9", "--reason=x", "--back")
    said = run("o1", "--reason=found it", "--lost")
    assert said == "o1: cancelled; d1 is out of service: held until it is released\n"
    assert run("o1", "--reason=found after all", "--back") == "o1: open\n"
