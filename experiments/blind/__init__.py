"""A blind benchmark of the diagnosis: sealed plants, scores and baselines."""
