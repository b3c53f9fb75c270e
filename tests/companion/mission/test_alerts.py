"""The alert table: an alert is identified from its text, for all parameters."""

from string import Formatter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.core.mission.actions import AlertReport
from companion.core.mission.alerts import Alert, Severity, parse_alert_text
from companion.core.mission.event_text import DecisionEvent, PhaseEvent
from companion.core.pilot.transitions import Phase

TEXT_PARAMETERS = st.text(
    st.characters(blacklist_categories=["Cs", "Cc"]), min_size=1, max_size=40
).filter(lambda text: text.strip() == text)


def parameters_of(alert: Alert) -> list[tuple[str, str]]:
    return [(n, spec or "") for _, n, spec, _ in Formatter().parse(alert.text_template) if n]


def fixed_text(alert: Alert) -> str:
    return "".join(literal for literal, _, _, _ in Formatter().parse(alert.text_template))


@pytest.mark.sample
@pytest.mark.parametrize("alert", [a for a in Alert if fixed_text(a)], ids=lambda a: a.name)
@given(data=st.data())
def test_the_text_of_an_alert_leads_back_to_its_identifier_and_parameters(alert, data):
    given_ = {
        name: data.draw(st.floats(0.0, 999.0) if spec else TEXT_PARAMETERS)
        for name, spec in parameters_of(alert)
    }
    text = AlertReport(alert, given_).text
    found = parse_alert_text(text)
    assert found is not None
    if found[0] is not alert:  # the parameter matches a longer row with the same beginning
        assert len(fixed_text(found[0])) > len(fixed_text(alert))
        return
    shown = {n: format(given_[n], spec) for n, spec in parameters_of(alert)}
    # Parameters that contain the fixed text between them have an ambiguous split.
    assert alert.text_template.format(**{n: _Text(v) for n, v in found[1].items()}) == text
    if len(shown) == 1:
        assert found[1] == shown


class _Text(str):
    """Ignores the format specifier of a number: the text is already formatted."""

    def __format__(self, spec: str) -> str:
        return str(self)


def test_a_text_of_another_sender_has_no_identifier():
    for text in ("", "PreArm: Compass not calibrated", "Preflight Fail: no GPS lock"):
        assert parse_alert_text(text) is None


def test_every_alert_fits_into_two_status_texts_and_states_an_action():
    for alert in Alert:
        assert len(fixed_text(alert).encode()) <= 100, alert
        assert alert.recommended_action.endswith("."), alert
        assert isinstance(alert.severity, Severity)
    assert len({alert.text_template for alert in Alert}) == len(Alert)


@given(st.sampled_from(Phase), st.sampled_from(Phase), st.text(max_size=60))
def test_a_phase_event_is_read_as_it_was_written(before, now, reason):
    event = PhaseEvent(before.value, now.value, reason)
    assert PhaseEvent.parse(event.text) == event


@given(st.from_regex(r"\A[a-z_]{1,20}\Z"), st.text(max_size=60))
def test_a_decision_is_read_as_it_was_written(kind, reason):
    event = DecisionEvent(kind, reason)
    assert DecisionEvent.parse(event.text) == event


@given(st.from_regex(r"\A[A-Za-z0-9 _.-]{1,20}\Z"), st.text(max_size=60))
def test_the_site_of_a_diversion_is_read_as_it_was_written(site, cause):
    event = DecisionEvent.parse(DecisionEvent.create_diversion(site, cause).text)
    assert event.diversion_site == site
    assert DecisionEvent("land", event.reason).diversion_site is None
