"""Certificates that end: what a running desk, `watch` and the map say of them, and when."""

import re
from pathlib import Path

from companion.fleet.roster import WARN_DAYS
from ground_station.app.views.attention import ending_certificates
from ground_station.app.views.certificate_reminder import CertificateReminder
from ground_station.core.fleet.desk_figures import DAY_US, CertificateFigures

PAGE = Path(__file__).parents[3] / "docs" / "how-to" / "watch-the-desk.md"
RENEW = "(ground-station pki renew)"


def ends(own: float | None, **members: float) -> CertificateFigures:
    """Days from 1970."""
    own_us = None if own is None else round(own * DAY_US)
    listed = sorted((round(days * DAY_US), name) for name, days in members.items())
    return CertificateFigures(own_us, tuple((name, end_us) for end_us, name in listed))


def test_whose_certificate_ends_within_a_month_is_named_soonest_first():
    assert ending_certificates(ends(400.0, d1=12.2, d2=-3.0, d3=30.5), 0) == (
        f"d2 has ended, d1 ends in 12 days {RENEW}"
    )
    assert ending_certificates(ends(20.0, d1=40.0), 0) == f"your own ends in 20 days {RENEW}"
    assert ending_certificates(ends(400.0, d1=31.0), 0) == ""
    assert ending_certificates(None, 0) == ""


def test_a_fleet_that_ends_on_one_day_takes_one_line():
    words = ending_certificates(ends(None, **{f"d{n}": 7.0 for n in range(900)}), 0)
    assert words.endswith(f" and 895 others {RENEW}")
    assert len(words) < 160


class Network:
    """A desk's network whose roster is put in by hand."""

    def __init__(self, found: CertificateFigures | None) -> None:
        self.found, self.warning = found, "certificate of desk: 20 days left"

    def certificates(self) -> CertificateFigures | None:
        return self.found


class Day:
    """Words of a reminder, and the day on which it said them."""

    def __init__(self, found: CertificateFigures | None) -> None:
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
            self.reminder.turn(self.day * 86_400.0)
            self.day += 0.25


def test_a_desk_that_runs_across_the_day_says_it_once_a_day():
    desk = Day(ends(400.0, d1=31.5))
    desk.network.warning = ""
    desk.run(until=3.0)
    words = f"certificates: d1 ends in {{}} days {RENEW}"
    assert desk.said == [(2.0, words.format(30))]
    desk.run(until=4.0)
    assert desk.said[1:] == [(3.0, words.format(28))]


def test_a_new_roster_is_looked_at_at_once_and_the_own_standing_with_it():
    """At the start the network's opener has said the own one already."""
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


def rule_days(text: str) -> list[tuple[str, int]]:
    found = re.findall(r"(leeway_desk_\w*certificate_days_left) (<=?) (\d+)", text)
    return [(f"{name} {sign}", int(days)) for name, sign, days in found]


def test_the_rule_that_the_page_gives_to_prometheus_calls_on_the_same_day():
    assert rule_days(PAGE.read_text()) == [
        ("leeway_desk_own_certificate_days_left <=", WARN_DAYS),
        ("leeway_desk_certificate_days_left <=", WARN_DAYS),
    ]
