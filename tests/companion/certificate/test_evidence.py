"""The limit of evidence against Clopper and Pearson's limit, random numbers and the wind file."""

import numpy as np
import pytest
from scipy.stats import beta

from companion.adapters.files.params import read_wind_process
from companion.core.base.probability import home_probability_text
from companion.core.certificate.evidence import RETURN_S, RiskEvidence
from companion.core.certificate.support import (
    joint_loss_upper_limit,
    loss_upper_confidence_limit,
)
from tests.companion.certificate.test_certificate import certificate


@pytest.mark.parametrize("trials", [3, 22, 299])
def test_one_source_gives_the_limit_of_clopper_and_pearson(trials: int) -> None:
    assert joint_loss_upper_limit((trials,)) == pytest.approx(beta.ppf(0.95, 1, trials), abs=1e-6)
    assert joint_loss_upper_limit((trials,)) == pytest.approx(
        loss_upper_confidence_limit(trials), abs=1e-6
    )


@pytest.mark.parametrize("trials", [(22.1, 12.0), (12.0, 12.0), (3.0, 500.0)])
def test_two_sources_give_the_quantile_of_drawn_losses(trials: tuple[float, float]) -> None:
    random = np.random.default_rng(1)
    lost = 1.0 - np.prod([random.beta(n, 1.0, 1_000_000) for n in trials], axis=0)
    assert joint_loss_upper_limit(trials) == pytest.approx(np.quantile(lost, 0.95), abs=2e-3)


def test_without_recorded_wind_no_probability_is_stated() -> None:
    assert joint_loss_upper_limit((0.0, 12.0)) == 1.0


def test_the_shipped_wind_supports_what_its_seconds_allow_and_names_them() -> None:
    process = read_wind_process("coast")
    alone, both = RiskEvidence(process), RiskEvidence(process, certificate())
    assert process.recorded_s == 6640.0
    assert alone.loss_limit == pytest.approx(1.0 - 0.05 ** (RETURN_S / 6640.0), abs=1e-6)
    assert both.loss_limit > alone.loss_limit
    assert "1.8 h of recorded wind (coast, 22 returns)" in alone.missing_support_text(0.01)
    assert "11 certified flights on 11 days" in both.missing_support_text(0.01)
    assert alone.missing_support_text(0.2) == ""


@pytest.mark.parametrize(
    ("p_home", "limit", "text"),
    [
        (1.0, 1.0 - 1.0 / 330.0, "risk at most 1 in 330 (limit of evidence)"),
        (0.98349, 0.99, "0.9834"),
        (0.99999, 1.0, "above 0.9999"),
        (1.0, 1.0, "above 0.9999"),
        (0.9999, 1.0, "0.9999"),
    ],
)
def test_people_are_never_shown_more_than_the_evidence(
    p_home: float, limit: float, text: str
) -> None:
    assert home_probability_text(p_home, limit) == text
