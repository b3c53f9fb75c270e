"""The rule of docs/reference/outcomes.md predicts each decision from the published numbers."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sim_bridge import fly

ROOT = Path(__file__).resolve().parents[2]
MAX_LOSS, MIN_SUCCESS = 0.01, 0.05
END_OF_OUTBOUND = ("turn_back", "divert", "delivered", "release_unconfirmed")
FLY_ON = ("go", "onward", "onward_again", "descend")


def turns_back(row: dict[str, Any]) -> bool:
    required, now = row["required_p_home"], row["p_home_now"]
    p_home, p_success = row["p_home_onward"], row["p_success_onward"]
    if row["p_home_next"] < required:
        if now >= row["p_home_next"] - 0.002:
            return True
    elif p_success < MIN_SUCCESS and now >= min(required, p_home) - 0.002:
        return True
    return p_success + required * (p_home - p_success) < required * (now - 0.0005)


def diverts_to(row: dict[str, Any], home: str) -> str | None:
    """Return the landing site of a diversion if the straight line there is clear."""
    p_home = {site["landing"]: site["p_home_now"] for site in row["sites"]}
    best = next(name for name in p_home if p_home[name] >= max(p_home.values()) - 0.002)
    if best == home or p_home.get(home, 0.0) >= 1.0 - MAX_LOSS:
        return None
    return best if p_home[best] > p_home.get(home, -1.0) + 0.02 else None


def mismatches(result: dict[str, Any], home: str = "depot") -> list[str]:
    """Return decisions that the rule does not predict, and predictions without a decision."""
    found: list[str] = []
    decisions = [row for row in result["decisions"] if row["p_home"] is not None]
    start_s = next((row["t_s"] for row in decisions if row["kind"] == "go"), np.inf)
    outbound_s = next((r["t_s"] for r in decisions if r["kind"] in END_OF_OUTBOUND), np.inf)
    for row in decisions:
        is_outbound = row["t_s"] <= outbound_s
        at = f"{row['t_s']} {row['kind']}: {row['reason']}"
        if row["kind"] in FLY_ON and turns_back(row):
            found.append(f"{at}: predicted to turn back")
        if row["kind"] in ("turn_back", "divert") and is_outbound and not turns_back(row):
            found.append(f"{at}: predicted to fly on")
        if row["kind"] == "divert" and not row["reason"].startswith(f"to {diverts_to(row, home)}:"):
            found.append(f"{at}: predicted {diverts_to(row, home)}")
        for site in row["sites"]:
            if (site["margin_now_wh"] < 0.0) != (site["p_home_now"] < 1.0 - MAX_LOSS):
                found.append(f"{at}: {site}")
    for row in result["assessments"]:
        if start_s < row["t_s"] < outbound_s - 1.5 and turns_back(row):
            found.append(f"{row['t_s']}: predicted to turn back, and flew on")
    answered_s = min(
        (r["t_s"] for r in decisions if r["kind"] in ("divert", "divert_blocked")), default=np.inf
    )
    for row in result["assessments"]:
        if outbound_s < row["t_s"] < answered_s - 1.5 and diverts_to(row, home):
            found.append(f"{row['t_s']}: predicted {diverts_to(row, home)}, and flew home")
    return found


@pytest.mark.sitl
@pytest.mark.drawn(keep=4)
@pytest.mark.parametrize("seed", range(1, 201))
def test_the_documented_rule_predicts_each_decision(seed: int, tmp_path: Path) -> None:
    text, random = (ROOT / "params/flights/default.toml").read_text(), np.random.default_rng(seed)
    for shipped, drawn in (
        ("charge_frac = 0.8", f"charge_frac = {random.uniform(0.56, 0.85):.3f}"),
        (
            "t_s = 160.0, speed_mps = 12.0",
            f"t_s = {random.uniform(80.0, 200.0):.1f}, speed_mps = 13.0",
        ),
        (
            "speed_mps = 13.0, from_deg = 76.0 },\n]",
            f"speed_mps = {random.uniform(9.0, 16.0):.2f}, from_deg = 76.0 }},\n]",
        ),
        ("../sites/", f"{ROOT}/params/sites/"),
    ):
        assert shipped in text
        text = text.replace(shipped, drawn)
    (tmp_path / "flight.toml").write_text(text)
    autopilot = "px4" if seed % 2 else "ardupilot"
    (flown,) = fly(tmp_path / "flight.toml", autopilot=autopilot, seed=seed, runs=tmp_path)
    result = json.loads((flown.run / "result.json").read_text())
    assert result["assessments"]
    assert mismatches(result) == []
    closed = [dict(row, p_home_next=0.9) for row in result["decisions"] if row["kind"] == "go"]
    assert all(turns_back(row) for row in closed), "a lower P(home) changes the prediction"
