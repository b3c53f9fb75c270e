"""The programs: wiring of core, adapters and fleet. Imported by nothing."""
