"""Perceptual A/B studies: design, serving, export and analysis."""
