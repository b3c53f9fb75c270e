"""Can it return: P(home) of the direct way home over wind and energy, and of a whole mission.

python examples/can_it_return.py
"""

# %% 900 m west of home, 40 m up; the wind blows to the west, against the way home
import companion

WEST_M, UP_M = 900.0, 40.0
print("wind m/s  left Wh  P(home)  margin Wh    (P(home): at most the limit of evidence)")
for wind_mps in (0.0, 6.0, 10.0):
    for left_wh in (36.0, 24.0, 12.0):
        seen = companion.can_return(
            "m100", (0.0, -WEST_M, UP_M), left_wh, wind_to_ne_mps=(0.0, -wind_mps)
        )
        print(f"{wind_mps:8.0f} {left_wh:8.0f} {seen.p_home_stated:8.3f} {seen.margin_wh:+10.1f}")

# %% A mission before take-off: the flight file params/flights/default.toml
for wind_speed_mps in (3.0, 9.0, 14.0):
    estimate = companion.assess_flight("default", wind_speed_mps=wind_speed_mps, wind_from_deg=270)
    decision = "no go" if estimate.assessment.turn_back else "go"
    print(f"mission in {wind_speed_mps:.0f} m/s: {decision}, {estimate.assessment.reason}")
