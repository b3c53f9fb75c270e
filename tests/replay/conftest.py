"""A flight in known wind, and writers of every log format that share no code with the readers."""

import pytest

from sim_bridge.app.trials.log_writers import (
    battery_csv_columns,
    telemetry_csv_columns,
    write_csv,
    write_dataflash,
    write_tlog,
    write_ulog,
)
from sim_bridge.app.trials.synthetic_flight import (
    CURRENT_A,
    LAT_DEG,
    VOLTAGE_V,
    SyntheticFlight,
    build_outbound_flight,
    build_square_flight,
)


@pytest.fixture(scope="session")
def world() -> SyntheticFlight:
    return build_square_flight()


@pytest.fixture(scope="session")
def make():
    """Return the writers and flights of this file; test modules cannot import each other."""
    from types import SimpleNamespace

    return SimpleNamespace(
        build_square_flight=build_square_flight,
        build_outbound_flight=build_outbound_flight,
        telemetry_csv_columns=telemetry_csv_columns,
        battery_csv_columns=battery_csv_columns,
        csv=write_csv,
        ulog=write_ulog,
        dataflash=write_dataflash,
        tlog=write_tlog,
        lat_deg=LAT_DEG,
        voltage_v=VOLTAGE_V,
        current_a=CURRENT_A,
    )
