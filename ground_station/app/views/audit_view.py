"""The audit as a table."""

from rich.console import RenderableType

from ground_station.app.views.terminal import plain_table
from ground_station.app.views.times import format_date_and_time
from ground_station.core.people.audit_chain import AuditRow


def audit_view(rows: list[AuditRow]) -> RenderableType:
    """Return one line for each row, oldest first. For a plain console."""
    table = plain_table("", "when", "who", "did", "to what", "answer")
    for row in rows:
        entry = row.entry
        cells = (
            format_date_and_time(entry.at_us),
            _issuer_text(row),
            entry.deed,
            entry.subject,
            entry.answer,
        )
        table.add_row(str(row.n), *cells)
    return table


def _issuer_text(row: AuditRow) -> str:
    """Return the name, with the account if it differs."""
    name, account = row.entry.who, row.entry.login.partition("@")[0]
    return name if name.removeprefix("desk/") == account else f"{name} ({row.entry.login})"
