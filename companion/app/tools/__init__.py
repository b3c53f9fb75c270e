"""Offline tools: replay, calibrate, fit-wind, with their pictures and reports."""
