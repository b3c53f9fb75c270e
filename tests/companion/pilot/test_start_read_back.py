"""Read-back of the mission between authorisation and arming: failed or different (fake vehicle)."""

from dataclasses import dataclass

import pytest

from companion.core.mission import events as ev
from companion.core.mission.actions import Order, VerifyMission
from companion.core.mission.alerts import Alert, is_text_of_any_alert
from companion.core.pilot.context import PilotOptions
from companion.core.pilot.transitions import Phase
from tests.companion.pilot.fake_vehicle import World, start, world

AGED_STEPS = 40
"""Steps after which the read-back of phase ready is too old to start on."""


@dataclass
class OneAnswer(World):
    """Answers the next read-back as given."""

    answer: tuple[tuple[str, ...], bool] | None = None

    def process_line(self, order: Order) -> None:
        if isinstance(order, VerifyMission) and self.answer is not None:
            differences, complete = self.answer
            self.answers.append(ev.MissionVerified(self.t_s, differences, complete))
            self.answer = None
        else:
            super().process_line(order)


@pytest.mark.parametrize(
    ("answer", "reported"),
    [((("no response",), False), False), ((("item 3: another position",), True), True)],
)
def test_only_a_difference_is_reported_as_a_changed_mission(answer, reported):
    made = world(options=PilotOptions(configure=True))
    w = OneAnswer(made.pilot, made.judge)
    start(w)
    w.until(Phase.READY)
    w.steps(AGED_STEPS)
    w.answer = answer
    w.tell(ev.MissionAuthorised(w.t_s, "255/190"))
    w.until(Phase.CLIMB)
    texts = w.said.split("; ")
    changed = [t for t in texts if is_text_of_any_alert(t, Alert.MISSION_CHANGED_ON_GROUND)]
    assert w.answer is None
    assert bool(changed) is reported


def test_a_mission_written_between_authorisation_and_arming_is_verified_before_arming():
    made = world(options=PilotOptions(configure=True))
    w = OneAnswer(made.pilot, made.judge)
    start(w)
    w.until(Phase.READY)
    w.tell(ev.MissionAuthorised(w.t_s, "255/190"))
    assert w.pilot.phase is Phase.ARM
    ours, w.items = w.items, w.items[:-1]
    w.tell(ev.MissionWriteDetected(w.t_s, "254/190 wrote the mission"))
    w.run(lambda w: w.armed)
    assert w.items == ours
    w.until(Phase.CLIMB)
