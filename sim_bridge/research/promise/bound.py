"""Upper bound on the deliveries of any rule with the same information, on simulated wind.

The process of a simulated day is Gaussian and Markov, so its posterior given the past is exact. A
Kalman filter on the true process runs over every noisy second until the vehicle is over the
customer. Futures are drawn from its final state. This gives P(success | all that was seen) of each
mission. The bound delivers the missions where this is highest and brings all others home at no
cost. No policy that must decide en route and pay for it can do better.
"""

import numpy as np

from companion.core.base.arrays import Floats
from sim_bridge.research.promise.planner import NOISE_MPS, MissionView
from sim_bridge.research.promise.truth import Missions, TrueMissions
from sim_bridge.research.promise.world import PromiseWorld
from sim_bridge.truth.wind_days import DayProcess

FUTURES = 200


def p_success(
    world: PromiseWorld, number: int, seen: MissionView, rng: np.random.Generator
) -> float:
    """P(delivered and home), decided over the customer, given every noisy second until then.

    `rng` is the mission's own, so the noise is the noise that its planner sees.
    """
    power, profile = world.power, world.profile
    if not np.isfinite(seen.arrival_s):
        return 0.0
    process = world.days[world.blocks[world.drawn.block[number]].stretch]
    noisy = seen.wind_ne_mps + NOISE_MPS * rng.standard_normal(seen.wind_ne_mps.shape)
    now = seen.history_s + int(seen.arrival_s)
    mean, cov = filtered(process, noisy[:now])
    left_wh = power.budget_wh - power.loaded_w * seen.arrival_s / 3600.0
    if left_wh <= 0.0:
        return 0.0
    # After this many seconds its energy is spent, wherever it is.
    steps = 2 + int(power.endurance_s * left_wh / power.budget_wh + profile.landing_s + 60.0)
    wind = futures(process, mean, cov, steps, rng)
    missions = Missions(
        np.zeros(FUTURES, np.int64),
        np.tile(seen.unit_ne, (FUTURES, 1)),
        np.full(FUTURES, seen.distance_m),
    )
    flown = TrueMissions(missions, power, profile, wind)
    flown.arrival_s = np.zeros(FUTURES)  # already over the customer
    return float((flown.delivering_wh() <= left_wh).mean())


def filtered(process: DayProcess, noisy_ne_mps: Floats) -> tuple[Floats, Floats]:
    """Components' means (parts, 2) and covariance (parts, parts) one second after the last
    input.
    """
    keep = np.exp(-1.0 / np.array(process.memory_s))
    variance = np.array(process.std_mps) ** 2
    added = np.diag(variance * (1.0 - keep**2))
    mean, cov = np.zeros((3, 2)), np.diag(variance)
    for observed in noisy_ne_mps - np.array(process.mean_ne_mps):
        gain = cov.sum(axis=1) / (cov.sum() + NOISE_MPS**2)
        mean = mean + np.outer(gain, observed - mean.sum(axis=0))
        cov = cov - np.outer(gain, cov.sum(axis=0))
        mean = keep[:, None] * mean
        cov = keep[:, None] * cov * keep + added
    return mean, cov


def futures(
    process: DayProcess, mean: Floats, cov: Floats, steps: int, rng: np.random.Generator
) -> Floats:
    """FUTURES wind series (FUTURES, steps, 2) drawn from a belief over the components."""
    keep = np.exp(-1.0 / np.array(process.memory_s))[:, None]
    spread = np.array(process.std_mps)[:, None] * np.sqrt(1.0 - keep**2)
    root = np.linalg.cholesky(cov + 1e-12 * np.eye(3))
    parts = mean + np.einsum("ij,fjc->fic", root, rng.standard_normal((FUTURES, 3, 2)))
    wind = np.empty((FUTURES, steps, 2))
    for k in range(steps):
        wind[:, k] = np.array(process.mean_ne_mps) + parts.sum(axis=1)
        parts = keep * parts + spread * rng.standard_normal(parts.shape)
    return wind


def most_success(p_each: Floats, lost: float) -> float:
    """The largest expected number of successes with at most `lost` expected losses.

    Fractional knapsack: missions ranked by probability, the last one taken in part.
    """
    ranked = np.sort(p_each)[::-1]
    losses = np.cumsum(1.0 - ranked)
    whole = int((losses <= lost).sum())
    success = float(ranked[:whole].sum())
    if whole < ranked.size:
        before = float(losses[whole - 1]) if whole else 0.0
        share = (lost - before) / float(losses[whole] - before)
        success += share * float(ranked[whole])
    return success
