"""Sticky-lips finite element simulator: the source of ground-truth mouth videos."""
