"""Expiring certificates: texts of a running desk, `watch` and the map, and their times."""

from ground_station.app.views.certificate_reminder import CertificateReminder
from ground_station.app.views.operator_alerts import expiring_certificates_text
from ground_station.core.fleet.certificate_ends import DAY_US, CertificateExpiry

RENEW = "(ground-station pki renew)"


def ends(own: float | None, **members: float) -> CertificateExpiry:
    """Build expiry times from days since 1970."""
    own_us = None if own is None else round(own * DAY_US)
    listed = sorted((round(days * DAY_US), name) for name, days in members.items())
    return CertificateExpiry(own_us, tuple((name, end_us) for end_us, name in listed))


def test_whose_certificate_ends_within_a_month_is_named_soonest_first():
    assert expiring_certificates_text(ends(400.0, d1=12.2, d2=-3.0, d3=30.5), 0) == (
        f"d2 has ended, d1 ends in 12 days {RENEW}"
    )
    assert expiring_certificates_text(ends(20.0, d1=40.0), 0) == f"your own ends in 20 days {RENEW}"
    assert expiring_certificates_text(ends(400.0, d1=31.0), 0) == ""
    assert expiring_certificates_text(None, 0) == ""


def test_a_fleet_that_ends_on_one_day_takes_one_line():
    words = expiring_certificates_text(ends(None, **{f"d{n}": 7.0 for n in range(900)}), 0)
    assert words.endswith(f" and 895 others {RENEW}")
    assert len(words) < 160


class Network:
    """A desk's network whose roster is set by the test."""

    def __init__(self, found: CertificateExpiry | None) -> None:
        self.found, self.own_certificate_warning = found, "certificate of desk: 20 days left"

    def certificate_expiry_dates(self) -> CertificateExpiry | None:
        return self.found


class Day:
    """Messages of a reminder, each with its day."""

    def __init__(self, found: CertificateExpiry | None) -> None:
        self.said: list[tuple[float, str]] = []
        self.day = 0.0
        self.network = Network(found)
        self.reminder = CertificateReminder(
            self.network,
            lambda words: self.said.append((self.day, words)),
            lambda: round(self.day * DAY_US),
        )

    def run(self, until: float) -> None:
        while self.day < until:
            self.reminder.log_expiring_certificates_if_due(self.day * 86_400.0)
            self.day += 0.25


def test_a_desk_that_runs_across_the_day_says_it_once_a_day():
    desk = Day(ends(400.0, d1=31.5))
    desk.network.own_certificate_warning = ""
    desk.run(until=3.0)
    words = f"certificates: d1 ends in {{}} days {RENEW}"
    assert desk.said == [(2.0, words.format(30))]
    desk.run(until=4.0)
    assert desk.said[1:] == [(3.0, words.format(28))]


def test_a_new_roster_is_looked_at_at_once_and_the_own_standing_with_it():
    """The network's opener has already reported its own certificate at the start."""
    desk = Day(ends(20.0, d1=12.0))
    desk.run(until=0.25)
    assert desk.said == [
        (0.0, f"certificates: your own ends in 20 days, d1 ends in 12 days {RENEW}")
    ]
    desk.said.clear()
    desk.network.found = ends(20.0, d1=300.0)
    desk.run(until=0.75)
    assert [words for _, words in desk.said] == [
        "certificate of desk: 20 days left",
        f"certificates: your own ends in 20 days {RENEW}",
    ]


def test_without_identities_nothing_is_said():
    desk = Day(None)
    desk.run(until=3.0)
    assert desk.said == []
