"""Safety rule 4, for any telemetry: the energy left never increases."""

import json

from hypothesis import given, settings
from hypothesis import strategies as st

from companion.adapters.files.params import read_airframe
from companion.core.vehicle.energy_ledger import BatteryObservation, EnergyLedger

M100 = read_airframe("m100")

number = st.one_of(
    st.none(),
    st.floats(min_value=0.0, max_value=200.0),
    st.sampled_from([-1.0, 0.0, float("nan"), float("inf"), 65535.0]),
)
frac = st.one_of(st.none(), st.floats(min_value=0.0, max_value=1.0), st.just(-0.01))
observation = st.builds(
    dict,
    step_s=st.sampled_from([0.0, 0.1, 1.0, 30.0, -5.0]),
    at_rest=st.booleans(),
    voltage_v=number,
    current_a=number,
    consumed_mah=number,
    consumed_wh=number,
    remaining_frac=frac,
    remaining_is_timer=st.booleans(),
    temperature_c=st.one_of(st.none(), st.floats(-30.0, 60.0)),
    modelled_power_w=number,
    source=st.sampled_from(["vehicle", "pack 0", "pack 1"]),
)


@settings(max_examples=60, deadline=None)
@given(
    seen=st.lists(observation, min_size=1, max_size=25),
    restart_at=st.integers(0, 25),
)
def test_energy_left_never_rises_from_the_start_on_and_stays_finite(
    seen: list, restart_at: int
) -> None:
    book, t_s, before, begun = EnergyLedger(M100, 550.0), 100.0, None, False
    for i, one in enumerate(seen):
        known = dict(one)
        t_s += known.pop("step_s")
        book.update_from_observation(BatteryObservation(t_s, **known))
        if i == restart_at:
            kept = json.loads(json.dumps(book.snapshot()))
            book = EnergyLedger(M100, 550.0)
            book.restore(kept)
        belief = book.energy_belief_or_none()
        assert belief is not None
        assert 0.0 <= belief.mean_wh <= belief.usable_full_wh * 1.2 + 200.0
        assert 0.0 <= belief.std_wh <= belief.usable_full_wh / 12**0.5 + 1e-9
        if before is not None and begun:
            assert belief.mean_wh <= before
        before, begun = belief.mean_wh, begun or not one["at_rest"]
