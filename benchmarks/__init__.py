"""Ratios against peers and references, measured in one run, alternating; budgets in seconds beside them."""
