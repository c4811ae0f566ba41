"""The evidence for each candidate cause of a gap: its log marginal likelihood."""
