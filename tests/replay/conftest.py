"""A flight of known wind, and writers of every log format that share no code with the readers."""

import pytest

from sim_bridge.app.trials.log_writers import (
    battery_columns,
    csv_columns,
    write_csv,
    write_dataflash,
    write_tlog,
    write_ulog,
)
from sim_bridge.app.trials.made_flight import (
    CURRENT_A,
    LAT_DEG,
    VOLTAGE_V,
    MadeFlight,
    square_flight,
    straight_out,
)


@pytest.fixture(scope="session")
def world() -> MadeFlight:
    return square_flight()


@pytest.fixture(scope="session")
def make():
    """The writers and worlds of this file, for test modules (they cannot import each other)."""
    from types import SimpleNamespace

    return SimpleNamespace(
        square_flight=square_flight,
        straight_out=straight_out,
        csv_columns=csv_columns,
        battery_columns=battery_columns,
        csv=write_csv,
        ulog=write_ulog,
        dataflash=write_dataflash,
        tlog=write_tlog,
        lat_deg=LAT_DEG,
        voltage_v=VOLTAGE_V,
        current_a=CURRENT_A,
    )
