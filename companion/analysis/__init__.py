"""Offline analysis of recorded flights; no flight imports it."""
