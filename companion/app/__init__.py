"""The programs: they connect core, adapters and fleet. No other package imports them."""
