"""Figures, printed as JSON; compare them as ratios within one run, because machines differ and are noisy."""
