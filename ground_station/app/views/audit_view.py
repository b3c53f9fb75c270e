"""The audit as a table."""

from rich.console import RenderableType
from rich.text import Text

from ground_station.app.views.terminal import listing
from ground_station.app.views.times import date_and_time
from ground_station.core.people.audit_chain import AuditRow


def audit_view(rows: list[AuditRow]) -> RenderableType:
    """One line for each row, oldest first. Words from outside are shown as they are."""
    table = listing("", "when", "who", "did", "to what", "answer")
    for row in rows:
        entry = row.entry
        words = (date_and_time(entry.at_us), _who(row), entry.deed, entry.subject, entry.answer)
        table.add_row(str(row.n), *map(Text, words))
    return table


def _who(row: AuditRow) -> str:
    """The name, and the account where that is another one."""
    name, account = row.entry.who, row.entry.login.partition("@")[0]
    return name if name.removeprefix("desk/") == account else f"{name} ({row.entry.login})"
