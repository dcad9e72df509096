"""Simulated places, maps and missions with known truth."""
