"""Measure how mouths open in video."""
