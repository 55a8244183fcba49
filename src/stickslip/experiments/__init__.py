"""The papers, end to end: scenario, result, claims, figures."""
