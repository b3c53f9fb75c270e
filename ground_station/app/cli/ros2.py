"""`ground-station ros2`: publishes the vehicles' states to ROS 2."""

from contextlib import closing
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated

import typer

from companion.fleet.service_manager import record_stop_signals
from ground_station.adapters.clock import epoch_us, monotonic_s
from ground_station.app.options.desk_options import desk_options, echo_with_time_of_day
from ground_station.app.options.program_options import command_class_with_options

if TYPE_CHECKING:
    from companion.fleet.messages import State
    from ground_station.adapters.ros2_session import RosSession

STALE_AFTER_S = 10.0
DIAGNOSTICS_INTERVAL_S = 1.0
REQUEST_INTERVAL_S = 60.0

app = typer.Typer()


@app.command(cls=command_class_with_options("fleet", "zenoh", "identity", "open_network"))
def ros2(
    ros: Annotated[
        str, typer.Option(metavar="ENDPOINT", help="Router of ROS 2 (rmw_zenohd).")
    ] = "tcp/localhost:7447",
    domain: Annotated[int, typer.Option(min=0, max=232, help="ROS_DOMAIN_ID.")] = 0,
    humble: Annotated[
        bool, typer.Option("--humble", help="For ROS 2 Humble, which has no type hashes.")
    ] = False,
    max_loss: Annotated[
        float,
        typer.Option(
            min=0.0,
            max=1.0,
            help="Diagnostics are ERROR where P(home) is below 1 minus this value.",
        ),
    ] = 0.01,
) -> None:
    """Publish wind, margin, P(home) and diagnostics of a fleet to ROS 2 over zenoh.

    Topics: /leeway/VEHICLE/wind (TwistWithCovarianceStamped, east-north-up, direction TO),
    /margin_wh, /p_home, /p_success, /energy_left_wh (Float64), and /diagnostics. Nothing is
    received from ROS 2. ROS 2's network is not encrypted: everybody on it reads the values.
    Ctrl-C stops.

    ground-station ros2 --fleet harbour --ros tcp/localhost:7447
    """
    from ground_station.adapters.ros2_session import RosSession
    from ground_station.core.fleet.fleet_link import StateReceived

    options = desk_options()
    fleet = options.require_fleet_name()
    diagnostics_due_s = request_due_s = monotonic_s()
    with (
        closing(options.open_fleet_network(fleet)) as network,
        closing(RosSession(ros, domain, is_humble=humble)) as session,
        record_stop_signals() as received_signals,
    ):
        bridge = _RosBridge(session, max_loss)
        typer.echo(f"fleet {fleet} is published in the clear at {ros}; Ctrl-C stops")
        while not received_signals:
            for found in network.receive(0.2):
                if isinstance(found, StateReceived):
                    bridge.publish_state(found.state)
            now_s = monotonic_s()
            if now_s >= request_due_s:
                network.request_states(1.0)
                request_due_s = now_s + REQUEST_INTERVAL_S
            if now_s >= diagnostics_due_s:
                bridge.publish_diagnostics(now_s)
                diagnostics_due_s = now_s + DIAGNOSTICS_INTERVAL_S


@dataclass(slots=True)
class _RosBridge:
    """Publishes each state, and the diagnostics of all vehicles."""

    session: "RosSession"
    max_loss: float
    _newest: "dict[str, tuple[State, float]]" = field(default_factory=dict)
    """State and time of its arrival, by vehicle."""
    _vehicle_by_topic: dict[str, str] = field(default_factory=dict)
    _skipped: set[str] = field(default_factory=set)

    def publish_state(self, state: "State") -> None:
        """Publish wind and values. Of vehicles with one name in ROS 2 only the first is published;
        the others are logged once.
        """
        from ground_station.core.fleet.ros2_messages import topic_name_of, vehicle_messages

        vehicle, topic = state.vehicle, topic_name_of(state.vehicle)
        first = self._vehicle_by_topic.setdefault(topic, vehicle)
        if first != vehicle:
            if vehicle not in self._skipped:
                self._skipped.add(vehicle)
                echo_with_time_of_day(
                    f"{vehicle}: not published, its ROS 2 name {topic} is that of {first};"
                    " expected names that differ in letters or digits"
                )
            return
        if vehicle not in self._newest:
            echo_with_time_of_day(f"{vehicle}: first state")
        self._newest[vehicle] = state, monotonic_s()
        now_us = epoch_us()
        for message in vehicle_messages(state, now_us):
            self.session.publish(message, now_us)

    def publish_diagnostics(self, now_s: float) -> None:
        """Publish one status for each vehicle."""
        from ground_station.core.fleet.ros2_messages import diagnostics_message

        states = {
            vehicle: (state, now_s - received_s > STALE_AFTER_S)
            for vehicle, (state, received_s) in self._newest.items()
        }
        now_us = epoch_us()
        self.session.publish(diagnostics_message(states, now_us, self.max_loss), now_us)
