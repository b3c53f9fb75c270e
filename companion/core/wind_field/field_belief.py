"""One belief of the wind over a site: what members told, and the forecast before that.

With at most `MOST_STRETCHES` means of what was told all is worked out anew each time, in a few
milliseconds (`settled_field`). Members that contradict the others are left out (`agreement`).
"""

from dataclasses import replace

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.wind_field import standing
from companion.core.wind_field.agreement import contradicting
from companion.core.wind_field.field_process import FieldProcess
from companion.core.wind_field.front_term import FrontTerm
from companion.core.wind_field.fronts import FrontAhead
from companion.core.wind_field.settled_field import AirState, SettledField, WindPrior
from companion.core.wind_field.tellings import (
    JOINED_S,
    KEPT_S,
    MOST_AGE_S,
    TELLING_S,
    KeptStretches,
    MemberTellings,
    Stretch,
    WindTelling,
)

MOST_STRETCHES = 150
"""With a hundred drones the newest two minutes; with eight all that is kept."""
_CROWD = 12
"""More members than that join their fresh tellings over longer: there is enough of them."""

_NEWER_S = 2.0
"""A belief of this moment says something new so long after the last one that is kept."""

_SPARE_STRETCHES = 3
"""Kept of each member beyond its share: some tell less often, or leave."""

LEAST_MISFIT, MOST_MISFIT = 1.1, 6.0
"""What was told differs by more than the process says, squared: gustier air, or a front. The
process's variances are then taken so many times as large."""

FRONT_COUNTS_S = KEPT_S + 300.0
"""After it was noticed: it has left the site, and nothing told before it is kept."""

LEARNED_S = 60.0
"""The ground's part is learned at most so often: it about doubles what an update costs."""


class FieldBelief:
    """Follows what members tell; one per desk or vehicle. `prior` None: any wind."""

    def __init__(self, process: FieldProcess, prior: WindPrior | None = None) -> None:
        self._process = process
        self._prior = prior or WindPrior((0.0, 0.0), process.process.level_std_mps)
        self._members: dict[str, MemberTellings] = {}
        self._front: FrontAhead | None = None
        self._ground = standing.StandingShare()

    def expect_front(self, front: FrontAhead | None) -> None:
        """A front that is believed from now on, or better known; None: there is none any more.

        It counts while somebody is believed who has felt it, until what was told before it is gone.
        """
        self._front = front

    def expect(self, prior: WindPrior) -> None:
        """What is expected where nobody tells, from now on: a forecast moves on with the time."""
        self._prior = prior

    def tell(self, telling: WindTelling, now_s: float) -> str:
        """Take a telling (any rate; thinned inside); returns why it is left out, or empty.

        Times are the receiver's own: one from long ago, or from the future, is left out.
        """
        if not -1.0 <= now_s - telling.t_s <= MOST_AGE_S:
            return f"{now_s - telling.t_s:.0f} s old"
        crowd = min(TELLING_S * -(-len(self._members) // _CROWD), JOINED_S)
        return self._members.setdefault(telling.member, MemberTellings()).take(telling, crowd)

    @property
    def standing_share(self) -> float:
        """What the ground is seen to do to the wind, over the mean wind; 0: nothing."""
        return self._ground.share

    def drop(self, member: str) -> None:
        """Forget all that a member told."""
        self._members.pop(member, None)

    def settle(
        self,
        now_s: float,
        always: str = "",
        firm: frozenset[str] = frozenset(),
        newest: WindTelling | None = None,
    ) -> SettledField:
        """The field as believed now. `always` is the vehicle itself: never left out. Nor is who is
        `firm`: that is judged elsewhere. `newest`: what it feels at this moment, not kept.
        """
        each = MOST_STRETCHES // max(len(self._members), 1) + _SPARE_STRETCHES
        for name in list(self._members):
            self._members[name].forget(now_s, each)
            if not self._members[name].stretches and not self._members[name].is_frozen:
                del self._members[name]
        kept = KeptStretches.of(self._with(newest), MOST_STRETCHES)
        out: dict[str, str] = {}
        if not kept.count.size or now_s < self._ground.learned_s:
            self._ground = standing.StandingShare()
        judged = AirState(standing_share=self._ground.share)
        while True:
            settled = self._settled(kept, now_s, judged)
            bad = contradicting(settled.mean_shift_squares, kept, now_s, always, firm)
            if not bad:
                break
            out |= bad
            kept = kept.without(frozenset(bad))
        # Not before: a front would excuse the one who made it up.
        front = self._front_of(kept, now_s)
        due = now_s - self._ground.learned_s >= LEARNED_S
        if due:
            self._learn(kept, now_s, front, settled)
        air = AirState(1.0, self._ground.share, front)
        if air != judged:
            settled = self._settled(kept, now_s, air, settled)
        return settled.leaving_out(out)

    def _learn(
        self, kept: KeptStretches, now_s: float, front: FrontTerm | None, same: SettledField
    ) -> None:
        """How much the ground does to the wind, by what is kept."""
        logs = self._log_likelihoods(kept, now_s, front, same)
        told = {
            kept.members[int(number)]: logs[:, kept.member == number].sum(axis=1)
            for number in np.unique(kept.member)
        }
        everybody, others = logs.sum(axis=1), np.zeros(len(standing.SHARES))
        if len(told) > standing.LEAST_OTHERS:
            most = self._ground.says_most(told, now_s)
            others = self._log_likelihoods(kept.without(frozenset([most])), now_s, front)
            others = others.sum(axis=1)
        self._ground.learn(everybody, others, now_s)

    def _log_likelihoods(
        self,
        kept: KeptStretches,
        now_s: float,
        front: FrontTerm | None,
        same: SettledField | None = None,
    ) -> Floats:
        """For each of `standing.SHARES` that of each stretch told since the last time (shares, n);
        0 of those told before.
        """
        logs: list[Floats] = []
        newer = kept.middle[:, 0] > self._ground.learned_s
        for share in standing.SHARES:
            same = self._settled(kept, now_s, AirState(1.0, share, front), same)
            logs.append(np.where(newer, same.log_likelihoods(), 0.0))
        return np.array(logs)

    def _settled(
        self,
        kept: KeptStretches,
        now_s: float,
        air: AirState,
        same: SettledField | None = None,
    ) -> SettledField:
        """By what is kept; as gusty as it makes the air. `same`: of this kept already."""
        settled = SettledField(self._process, self._prior, kept, now_s, air, same)
        if (misfit := settled.misfit()) <= LEAST_MISFIT:
            return settled
        gustier = replace(air, gustier=min(misfit, MOST_MISFIT))
        return SettledField(self._process, self._prior, kept, now_s, gustier, settled)

    def _front_of(self, kept: KeptStretches, now_s: float) -> FrontTerm | None:
        """The front as far as it counts."""
        front = self._front
        if front is None or now_s - front.noticed_s > FRONT_COUNTS_S:
            return None
        believed = {kept.members[int(k)] for k in np.unique(kept.member)}
        return FrontTerm(front) if any(one.member in believed for one in front.felt) else None

    def _with(self, newest: WindTelling | None) -> dict[str, MemberTellings]:
        """All members, one of them with what it feels at this moment."""
        if newest is None or newest.trouble():
            return self._members
        before = self._members.get(newest.member, MemberTellings()).stretches
        if before and newest.t_s - before[-1].last[0] < _NEWER_S:
            return self._members
        return self._members | {newest.member: MemberTellings([*before, Stretch.of(newest)])}
