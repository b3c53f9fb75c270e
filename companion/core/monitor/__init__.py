"""Notices in service that a promise about energy no longer holds, valid at any time.

Imports base, vehicle and wind.
"""
