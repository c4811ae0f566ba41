"""The result of a diagnosis: findings, their gaps before and after, corrected files."""
