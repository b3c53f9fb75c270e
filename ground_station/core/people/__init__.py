"""Operators of the desk, and the audit of their actions."""
