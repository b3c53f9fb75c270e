"""What must hold of a flight under a fault, judged by truth and by what was sent and said."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from sim_bridge.app.faults.stage import Stage

BROKEN, USAGE = 1, 2
"""Exit codes of a companion that met an error inside, or a mistake in what it was given."""

TRACEBACK = "Traceback (most recent call last)"


@dataclass(frozen=True, slots=True)
class FlownFault:
    """A flight that has ended: its row by truth, its stage, and the companion's own words."""

    row: dict[str, Any]
    stage: Stage
    words: str
    """All that the companion printed and logged."""

    @property
    def said(self) -> list[str]:
        """What the operator was told, in order."""
        return [text for _, text in self.stage.craft.operator.said]

    @property
    def said_since(self) -> list[str]:
        """What the operator was told after the fault began."""
        began_s = self.stage.began_s
        said = self.stage.craft.operator.said
        return [text for at_s, text in said if began_s is not None and at_s >= began_s]

    @property
    def commands_after_takeover(self) -> int:
        """Commands after the companion could know that a person had taken over."""
        taken_s = self.stage.took_over_s
        if taken_s is None:
            return 0
        return sum(at_s > taken_s for at_s, _, _ in self.stage.craft.commands)

    @property
    def p_home_last_go(self) -> float | None:
        """P(home) that the companion promised at its last decision to go on outward."""
        gone = [d for d in self.row["decisions"] if d["kind"] in ("go", "onward", "descend")]
        promised = [d["p_home"] for d in gone if d.get("p_home") is not None]
        return promised[-1] if promised else None

    @property
    def exceptions(self) -> int:
        """Tracebacks in what the companion printed and logged."""
        return self.words.count(TRACEBACK)


Ask = Callable[[FlownFault], str | None]
"""What is wrong with a flight by one rule, in a few words; None: it holds."""


def raises_nothing(flown: FlownFault) -> str | None:
    """No exception reaches anybody."""
    return f"{flown.exceptions} exceptions" if flown.exceptions else None


def ends_in_order(flown: FlownFault) -> str | None:
    """The companion ends by no error of its own: not broken, not taking its own files amiss."""
    code = flown.stage.craft.companion.exit_code
    return f"exit code {code}" if code in (BROKEN, USAGE) else None


def comes_home(flown: FlownFault) -> str | None:
    """Landed at the depot, a rally point or the promised stop, with the reserve, by truth."""
    has_crashed = flown.stage.craft.vehicle.is_crashed
    if flown.row["home"] and not has_crashed:
        return None
    crashed = ", crashed" if has_crashed else ""
    return f"not home ({flown.row['outcome']}, {flown.row['margin_wh']:+.1f} Wh{crashed})"


def delivers(flown: FlownFault) -> str | None:
    """The fault costs no delivery either."""
    return None if flown.row["delivered"] else "not delivered"


def claims_no_delivery(flown: FlownFault) -> str | None:
    """It does not say that it delivered what truly stayed aboard."""
    if flown.row["delivered"]:
        return None
    claimed = any(text.startswith("delivered") for text in flown.said)
    return "said to be delivered, and aboard" if claimed else None


def fault_began(flown: FlownFault) -> str | None:
    """A flight that ended before its fault shows nothing."""
    return None if flown.stage.began_s is not None else "the fault never began"


def hands_off(flown: FlownFault) -> str | None:
    """Not one command after a person has taken over."""
    if flown.stage.took_over_s is None:
        return "nobody took over"
    sent = flown.commands_after_takeover
    return f"{sent} commands after the take-over" if sent else None


def stays_in_hand(flown: FlownFault) -> str | None:
    """The companion flies it to the end: nobody made it believe in another hand."""
    off = [text for text in flown.said if text.startswith("hands off")]
    return f"said {off[0]!r}, and nobody took over" if off else None


def is_taken(flown: FlownFault) -> str | None:
    """Down whole where a person landed it, by truth and by the companion's own verdict."""
    own = [d["reason"] for d in flown.row["decisions"] if d["kind"] == "finished"]
    if flown.row["outcome"] != "TAKEN":
        return f"by truth {flown.row['outcome']}"
    return None if own and own[-1].startswith("TAKEN") else f"by the companion {own or 'nothing'}"


def stays_disarmed(flown: FlownFault) -> str | None:
    """What a person disarmed stays disarmed."""
    return "armed again" if flown.stage.armed else None


def stays_down(flown: FlownFault) -> str | None:
    """It never leaves the ground."""
    return None if flown.stage.craft.record.took_off_s is None else "it took off"


def _is_down_by(flown: FlownFault, t_s: float) -> bool:
    landed_s = flown.stage.craft.record.landed_s
    return landed_s is not None and landed_s <= t_s


def tells(*words: str, within_s: float | None = None, unless_down_within_s: float = 0.0) -> Ask:
    """The operator hears one of these words (in time) after the fault began, where the flight lasts
    long enough to find it.
    """

    def ask(flown: FlownFault) -> str | None:
        began_s = flown.stage.began_s
        if began_s is None:
            return "the fault never began"
        limit_s = began_s + (within_s if within_s is not None else 1e9)
        said = flown.stage.craft.operator.said
        heard = [t.lower() for at_s, t in said if began_s <= at_s <= limit_s]
        if any(word in text for text in heard for word in words):
            return None
        if unless_down_within_s and _is_down_by(flown, began_s + unless_down_within_s):
            return None
        return f"the operator did not hear {' or '.join(repr(word) for word in words)}"

    return ask


def keeps_aside(name: str) -> Ask:
    """In the run folder lies a torn record under this name."""

    def ask(flown: FlownFault) -> str | None:
        path = flown.stage.craft.run_dir / name
        return None if path.exists() else f"no {name} in its folder"

    return ask


def notes(what: str) -> Ask:
    """The play itself has seen it."""

    def ask(flown: FlownFault) -> str | None:
        return None if what in flown.stage.notes else f"not seen: {what}"

    return ask


def promises_nothing_false(flown: FlownFault) -> str | None:
    """It did not go on with a promise of 0.99 that it then broke."""
    promised = flown.p_home_last_go
    if promised is None or promised < 0.99 or flown.row["home"] or flown.row["outcome"] == "TAKEN":
        return None
    return f"P(home) {promised:.3f} was said, and it did not come home"
