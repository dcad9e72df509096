"""Fusing two maps: one module a stage."""
