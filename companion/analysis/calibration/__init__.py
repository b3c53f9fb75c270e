"""Identification of an airframe from its flight logs. Flight code does not import it."""
