"""Speed relative to other codes and reference kernels, measured alternately in the same run, and time budgets."""
