"""A step of the reported heading in flight, as an autopilot's emergency yaw reset reports it.

Truth is the simulated wind; the companion reads its attitude from the wire.
"""

import math

import numpy as np
import pytest

from companion.adapters.logs.decision_log import read_mcap_rows
from companion.core.mission.alerts import Alert
from sim_bridge.app.faults.fault import SAFETY_RULES, FaultCase, FaultTask
from sim_bridge.app.faults.runner import fly_case
from sim_bridge.app.faults.verdict import check_alert_sent
from sim_bridge.app.link.tap import message_with_changed_fields
from sim_bridge.app.world.flight_phase import FlightPhase

pytestmark = pytest.mark.sitl


def turned_by(by_rad):
    def change(message):
        if message.msg_name != "ATTITUDE":
            return None
        return [
            message_with_changed_fields(message, yaw=math.remainder(message.yaw + by_rad, math.tau))
        ]

    return change


class HeadingSteps:
    """A play: the reported heading is off by these angles in turn, each for its duration."""

    def __init__(self, *steps):
        self.steps = steps  # (degrees, seconds)
        self.began_s = self.ended_s = math.inf
        self.wind = []

    def __call__(self, stage):
        yield from stage.wait_for_phase_and_record_fault_start()
        self.began_s = stage.t_s
        for deg, for_s in self.steps:
            stage.tap.to_companion = turned_by(math.radians(deg))
            for _ in stage.wait(for_s):
                self.note(stage)
                yield
        stage.tap.to_companion = lambda message: None
        self.ended_s = stage.t_s
        while True:
            self.note(stage)
            yield

    def note(self, stage):
        north, east, _ = stage.craft.vehicle.truth.wind_to_ned_mps
        self.wind.append((stage.t_s, north, east))

    def sigmas(self, folder):
        """Return the wind error over its standard deviation from 5 s after the last step on."""
        truth = np.array(self.wind)
        found = []
        for topic, row in read_mcap_rows(folder / "decisions.mcap").rows:
            if topic != "wind" or not self.ended_s + 5.0 <= row["t_s"] <= truth[-1, 0] - 6.0:
                continue
            near = np.abs(truth[:, 0] - row["t_s"]) <= 5.0
            error = np.array([row["to_n_mps"], row["to_e_mps"]]) - truth[near, 1:].mean(axis=0)
            cov = [[row["nn_m2ps2"], row["ne_m2ps2"]], [row["ne_m2ps2"], row["ee_m2ps2"]]]
            found.append(math.sqrt(error @ np.linalg.solve(cov, error)))
        return np.array(found)


def flown(tmp_path, play, autopilot, phase, seed):
    asks = (*SAFETY_RULES, check_alert_sent(Alert.HEADING_UNUSABLE, within_s=1.0))
    case = FaultCase(38, "heading-steps", "air and sensors", "the heading steps", play, asks)
    row = fly_case(case, FaultTask(case.name, autopilot, FlightPhase(phase), seed, tmp_path))
    (folder,) = tmp_path.glob("heading-steps-*/*/decisions.mcap")
    return row, folder.parent


@pytest.mark.sample
@pytest.mark.drawn(keep=1, of="seed")
@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_a_heading_step_does_not_become_wind(tmp_path, autopilot, seed):
    steps = {
        1: [(160.0, 8.0)],
        2: [(90.0, 2.0), (-120.0, 3.0), (30.0, 8.0)],
        3: [(-45.0, 20.0)],
    }[seed]
    phase = ("outbound", "return", "climb")[seed - 1]
    play = HeadingSteps(*steps)
    row, folder = flown(tmp_path, play, autopilot, phase, seed)
    assert row.passed, (row.failure_text, row.messages)
    sigmas = play.sigmas(folder)
    assert len(sigmas) > 20
    # Of two axes 3 sigma of each is a norm of up to 4.24.
    assert sigmas.max() < 4.24
    assert sum("heading stepped" in text for text in row.messages) <= len(steps) + 1
