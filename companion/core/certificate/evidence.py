"""Limit of evidence: the P(home) that recorded wind and certified days support.

P(home) of the gate holds if wind and draw change as their models describe. Recordings without a
contradiction bound the probability that a flight meets what they do not describe: after n
independent trials, none of them a loss, it is at most 1 - 0.05^(1/n) with 95 % probability (Clopper
and Pearson, Biometrika 26, 1934; nearly 3 / n, Hanley and Lippman-Hand, JAMA 249, 1983). Every such
event counts as a loss of the vehicle.

Trials of the wind: the recorded time behind the process, in blocks of one return. Trials of the
draw: the certificate's days, because flights of one day are not exchangeable. Both combine to one
figure by `joint_loss_upper_limit`. Without a certificate the figure is that of the wind alone.
"""

from dataclasses import dataclass

from companion.core.certificate.certificate import Certificate, percent_text
from companion.core.certificate.support import COVERAGE, joint_loss_upper_limit
from companion.core.wind.process import WindProcessParams

RETURN_S = 300.0
"""Duration of one trial of the wind: a return, and the horizon up to which changes of the wind have
Student's tails. Changes over successive blocks of this length are nearly uncorrelated."""


@dataclass(frozen=True, slots=True)
class RiskEvidence:
    """Recorded wind and certified days behind P(home)."""

    wind_process: WindProcessParams
    certificate: Certificate | None = None

    @property
    def loss_limit(self) -> float:
        """Loss that the evidence cannot exclude, with 95 % probability."""
        wind = (self.wind_process.recorded_s or 0.0) / RETURN_S
        days = () if self.certificate is None else (float(len(self.certificate.days)),)
        return joint_loss_upper_limit((wind, *days))

    @property
    def p_home_limit(self) -> float:
        """Largest P(home) that is stated to people."""
        return 1.0 - self.loss_limit

    @property
    def sources_text(self) -> str:
        """Hours, flights and days behind the limit, as text."""
        process, certificate = self.wind_process, self.certificate
        wind = (
            f"no recorded wind (wind process {process.name}: recorded_s is missing)"
            if process.recorded_s is None
            else f"{process.recorded_s / 3600.0:.1f} h of recorded wind ({process.name},"
            f" {process.recorded_s / RETURN_S:.0f} returns)"
        )
        if certificate is None:
            return f"{wind} and no certified flights"
        flights = sum(day.flights for day in certificate.days)
        return f"{wind} and {flights} certified flights on {len(certificate.days)} days"

    @property
    def summary_text(self) -> str:
        """The limit and the evidence behind it, as text."""
        return (
            f"risk of a flight at most {percent_text(self.loss_limit)}"
            f" (with {percent_text(COVERAGE)} probability) by {self.sources_text}"
        )

    def missing_support_text(self, max_loss: float) -> str:
        """Return that this accepted loss is below the limit, as text; "" if it is not."""
        if max_loss >= self.loss_limit:
            return ""
        return (
            f"accepted loss of {percent_text(max_loss)} is below the limit of evidence,"
            f" {percent_text(self.loss_limit)} by {self.sources_text}: it rests on the models"
        )
