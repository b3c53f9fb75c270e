"""Desks with many vehicles that fly orders, for some minutes; all of them share this machine."""
